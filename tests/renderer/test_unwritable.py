"""Places that cannot be written: a full standard output, a cache folder for compiled kernels."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from joulebox_render import cli
from joulebox_render.kernels import compilation

FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("words", [["scenes", "list", "--json"], ["--version"]])
def test_a_full_standard_output_is_one_sentence(words: list[str]) -> None:
    """Long answers fail while they are printed, short ones at the last flush."""
    program = "import sys; from joulebox_render import cli; cli.main()"
    with FULL.open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", program, *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr == "joulebox-render: standard output cannot be used: No space left on device\n"


def test_without_a_cache_folder_kernels_are_compiled_but_not_kept(tmp_path: Path) -> None:
    """numba would fall back to folders that no hash of the sources names, or raise where there is none."""
    (tmp_path / "file").touch()
    program = (
        "from joulebox_render.kernels import compilation, surface\n"
        "print(compilation.CACHED, compilation.is_compiled(), type(surface.closest_analytic._cache).__name__)"
    )
    environment = {**os.environ, "JOULEBOX_CACHE_DIR": str(tmp_path / "file" / "below")}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False", "NullCache"]


def test_a_cache_folder_that_cannot_be_written_is_said(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(compilation, "CACHED", False)
    cli._compile_all()
    assert "JOULEBOX_CACHE_DIR" in capfd.readouterr().err
