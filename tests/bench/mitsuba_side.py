"""Mitsuba 3 on our scene files: which of its variants this machine can run, and how to render with it.

The LLVM variant needs a shared library of LLVM 17 or newer (before that LLVM cannot compile the minima and maxima
that Dr.Jit 1.x asks for on x86). Debian and Ubuntu have it as libllvm19, Homebrew as llvm, Windows in LLVM's
installer; DRJIT_LIBLLVM_PATH names a library that lies elsewhere.
"""

from __future__ import annotations

import ctypes
import functools
import os
import re
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joulebox_render.records import F4
from joulebox_render.scene import find_scene

OLDEST_LLVM = 17
LLVM, SCALAR = "llvm_ad_rgb", "scalar_rgb"
LIBRARY_FOLDERS = {
    "linux": ("/usr/lib/*-linux-gnu*", "/usr/lib64", "/usr/lib", "/usr/lib/llvm-*/lib", "/usr/local/lib"),
    "darwin": ("/opt/homebrew/opt/llvm*/lib", "/usr/local/opt/llvm*/lib"),
    "win32": ("/Program Files/LLVM/bin",),
}
LIBRARY_NAMES = ("libLLVM*.so*", "libLLVM*.dylib", "LLVM-C.dll")
NO_LLVM = (
    f"Mitsuba's LLVM variant needs LLVM {OLDEST_LLVM} or newer, which was not found: install it "
    "(Debian, Ubuntu: apt install libllvm19; macOS: brew install llvm) or name it in DRJIT_LIBLLVM_PATH."
)


class Rendered(NamedTuple):
    """A picture, (H, W, 3) f4 linear RGB, and the process's CPU seconds it took."""

    pixels: F4
    cpu_s: float


def llvm_version(library: Path) -> int:
    """Major version of an LLVM library, by its file's name or that of what it links to; 0 where that tells none."""
    for name in (library.name, library.resolve().name):
        found = re.search(r"(?:LLVM-|so\.|LLVM\.)(\d+)", name)
        if found:
            return int(found[1])
    return 0


def find_llvm() -> Path | None:
    """The newest LLVM library on this machine that is new enough and loads."""
    here = Path(Path.cwd().anchor)
    found = [
        library
        for folder in LIBRARY_FOLDERS.get(sys.platform, ())
        for name in LIBRARY_NAMES
        for library in here.glob(f"{folder.lstrip('/')}/{name}")
        if llvm_version(library) >= OLDEST_LLVM or library.suffix == ".dll"
    ]
    for library in sorted(set(found), key=lambda path: (llvm_version(path), str(path)), reverse=True):
        try:
            ctypes.CDLL(str(library))
        except OSError:
            continue
        return library
    return None


@functools.cache
def mitsuba() -> Any:
    """The module, with the fastest variant that this machine can run; `variant()` tells which."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ and (library := find_llvm()):
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    import mitsuba as mi

    mi.set_log_level(mi.LogLevel.Error)
    try:
        # an LLVM that is too old aborts the whole process when it compiles its first kernel
        if "DRJIT_LIBLLVM_PATH" not in os.environ:
            raise ImportError
        mi.set_variant(LLVM)
    except ImportError:
        mi.set_variant(SCALAR)
    return mi


def variant() -> str:
    """The variant in use."""
    return str(mitsuba().variant())


def describe() -> str:
    """The rival's name and version."""
    mi = mitsuba()
    if variant() != LLVM:
        return f"Mitsuba {mi.__version__} {variant()}"
    import drjit

    version = ".".join(str(part) for part in drjit.detail.llvm_version())
    return f"Mitsuba {mi.__version__} {variant()} on LLVM {version}"


def can_render(scene: str) -> bool:
    """Whether Mitsuba 3 knows everything in our scene file; it has no `phong`."""
    return 'type="phong"' not in find_scene(scene).read_text(encoding="utf-8")


def load(scene: str, defines: Mapping[str, str] | None = None, sampler: str = "multijitter", size: int = 0) -> Any:
    """Our scene file as Mitsuba's scene, with `sampler`, and a film of size x size pixels unless 0."""
    mi = mitsuba()
    file = find_scene(scene)
    root = ElementTree.fromstring(file.read_text(encoding="utf-8"))
    for element in root.iter("sampler"):
        element.set("type", sampler)
    if size:
        for element in root.iterfind("./sensor/film/integer"):
            if element.get("name") in ("width", "height"):
                element.set("value", str(size))
    for element in root.iterfind("./shape/string[@name='filename']"):
        element.set("value", str(file.resolve().parent / element.attrib["value"]))
    return mi.load_string(ElementTree.tostring(root, encoding="unicode"), **(defines or {}))


def render(scene: Any, spp: int, seed: int) -> Rendered:
    """One picture of `spp` samples a pixel."""
    start = time.process_time()
    pixels = np.array(mitsuba().render(scene, spp=spp, seed=seed), dtype=np.float32)[:, :, :3]
    return Rendered(np.ascontiguousarray(pixels), time.process_time() - start)
