"""What is imported is declared, what is declared is imported, and whatever it drags in is pinned."""

import ast
import importlib.metadata
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

DISTRIBUTIONS = {
    "renderer": "joulebox_render",
    "agent": "joulebox_agent",
    "server": "joulebox_server",
}
# What run.py installs of its own accord, to install the rest with.
BUILD = ("pip", "hatchling", "editables")
# What uvicorn takes up by itself when it is there: parses and waits several times as fast.
TAKEN_UP = {"httptools", "uvloop"}


def imported(package: Path) -> set[str]:
    """Top-level names of every import in a package, wherever it stands."""
    names: set[str] = set()
    for module in package.rglob("*.py"):
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names.add(node.module.split(".")[0])
    return names - set(sys.stdlib_module_names) - {package.name}


def declared(root: Path, folder: str) -> list[Requirement]:
    """Requirements of a distribution, those of its extras among them: setup installs them all."""
    project = tomllib.loads((root / folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [line for lines in project.get("optional-dependencies", {}).values() for line in lines]
    return [Requirement(line) for line in (*project["dependencies"], *extras)]


def pinned(root: Path) -> set[str]:
    """Canonical names of what constraints.txt pins for this machine."""
    lines = (root / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(pin.name) for pin in pins if applies(pin)}


@pytest.mark.parametrize("folder", DISTRIBUTIONS)
def test_every_import_is_declared(root: Path, folder: str) -> None:
    providers = importlib.metadata.packages_distributions()
    names = {canonicalize_name(requirement.name) for requirement in declared(root, folder)}
    undeclared = {
        name
        for name in imported(root / folder / DISTRIBUTIONS[folder])
        if not {canonicalize_name(provider) for provider in providers.get(name, [name])} & names
    }
    assert undeclared == set()


@pytest.mark.parametrize("folder", DISTRIBUTIONS)
def test_every_declared_package_is_imported(root: Path, folder: str) -> None:
    providers = importlib.metadata.packages_distributions()
    used = {
        canonicalize_name(provider)
        for name in imported(root / folder / DISTRIBUTIONS[folder])
        for provider in providers.get(name, [])
    }
    wanted = {requirement for requirement in declared(root, folder) if applies(requirement)}
    names = {canonicalize_name(requirement.name) for requirement in wanted}
    assert names - used - TAKEN_UP == set()


def test_exactly_what_setup_installs_is_pinned(root: Path) -> None:
    groups = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    wanted = [requirement for folder in DISTRIBUTIONS for requirement in declared(root, folder)]
    wanted += [Requirement(line) for line in (*groups["dev"], *BUILD)]
    assert closure(wanted) == pinned(root)


def closure(waiting: list[Requirement]) -> set[str]:
    """Canonical names of the requirements and of all that they require on this machine."""
    seen: set[tuple[str, frozenset[str]]] = set()
    while waiting:
        requirement = waiting.pop()
        key = (canonicalize_name(requirement.name), frozenset(requirement.extras))
        if key in seen or not applies(requirement):
            continue
        seen.add(key)
        children = [Requirement(line) for line in importlib.metadata.requires(requirement.name) or []]
        waiting += [child for child in children if applies(child, requirement.extras)]
    return {name for name, _ in seen}


def applies(requirement: Requirement, extras: set[str] | frozenset[str] = frozenset()) -> bool:
    """Whether a requirement's marker holds on this machine, with the extras that were asked for."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in extras or {""})
