"""The stored server of `tests/web/data`: two sweeps that the real agent measured (see `record.py`), one failed."""

import zipfile
from pathlib import Path

from joulebox_server.store import upkeep

ARCHIVE = Path(__file__).resolve().parent / "data" / "fleet.zip"
GRID, FAILED = "cornell-grid", "bunny-detail"


def restore(folder: Path, data_dir: Path) -> None:
    """Put the stored server's data into `data_dir`; `folder` is for what is unpacked on the way."""
    with zipfile.ZipFile(ARCHIVE) as packed:
        packed.extractall(folder / "backup")
    upkeep.restore(folder / "backup", data_dir)
