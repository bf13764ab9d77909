"""How kernels are compiled: the one place that owns the jit flags and the folder of compiled code.

numba notices an edit in a kernel's own file but not in a function it calls from another file, so the cache
folder's name is a hash over all kernel sources and the versions that compile them. The instruction set is
pinned on x86 (AVX2 and FMA, "x86-64-v3") where the machine has it, so that devices of one class share their
pixel hashes.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
import numpy as np
from platformdirs import user_cache_path

# Only flags under which a result does not depend on where in a batch it is computed: no reassociation.
FAST_MATH = {"contract", "afn", "nnan", "ninf", "nsz"}


def source_hash() -> str:
    """Hash over every kernel source and the versions of what compiles it."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.version, platform.machine())
    digest.update(repr(versions).encode())
    return digest.hexdigest()[:16]


def instruction_set() -> str:
    """Name of the instruction set that kernels are compiled for."""
    if platform.machine().lower() not in {"x86_64", "amd64"}:
        return platform.machine().lower() or "generic"
    features = llvm.get_host_cpu_features()
    return "x86-64-v3" if all(features.get(name) for name in ("avx2", "fma", "bmi2")) else "x86-64-v2"


def cache_folder() -> Path:
    """Folder of the compiled kernels; `JOULEBOX_CACHE_DIR` moves it."""
    root = os.environ.get("JOULEBOX_CACHE_DIR")
    base = Path(root) if root else user_cache_path("joulebox", appauthor=False)
    return base / "kernels" / f"{source_hash()}-{ISA}"


def is_compiled() -> bool:
    """Whether this version's kernels have been compiled on this machine before."""
    return CACHED and (CACHE / "complete").exists()


def mark_compiled() -> None:
    """Remember that every kernel has been compiled; a cache that cannot be written is only slower next time."""
    try:
        CACHE.mkdir(parents=True, exist_ok=True)
        (CACHE / "complete").touch()
    except OSError:
        return


def is_writable(folder: Path) -> bool:
    """Whether compiled code can be kept in `folder`, which is made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


ISA = instruction_set()
CACHE = cache_folder()
# Left to itself numba would fall back to a folder that no hash of the sources names, or give up.
CACHED = is_writable(CACHE)
numba.config.CACHE_DIR = str(CACHE)  # type: ignore[attr-defined]
if ISA.startswith("x86-64"):
    numba.config.CPU_NAME = ISA  # type: ignore[attr-defined]
    numba.config.CPU_FEATURES = ""  # type: ignore[attr-defined]

# Without numba's runtime a kernel cannot allocate, and need not: callers hand in all arrays. What it buys is that
# passing the scene's arrays to a device function no longer counts references: 4.5x on the step of a path.
_njit: Any = numba.njit  # `_nrt` is not in numba's annotations
kernel = _njit(nogil=True, cache=CACHED, fastmath=FAST_MATH, error_model="numpy", boundscheck=False, _nrt=False)
device = _njit(nogil=True, fastmath=FAST_MATH, error_model="numpy", forceinline=True, _nrt=False)
