"""Converged references of every scene, rendered with Mitsuba 3 from our own scene files; `make references`.

    python -m tests.bench.references [SCENE[:name=value,...] ...] [--passes N] [--spp N] [--size N] [--list]

Passes of `spp` samples a pixel with different seeds are independent pictures, so their spread gives every pixel's
variance. What is kept after each pass is a running mean and the sum of squared deviations from it (Welford 1962):
an interrupted run goes on where it stopped, and a run with more passes adds to the ones there are. The files lie in
the user's cache folder (moved by JOULEBOX_CACHE_DIR), one for each scene_sha256, size, samples and Mitsuba version.

A scene that Mitsuba cannot read (`phong`) is rendered by our own `indirect=path`. Without names all scenes are
rendered except those that carry a reference.exr. --pack FOLDER writes what is kept small enough to lie beside tests.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joulebox_render.errors import RenderError
from joulebox_render.images import read_exr
from joulebox_render.records import F4, F8
from joulebox_render.scene import find_scene, list_scenes, load_scene
from joulebox_render.session import Session
from joulebox_render.settings import make_settings
from platformdirs import user_cache_path

from . import mitsuba_side

PASSES, SPP = 32, 256
SHIPPED = "reference.exr"
# What is rendered of a scene that has variants; others are named on the command line.
VARIANTS: dict[str, list[dict[str, str]]] = {"cornell-bunny": [{"detail": "69666"}]}
OWN_SETTINGS = {"indirect": "path", "shadow_rays": 4}


@dataclass
class Reference:
    """Linear RGB radiance of a scene, first row on top.

    mean      (H, W, 3) f8  over all passes
    squares   (H, W, 3) f8  sum over the passes of squared deviations from the mean
    passes    how many independent pictures of `spp` samples a pixel; 0: a shipped file, whose spread is unknown
    """

    mean: F8
    squares: F8
    passes: int
    spp: int
    origin: str

    @property
    def pixels(self) -> F4:
        """The mean as a picture."""
        return self.mean.astype(np.float32)

    @property
    def variance_of_mean(self) -> F8 | None:
        """(H, W, 3) f8 squared standard error of every value; None with fewer than two passes."""
        return self.squares / (self.passes - 1) / self.passes if self.passes > 1 else None

    def add(self, picture: F4) -> None:
        """Take one more pass into account."""
        self.passes += 1
        step = picture - self.mean
        self.mean += step / self.passes
        self.squares += step * (picture - self.mean)


@dataclass(frozen=True)
class Wanted:
    """A scene, or a variant of one, whose reference is wanted."""

    scene: str
    defines: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Wanted:
        """From `scene` or `scene:name=value,name=value`."""
        scene, _, values = text.partition(":")
        pairs = (value.partition("=") for value in values.split(",") if value)
        return cls(scene, {name: value for name, _, value in pairs})

    def __str__(self) -> str:
        values = ",".join(f"{name}={value}" for name, value in self.defines.items())
        return f"{self.scene}:{values}" if values else self.scene


def folder() -> Path:
    """Where references are kept."""
    root = os.environ.get("JOULEBOX_CACHE_DIR")
    return (Path(root) if root else user_cache_path("joulebox", appauthor=False)) / "references"


def renderer_name(scene: str) -> str:
    """What renders a scene's reference, with its version."""
    if mitsuba_side.can_render(scene):
        return f"mitsuba-{mitsuba_side.mitsuba().__version__}"
    return "joulebox-path"


def file_of(wanted: Wanted, spp: int, size: int) -> Path:
    """The file of one reference; size 0 is the scene's own film."""
    digest = load_scene(wanted.scene, wanted.defines).sha256[:16]
    shape = f"{size}px-" if size else ""
    return folder() / f"{wanted.scene}-{digest}-{shape}{spp}spp-{renderer_name(wanted.scene)}.npz"


def read(file: Path) -> Reference:
    """A reference that was kept."""
    with np.load(file) as kept:
        return Reference(kept["mean"], kept["squares"], int(kept["passes"]), int(kept["spp"]), str(kept["origin"]))


def write(file: Path, reference: Reference) -> None:
    """Keep a reference; the file appears whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(f".{file.name}.partial.npz")
    np.savez_compressed(
        partial, mean=reference.mean, squares=reference.squares, passes=reference.passes, spp=reference.spp,
        origin=reference.origin,
    )  # fmt: skip
    os.replace(partial, file)


class Packed(NamedTuple):
    """A reference in grey, (H, W) f8: the mean over channels, and the standard error of that mean, which is bounded by
    the root of the channels' mean variance, as if they all erred alike.
    """

    mean: F8
    error: F8


def pack(file: Path, scene: str, reference: Reference) -> None:
    """Write a reference as Packed in half precision (2e-4 of each value, 1e-8 of the picture's mean)."""
    variance = reference.variance_of_mean
    assert variance is not None, "one pass tells no standard error"
    mean = reference.mean.mean(axis=2)
    scale = mean.mean()
    error = np.sqrt(variance.clip(0).mean(axis=2))
    np.savez_compressed(
        file, mean=(mean / scale).astype(np.float16), error=(error / scale).astype(np.float16), scale=scale,
        passes=reference.passes, spp=reference.spp, origin=reference.origin, scene_sha256=load_scene(scene).sha256,
    )  # fmt: skip


def unpack(file: Path, scene: str) -> Packed:
    """What `pack` wrote, of the scene as it is now."""
    with np.load(file) as kept:
        assert str(kept["scene_sha256"]) == load_scene(scene).sha256, f"{scene} changed: render and --pack it again"
        scale = float(kept["scale"])
        return Packed(kept["mean"].astype(np.float64) * scale, kept["error"].astype(np.float64) * scale)


def load_reference(
    scene: str, defines: Mapping[str, str] | None = None, *, size: int = 0, with_variance: bool = False
) -> Reference | None:
    """The best reference there is: the scene's own reference.exr, else the kept one of most samples, else None.

    with_variance   pass over the scene's own file, which tells no spread
    """
    wanted = Wanted(scene, defines or {})
    shipped = find_scene(scene).with_name(SHIPPED)
    if shipped.is_file() and not (defines or size or with_variance):
        mean = read_exr(shipped).astype(np.float64)
        return Reference(mean, np.zeros_like(mean), 0, 0, shipped.name)
    pattern = file_of(wanted, 0, size).name.replace("-0spp-", "-[0-9]*spp-")
    kept = [read(file) for file in folder().glob(pattern)]
    return max(kept, key=lambda reference: reference.passes * reference.spp, default=None)


def passes(wanted: Wanted, spp: int, size: int, first: int) -> Iterator[F4]:
    """Endless independent pictures of a scene, from pass number `first` on."""
    if mitsuba_side.can_render(wanted.scene):
        scene = mitsuba_side.load(wanted.scene, wanted.defines, size=size)
        while True:
            yield mitsuba_side.render(scene, spp, seed=1000 + first).pixels
            first += 1
    film = {"width": size, "height": size} if size else {}
    while True:
        settings = make_settings(OWN_SETTINGS, {"samples_per_pixel": spp, "seed": 1000 + first}, film)
        with Session(wanted.scene, settings, wanted.defines) as session:
            yield session.render().pixels
        first += 1


def make_reference(wanted: Wanted, pass_count: int, spp: int, size: int) -> Reference:
    """Render what is missing of one reference, keeping it after every pass."""
    file = file_of(wanted, spp, size)
    reference = read(file) if file.is_file() else None
    done = reference.passes if reference else 0
    if done >= pass_count:
        say(f"{wanted}: {done} passes of {spp} samples a pixel are there ({file.name})")
    start = time.monotonic()
    for number, picture in enumerate(passes(wanted, spp, size, done) if done < pass_count else (), start=done + 1):
        if reference is None:
            zeros = np.zeros(picture.shape)
            origin = mitsuba_side.describe() if mitsuba_side.can_render(wanted.scene) else "joulebox indirect=path"
            reference = Reference(zeros, zeros.copy(), 0, spp, origin)
        reference.add(picture)
        write(file, reference)
        left_s = (time.monotonic() - start) / (number - done) * (pass_count - number)
        say(f"{wanted}: pass {number} of {pass_count}, {noise(reference)}about {left_s:.0f} s left")
        if number >= pass_count:
            break
    assert reference
    return reference


def noise(reference: Reference) -> str:
    """The reference's own error in words: the mean standard error over the mean value."""
    if reference.variance_of_mean is None:
        return ""
    return f"standard error {100 * np.sqrt(reference.variance_of_mean).mean() / reference.mean.mean():.2f} %, "


def default_scenes() -> list[Wanted]:
    """Every shipped scene without a reference of its own."""
    return [
        Wanted(entry.name, defines)
        for entry in list_scenes()
        if not (entry.path / SHIPPED).is_file()
        for defines in VARIANTS.get(entry.name, [{}])
    ]


def say(text: str) -> None:
    """A line of progress."""
    print(text, file=sys.stderr, flush=True)


def main() -> int:
    """Make the references that the command line names."""
    parser = argparse.ArgumentParser(prog="references", description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="SCENE or SCENE:name=value,...; default: all without reference.exr")
    parser.add_argument("--passes", type=int, default=PASSES, help=f"independent pictures (default {PASSES})")
    parser.add_argument("--spp", type=int, default=SPP, help=f"samples a pixel of each (default {SPP})")
    parser.add_argument("--size", type=int, default=0, help="pixels across and down; 0: the scene's film")
    parser.add_argument("--list", action="store_true", help="print what would be rendered and what is kept")
    parser.add_argument("--pack", type=Path, metavar="FOLDER", help="also write FOLDER/SCENE.npz, small, for tests")
    given = parser.parse_args()
    wanted = [Wanted.parse(text) for text in given.scenes] or default_scenes()
    if min(given.passes, given.spp) < 1 or given.size < 0:
        parser.error("--passes and --spp are at least 1, --size is not negative")
    try:
        for each in wanted:
            if given.list:
                kept = load_reference(each.scene, each.defines, size=given.size, with_variance=True)
                print(each, f"{kept.passes} x {kept.spp} samples by {kept.origin}" if kept else "not there", sep="\t")
                continue
            reference = make_reference(each, given.passes, given.spp, given.size)
            if given.pack:
                pack(given.pack / f"{each.scene}.npz", each.scene, reference)
    except RenderError as error:
        print(f"references: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        say("interrupted; what is done is kept, and the next run goes on from there")
        return 130
    if mitsuba_side.variant() == mitsuba_side.SCALAR:
        say(f"note: rendered with {mitsuba_side.SCALAR}, which is slow. {mitsuba_side.NO_LLVM}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
