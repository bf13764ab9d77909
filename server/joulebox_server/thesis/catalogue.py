"""The batches of the study, in the order in which they run."""

from collections.abc import Sequence
from difflib import get_close_matches

from joulebox_server.cli.connection import WrongUseError
from joulebox_server.thesis import beyond, caustics, direct, dv, fg, polygons, resolution, stability
from joulebox_server.thesis.batch import Batch

BATCHES: tuple[Batch, ...] = (
    fg.BATCH,
    dv.BATCH,
    caustics.BATCH,
    polygons.BATCH,
    resolution.BATCH,
    direct.BATCH,
    beyond.BATCH,
    stability.BATCH,
)


def chosen(names: Sequence[str] | None) -> list[Batch]:
    """The batches of these names, all without any. Raises WrongUseError for a name that none has."""
    known = {batch.name: batch for batch in BATCHES}
    for name in names or ():
        if name not in known:
            nearest = get_close_matches(name, known, n=1, cutoff=0.5)
            hint = f"did you mean {nearest[0]}? " if nearest else ""
            raise WrongUseError(f"there is no batch {name!r}; {hint}batches are {', '.join(known)}")
    return [batch for batch in BATCHES if not names or batch.name in names]
