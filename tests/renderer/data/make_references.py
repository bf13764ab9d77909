"""Make the converged references of test_reference.py with Mitsuba 3, an independent path tracer.

    python tests/renderer/data/make_references.py [--runs 16] [--spp 256]

Each scene is rendered at SIZE x SIZE pixels by `runs` independent runs of `spp` samples a pixel (variant
scalar_rgb, unbiased path tracing). Stored in <scene>.npz, linear RGB radiance, first row on top:

    mean               (SIZE, SIZE, 3) f4  mean over all runs
    variance_of_mean   (SIZE, SIZE, 3) f4  sample variance over the runs, divided by their number
    runs, spp          how many samples stand behind it
    mitsuba, variant   what made it
    scene_file_sha256  of the scene.xml that was rendered; test_reference.py refuses a reference of another file
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

import mitsuba
import numpy as np

HERE = Path(__file__).parent
SCENES = HERE.parents[2] / "scenes"
NAMES = ("cornell-boxes", "cornell-spheres")
SIZE = 64
VARIANT = "scalar_rgb"


def make_reference(name: str, runs: int, spp: int) -> Path:
    """Render one scene `runs` times and write <name>.npz."""
    source = SCENES / name / "scene.xml"
    scene = mitsuba.load_file(str(source))
    parameters = mitsuba.traverse(scene)
    size_key = next(key for key in parameters.keys() if key.endswith("film.size"))  # noqa: SIM118 - not a dict
    parameters[size_key] = [SIZE, SIZE]
    parameters.update()
    images = []
    for run in range(runs):
        images.append(np.array(mitsuba.render(scene, spp=spp, seed=1000 + run), dtype=np.float64))
        print(f"{name}: run {run + 1} of {runs}", flush=True)
    stack = np.stack(images)
    path = HERE / f"{name}.npz"
    np.savez_compressed(
        path,
        mean=stack.mean(axis=0).astype(np.float32),
        variance_of_mean=(stack.var(axis=0, ddof=1) / runs).astype(np.float32),
        runs=runs,
        spp=spp,
        mitsuba=mitsuba.__version__,
        variant=VARIANT,
        scene_file_sha256=hashlib.sha256(source.read_bytes()).hexdigest(),
    )
    return path


def main() -> None:
    """Make all references, or those named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=NAMES, help=f"of {', '.join(NAMES)}; default: all")
    parser.add_argument("--runs", type=int, default=16)
    parser.add_argument("--spp", type=int, default=256)
    given = parser.parse_args()
    mitsuba.set_variant(VARIANT)
    for name in given.names:
        print(make_reference(name, given.runs, given.spp))


if __name__ == "__main__":
    main()
