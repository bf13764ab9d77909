"""The rules that kernels keep: one signature each, few of them, nothing but numbers imported."""

from __future__ import annotations

import ast
import importlib
import json
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from joulebox_render import kernels
from joulebox_render.kernels.compilation import FAST_MATH, device, kernel
from numba.core.dispatcher import Dispatcher

FOLDER = Path(kernels.__file__).parent
# compilation.py owns the jit flags and the cache folder, and is no kernel.
SOURCES = sorted(file for file in FOLDER.glob("*.py") if file.name != "compilation.py")
MODULES = [module.name for module in pkgutil.iter_modules([str(FOLDER)]) if module.name != "compilation"]
MOST_KERNELS = 43


def decorated(file: Path, decorator: str) -> list[str]:
    """Functions of a source file under @kernel or @device."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    return [
        node.name
        for node in functions
        if any(isinstance(given, ast.Name) and given.id == decorator for given in node.decorator_list)
    ]


def dispatchers(decorator: str) -> dict[str, Any]:
    found = {}
    for module in MODULES:
        for name in decorated(FOLDER / f"{module}.py", decorator):
            found[f"{module}.{name}"] = getattr(importlib.import_module(f"{kernels.__name__}.{module}"), name)
    return found


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: file.name)
def test_kernels_import_only_numbers(file: Path) -> None:
    imported = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module or "")
            assert node.level == 0
    allowed = {"math", "numpy", "numba", "numba.extending"}
    assert {name for name in imported if not name.startswith("joulebox_render.kernels.")} <= allowed


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: file.name)
def test_kernels_draw_no_random_numbers_and_raise_nothing(file: Path) -> None:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        assert not isinstance(node, (ast.Raise, ast.Try))
        if isinstance(node, ast.Attribute):
            assert node.attr != "random"


def test_every_function_of_a_kernel_file_is_compiled() -> None:
    for file in SOURCES:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        compiled = {*decorated(file, "kernel"), *decorated(file, "device"), *decorated(file, "intrinsic")}
        assert functions == compiled, file.name


def test_there_are_few_kernels() -> None:
    found = dispatchers("kernel")
    assert 10 < len(found) <= MOST_KERNELS
    assert all(isinstance(kernel_, Dispatcher) for kernel_ in found.values())


def test_one_place_owns_the_flags() -> None:
    """No reassociation and no reciprocals: results do not depend on where in a batch they are computed."""
    assert not FAST_MATH & {"fast", "reassoc", "arcp"}
    for name, compiled in {**dispatchers("kernel"), **dispatchers("device")}.items():
        options = compiled.targetoptions
        assert options["fastmath"] == FAST_MATH, name
        assert options["nogil"], name
        assert not options.get("parallel"), name
    for file in SOURCES:
        assert "numba.njit" not in file.read_text(encoding="utf-8")
        assert "@njit" not in file.read_text(encoding="utf-8")
    assert kernel is not device


def test_each_kernel_is_compiled_once(make_scene: Callable[..., Path]) -> None:
    """One signature for each kernel after renders of all methods, of meshes alone, spheres alone, and both.

    A second one would be compiled in the middle of somebody's measurement. A process of its own: other tests call
    kernels with what they like.
    """
    sphere = (
        '<shape type="sphere"><float name="radius" value="0.5"/><boolean name="flip_normals" value="true"/></shape>'
        '<emitter type="point"/>'
    )
    mesh = '<shape type="cube"><boolean name="flip_normals" value="true"/></shape><emitter type="spot"/>'
    scenes = ["cornell-boxes", "cornell-spheres", "caustic-ring", "many-lights", "furnace", "phong-spheres"]
    glossy = (
        '<shape type="cube"><boolean name="flip_normals" value="true"/></shape>'
        '<shape type="sphere"><float name="radius" value="0.1"/><bsdf type="phong"/></shape><emitter type="constant"/>'
    )
    scenes += [str(make_scene(body)) for body in (sphere, mesh, glossy)]
    script = """
import importlib, json, sys
from joulebox_render.session import Session
from joulebox_render.settings import make_settings
small = {"width": 5, "height": 4, "samples_per_pixel": 2, "global_photons": 300, "caustic_photons": 20,
         "shadow_rays": 4, "final_gather_rays": 4, "threads": 1}
methods = [{"indirect": "none"}, {"indirect": "path", "jitter": False, "shadow_rays": 7}, {"photon_spacing": 0},
           {"indirect": "direct_visualization", "gather_filter": "cone", "sampler": "independent"},
           {"gather_filter": "epanechnikov", "store_at_every_bounce": False, "width": 9},
           {"irradiance_cache_tolerance": 0.5, "sampler": "sobol", "caustic_hints": True}, {"caustics": False},
           {"irradiance_cache_tolerance": 0, "importance_sampling": True, "use_shadow_photons": True}]
names, scenes = json.loads(sys.argv[1]), json.loads(sys.argv[2])
for scene in scenes:
    for index, method in enumerate(methods):
        with Session(scene, make_settings(small, method), intersector=("auto", "bvh")[index % 2]) as session:
            session.render()
counts = {}
for name in names:
    module, function = name.split(".")
    found = getattr(importlib.import_module("joulebox_render.kernels." + module), function).signatures
    counts[name] = [str(signature) for signature in found]
print(json.dumps(counts))
"""
    names = list(dispatchers("kernel"))
    done = subprocess.run(
        [sys.executable, "-c", script, json.dumps(names), json.dumps(scenes)],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    signatures = json.loads(done.stdout)
    assert {name: len(found) for name, found in signatures.items()} == dict.fromkeys(names, 1), signatures
