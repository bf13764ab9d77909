"""The renderer's command as its tests call it, and how it must refuse."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

COMMAND = [sys.executable, "-c", "from joulebox_render.cli import main; main()"]
QUICK = [
    "--set", "width=16", "--set", "height=12", "--set", "global_photons=2000", "--set", "caustic_photons=300",
    "--set", "final_gather_rays=8", "--set", "shadow_rays=4", "--set", "samples_per_pixel=1",
]  # fmt: skip


def run(*arguments: str | Path, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, as a user's shell would start it."""
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=timeout_s, check=False
    )


def refused(answer: tuple[int, str, str], code: int, *words: str) -> None:
    """One sentence on stderr that holds the words, nothing on stdout, the exit code."""
    got, out, err = answer
    assert got == code, err
    assert out == ""
    assert "Traceback" not in err
    lines = [line for line in err.splitlines() if line.strip() and not line.startswith("note: ")]
    assert len(lines) == 1, err
    assert lines[0].startswith("joulebox-render: ")
    for word in words:
        assert word in lines[0]
