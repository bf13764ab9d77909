"""Seeds of repeats: shared by all configurations, or own to each.

One seed's photons fall well or badly for every configuration that it renders. With shared seeds two configurations are
compared under the same luck, and a change of one setting shows at few repeats; but what is learnt from all of them
together (which photon count is best) rests on as many draws as there are repeats. With seeds of its own for every
configuration that luck averages out over the sweep.
"""

from collections.abc import Mapping
from typing import Any

from joulebox_server.store.ids import canonical, sha256_text

HEX_DIGITS = 13
"""Of the hash: 52 bits, so that browsers and databases keep every digit."""


def own_seed(base_seed: int, settings: Mapping[str, Any], repeat: int) -> int:
    """The seed of one repeat of one configuration that no other repeat or configuration has.

    settings   of the configuration; a seed among them counts for nothing
    """
    others = {name: value for name, value in settings.items() if name != "seed"}
    return int(sha256_text(canonical([base_seed, others, repeat]))[:HEX_DIGITS], 16)
