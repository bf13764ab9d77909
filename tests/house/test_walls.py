"""The walls between and inside the distributions: kept by the tree, and seen to catch a planted violation."""

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGES = ("renderer/joulebox_render", "agent/joulebox_agent", "server/joulebox_server")
KERNELS_MAY_IMPORT = {"__future__", "math", "numpy", "numba"}
# Not kernels themselves: this says how they are compiled and where the machine code is kept.
KERNEL_BUILDERS = {"compilation.py"}


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run import-linter on the packages found in `folder`, with the contracts of the pyproject.toml there."""
    program = Path(sys.executable).with_name("lint-imports")
    return subprocess.run(
        [program, "--no-cache"], cwd=folder, capture_output=True, text=True, encoding="utf-8", timeout=120
    )


@pytest.fixture
def copied(root: Path, tmp_path: Path) -> Path:
    """A folder with a copy of the three packages and the contracts."""
    shutil.copy(root / "pyproject.toml", tmp_path)
    for package in PACKAGES:
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(root / package, tmp_path / Path(package).name, ignore=ignore)
    return tmp_path


def test_the_tree_keeps_every_wall(root: Path) -> None:
    result = lint(root)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "0 broken" in result.stdout


@pytest.mark.parametrize(
    ("importer", "statement", "wall"),
    [
        ("joulebox_agent/__init__.py", "import joulebox_server.errors", "never import each other"),
        ("joulebox_server/errors.py", "from joulebox_render import errors", "never import each other"),
        ("joulebox_render/errors.py", "import joulebox_agent", "never import each other"),
        ("joulebox_render/kernels/rng.py", "import joulebox_render.stages.direct", "down to the kernels"),
        ("joulebox_render/stages/direct.py", "import joulebox_render.scene_xml", "How a scene is written"),
        ("joulebox_agent/sources/sysfs.py", "import joulebox_agent.measuring.meter", "down to the sources"),
        ("joulebox_server/errors.py", "import joulebox_server.schemas.base", "through the store"),
        ("joulebox_server/store/ids.py", "import fastapi", "knows nothing of HTTP"),
        ("joulebox_server/analysis/pareto.py", "import sqlite_utils", "are pure functions"),
    ],
)
def test_a_planted_import_is_caught(copied: Path, importer: str, statement: str, wall: str) -> None:
    module = copied / importer
    module.write_text(f"{module.read_text(encoding='utf-8')}\n{statement}\n", encoding="utf-8")
    result = lint(copied)
    broken = [line for line in result.stdout.splitlines() if line.rstrip().endswith("BROKEN")]
    assert result.returncode != 0
    assert len(broken) == 1, result.stdout + result.stderr
    assert wall in broken[0]


def foreign_imports(source: str) -> set[str]:
    """Top-level names of what a kernel module imports beyond what a kernel may import."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module)
    inside = "joulebox_render.kernels."
    return {
        name for name in names if name.split(".")[0] not in KERNELS_MAY_IMPORT and not f"{name}.".startswith(inside)
    }


def test_kernels_import_only_arithmetic(root: Path) -> None:
    modules = sorted((root / "renderer/joulebox_render/kernels").glob("*.py"))
    assert modules
    kernels = [module for module in modules if module.name not in KERNEL_BUILDERS]
    found = {module.name: foreign_imports(module.read_text(encoding="utf-8")) for module in kernels}
    assert {name: names for name, names in found.items() if names} == {}


def test_a_kernel_that_imports_more_is_caught() -> None:
    source = "import numpy as np\nfrom joulebox_render.kernels.vector import dot\nimport os.path\n"
    assert foreign_imports(source) == {"os.path"}
