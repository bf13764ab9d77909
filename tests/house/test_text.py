"""What must and what must not stand in the project's files."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

# Assembled, so that this file does not hold what it looks for.
FORBIDDEN = {
    "a package registry's host": re.compile(
        r"files\.python" + r"hosted|pypi\.or" + r"g/|registry\.npm" + r"js|crates\.i" + r"o/"
    ),
    "an absolute path of one machine": re.compile(
        r"(?<![\w.}>$/])/(?:wor" + r"k|roo" + r"t|hom" + r"e/\w|User" + r"s/\w|farm)/"
    ),
    "a temporary folder of one machine": re.compile(r"(?<![\w.}>])/tm" + r"p/"),
}
LOCK_FILES = {"uv." + "lock", "poetry.lock", "Pipfile.lock", "package-lock.json"}
BINARY = {".bin", ".exr", ".png", ".ply", ".npy", ".npz", ".zip", ".gz", ".parquet", ".ico", ".woff2", ".webp"}


def violations(text: str) -> list[str]:
    """What `text` says that a file of the project must not say."""
    return [
        f"{what}: {match.group(0)!r} in {text[max(0, match.start() - 30) : match.end() + 30]!r}"
        for what, pattern in FORBIDDEN.items()
        for match in pattern.finditer(text)
    ]


def test_no_file_names_a_machine_or_a_registry(root: Path, tracked: list[Path]) -> None:
    found = {
        str(file.relative_to(root)): problems
        for file in tracked
        if file.suffix not in BINARY and (problems := violations(file.read_text(encoding="utf-8")))
    }
    assert found == {}


@pytest.mark.parametrize(
    "planted",
    [
        "see https://pypi.or" + "g/project/numpy",
        "cache = '/roo" + "t/.cache/'",
        "cd /wor" + "k/main",
        "-o /tm" + "p/a.exr",
    ],
)
def test_a_planted_machine_or_registry_is_caught(planted: str) -> None:
    assert violations(planted)


def test_no_lock_file_tells_where_packages_came_from(tracked: list[Path]) -> None:
    assert [file.name for file in tracked if file.name in LOCK_FILES] == []


def test_constraints_are_versions_only(root: Path) -> None:
    lines = (root / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pin = re.compile(r"[A-Za-z0-9][\w.-]*==[0-9][\w.]*(?: ; .+)?")
    assert [line for line in lines if line and not line.startswith("#") and not pin.fullmatch(line)] == []


def test_the_tasks_start_on_a_python_too_old_to_run_them(root: Path) -> None:
    """Python 3.6 must be able to parse run.py, or its user reads a SyntaxError instead of our sentence."""
    ast.parse((root / "run.py").read_text(encoding="utf-8"), feature_version=(3, 6))


def test_an_old_python_is_told_in_one_sentence(root: Path) -> None:
    pretend = f"import runpy, sys; sys.version_info = (3, 9, 1); runpy.run_path({str(root / 'run.py')!r})"
    result = subprocess.run([sys.executable, "-c", pretend], capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert result.stderr.startswith("joulebox needs Python 3.11 or newer and this is Python 3.9;")
    assert result.stderr.count("\n") == 1


def test_the_makefile_offers_every_task(root: Path) -> None:
    listed = re.search(r"^TASKS := (.+)$", (root / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert listed
    result = subprocess.run([sys.executable, "run.py"], cwd=root, capture_output=True, text=True, timeout=60)
    tasks = re.findall(r"^  ([a-z-]+) ", result.stdout, re.MULTILINE)
    assert sorted(listed[1].split()) == sorted(tasks)


def test_an_unknown_task_is_wrong_use(root: Path) -> None:
    command = [sys.executable, "run.py", "tset"]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=60)
    assert result.returncode == 2
    assert result.stderr.startswith("There is no task 'tset'; the tasks are help, setup, ")
