"""The three wheels: what travels in them, and that they work installed in an empty environment."""

import json
import os
import re
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

DISTRIBUTIONS = ("renderer", "agent", "server")
PROGRAMS = {
    "joulebox-render": "joulebox-render",
    "joulebox-agent": "joulebox-agent",
    "joulebox": "joulebox-server",
}
PIP = ("-m", "pip", "--disable-pip-version-check", "--no-input")


def run(*command: str | Path, cwd: Path, seconds: float = 120) -> str:
    """Output of a command that must succeed; its error output is in the failure."""
    free = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    result = subprocess.run(
        command, cwd=cwd, env=free, capture_output=True, text=True, encoding="utf-8", timeout=seconds
    )
    assert result.returncode == 0, f"{command}: {result.stdout[-2000:]}{result.stderr[-2000:]}"
    return result.stdout


@pytest.fixture(scope="module")
def wheels(root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The wheel of each distribution, built as `make wheels` builds them."""
    folder = tmp_path_factory.mktemp("wheels")
    parts = [f"./{name}" for name in DISTRIBUTIONS]
    run(sys.executable, *PIP, "wheel", "--no-deps", "--no-build-isolation", "-w", folder, *parts, cwd=root)
    named = {"renderer": "joulebox_render", "agent": "joulebox_agent", "server": "joulebox_server"}
    return {name: next(folder.glob(f"{package}-*.whl")) for name, package in named.items()}


def contents(wheel: Path) -> set[str]:
    """Names of the files in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def beneath(folder: Path) -> set[str]:
    """Names of the files that must travel, relative to `folder`."""
    files = {file.relative_to(folder) for file in folder.rglob("*") if file.is_file()}
    caches = re.compile(r"(^|/)(__pycache__|\.\w+_cache)/")
    return {file.as_posix() for file in files if not caches.search(file.as_posix())}


@pytest.mark.parametrize(
    ("distribution", "folder", "inside"),
    [
        ("server", "web", "joulebox_server/web"),
        ("renderer", "scenes", "joulebox_render/scenes"),
        ("renderer", "renderer/joulebox_render", "joulebox_render"),
        ("agent", "agent/joulebox_agent", "joulebox_agent"),
        ("server", "server/joulebox_server", "joulebox_server"),
    ],
)
def test_everything_travels(root: Path, wheels: dict[str, Path], distribution: str, folder: str, inside: str) -> None:
    expected = {f"{inside}/{name}" for name in beneath(root / folder)}
    assert expected
    assert expected - contents(wheels[distribution]) == set()


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_nothing_else_travels(wheels: dict[str, Path], distribution: str) -> None:
    names = contents(wheels[distribution])
    tops = {name.split("/")[0].split("-")[0] for name in names}
    assert len(tops) == 1
    assert [name for name in names if "__pycache__" in name or "/test" in name] == []
    assert any(name.endswith("/py.typed") for name in names)


def test_an_editable_install_reads_the_checkout(root: Path) -> None:
    """A copy of the pages or scenes beside an editable install must never win over the checkout."""
    program = (
        "import json, joulebox_render, joulebox_server.pages as pages;"
        "print(json.dumps([joulebox_render.__file__, str(pages.web_folder())]))"
    )
    renderer, pages = json.loads(run(sys.executable, "-c", program, cwd=root.parent))
    assert Path(renderer) == root / "renderer/joulebox_render/__init__.py"
    assert Path(pages) == root / "web"
    command = Path(sys.executable).with_name("joulebox-render")
    listed = json.loads(run(command, "scenes", "list", "--json", cwd=root))
    assert listed
    assert [scene for scene in listed if (root / "scenes") not in Path(scene["path"]).parents] == []


@pytest.fixture(scope="module")
def installed(root: Path, wheels: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the programs of an empty environment outside the checkout, with the three wheels in it."""
    folder = tmp_path_factory.mktemp("empty") / "env"
    venv.EnvBuilder(with_pip=True, symlinks=os.name != "nt").create(folder)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    run(programs / "python", *PIP, "install", "-c", root / "constraints.txt", *wheels.values(),
        cwd=folder, seconds=900)  # fmt: skip
    return programs


@pytest.mark.long
@pytest.mark.parametrize(("command", "distribution"), PROGRAMS.items())
def test_the_installed_commands_answer(installed: Path, tmp_path: Path, command: str, distribution: str) -> None:
    program = f"import importlib.metadata; print(importlib.metadata.version('{distribution}'))"
    version = run(installed / "python", "-c", program, cwd=tmp_path).strip()
    assert version in run(installed / command, "--version", cwd=tmp_path)
    assert "Usage" in run(installed / command, "--help", cwd=tmp_path)


@pytest.mark.long
def test_the_installed_renderer_renders_a_scene_that_came_with_it(installed: Path, tmp_path: Path) -> None:
    scenes = json.loads(run(installed / "joulebox-render", "scenes", "list", "--json", cwd=tmp_path))
    assert {"cornell-boxes", "cornell-spheres"} <= {scene["name"] for scene in scenes}
    assert [scene for scene in scenes if installed.parent not in Path(scene["path"]).parents] == []
    run(installed / "joulebox-render", "render", "cornell-boxes", "--preset", "draft", "--set", "width=32",
        "--set", "height=32", "-o", "a.exr", "--report", "a.json", cwd=tmp_path, seconds=600)  # fmt: skip
    assert (tmp_path / "a.exr").stat().st_size > 0
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["image"]["width"] == 32


@pytest.mark.long
def test_the_installed_server_serves_its_own_pages(installed: Path, tmp_path: Path) -> None:
    program = "import joulebox_server.pages as pages; print(pages.web_folder())"
    folder = Path(run(installed / "python", "-c", program, cwd=tmp_path).strip())
    assert installed.parent in folder.parents
    assert (folder / "index.html").is_file()
