"""What the agent's tests share: recorded trees, faults, a clock, a scripted renderer."""

import errno
import json
import shlex
import sys
from pathlib import Path

from joulebox_agent.sources.sysfs import Sysfs

DATA = Path(__file__).parent / "data" / "power_supply"
FAKE_RENDERER = Path(__file__).parent / "fake_renderer.py"
FAKE_COMMAND = [sys.executable, "-S", "-E", str(FAKE_RENDERER)]
RENDERER = shlex.join(FAKE_COMMAND)


class FaultySysfs(Sysfs):
    """A tree in which reading some files answers with an errno, `times` times (None: always)."""

    def __init__(self, root: Path, faults: dict[str, int], times: int | None = None) -> None:
        super().__init__(root)
        self.faults = {root.parent / name if name.startswith("sys/") else root / name: code
                       for name, code in faults.items()}  # fmt: skip
        self.left = times

    def text(self, path: Path) -> str:
        if path in self.faults and self.left != 0:
            self.left = None if self.left is None else self.left - 1
            raise OSError(self.faults[path], "injected", str(path))
        return super().text(path)


class ScriptedClock:
    """A clock that stands still until told otherwise."""

    def __init__(self) -> None:
        self.time_s = 1000.0
        self.asleep_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    def slept_s(self) -> float:
        return self.asleep_s


def faults_of(name: str) -> dict[str, int]:
    return {path: fault["errno"] for path, fault in json.loads((DATA / name / "faults.json").read_text()).items()}


EIO, ENODATA, ENODEV = errno.EIO, errno.ENODATA, errno.ENODEV

Nodes = dict[str, dict[str, object]]


def build_tree(root: Path, nodes: Nodes) -> Path:
    """A tree that plays /sys, with these nodes of class/power_supply and their files."""
    (root / "class" / "power_supply").mkdir(parents=True)
    for node, files in nodes.items():
        folder = root / "class" / "power_supply" / node
        folder.mkdir()
        for name, value in files.items():
            (folder / name).write_text(f"{value}\n")
    return root
