"""Fixtures of the agent's tests: a tree to write to, the command line in this process."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from agent_testing import DATA
from joulebox_agent import cli


@pytest.fixture
def tree(tmp_path: Path) -> Callable[[str], Path]:
    """Copies a recorded tree and returns its `sys` folder, free to be changed."""

    def copy(name: str) -> Path:
        return Path(shutil.copytree(DATA / name / "sys", tmp_path / name / "sys"))

    return copy


@pytest.fixture
def agent(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs the command line in this process: (exit code, stdout, stderr)."""

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["joulebox-agent", *map(str, words)])
        capsys.readouterr()
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return code, said.out, said.err

    return run
