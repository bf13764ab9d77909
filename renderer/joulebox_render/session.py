"""A scene and settings made ready once, rendered any number of times, and what is reported of it."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from joulebox_render import __version__
from joulebox_render.clock import Interval, StageClock
from joulebox_render.errors import RenderError
from joulebox_render.images import pixel_sha256
from joulebox_render.integrator import Rendering, render_image
from joulebox_render.intersect import Intersector
from joulebox_render.kernels import compilation
from joulebox_render.memory import keep_freed_memory
from joulebox_render.plan import Plan, make_plan
from joulebox_render.pool import CHUNK_RAYS, WorkerPool
from joulebox_render.records import F4, Scene
from joulebox_render.scene import load_scene
from joulebox_render.settings import Settings
from joulebox_render.stages.context import Context
from joulebox_render.tables import scene_tables


@dataclass(frozen=True)
class Image:
    """One rendered image: pixels (height, width, 3) f4 linear RGB and its part of the report."""

    pixels: F4
    start_ns: int
    end_ns: int
    cpu_s: float
    clock: StageClock
    photons: dict[str, int]
    irradiance_records: int
    notes: list[str]

    @property
    def time_s(self) -> float:
        """From the first photon to the last pixel."""
        return (self.end_ns - self.start_ns) * 1e-9

    @cached_property
    def pixel_sha256(self) -> str:
        """Hash of the pixels; the same for any number of threads and any chunk size."""
        return pixel_sha256(self.pixels)


class Session:
    """Everything that happens before the first photon: load, build, compile; then `render` as often as wanted.

    Settings are resolved: width and height come from the scene's film where they are not set. `intersector` is
    "embree", "bvh", or "auto" for Embree where there is one.
    """

    def __init__(
        self,
        scene: str | Path,
        settings: Settings,
        defines: Mapping[str, str] | None = None,
        force_all: bool = False,
        chunk_rays: int = CHUNK_RAYS,
        intersector: str = "auto",
    ) -> None:
        keep_freed_memory()
        start = time.perf_counter()
        self.scene: Scene = load_scene(scene, defines or {})
        self.settings = settings.model_copy(
            update={
                "width": settings.width or self.scene.film_width,
                "height": settings.height or self.scene.film_height,
            }
        )
        tables = scene_tables(self.scene)
        loaded = time.perf_counter()
        queries = Intersector(tables, intersector)
        built = time.perf_counter()
        self.plan: Plan = make_plan(self.scene, self.settings, force_all)
        self._pool = WorkerPool(self.settings.threads, chunk_rays)
        self.context = Context(tables, queries, self.settings, self.plan, self._pool)
        self._warm_up()
        compiled = time.perf_counter()
        self.setup = {
            "load_s": loaded - start, "bvh_s": built - loaded, "compile_s": compiled - built,
        }  # fmt: skip

    def _warm_up(self) -> None:
        """Run every kernel that the plan needs once, on a miniature, so that no image pays for compiling."""
        small = self.settings.model_copy(
            update={
                "width": 4, "height": 4, "samples_per_pixel": 1, "global_photons": 64, "caustic_photons": 4,
                "direct_photons": min(64, self.settings.direct_photons), "shadow_rays": 4, "final_gather_rays": 4,
            }
        )  # fmt: skip
        context = Context(self.context.tables, self.context.intersector, small, self.plan, self._pool)
        render_image(context, self.scene.camera, StageClock())

    def render(
        self,
        listener: Callable[[Interval], None] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Image:
        """Render one image."""
        clock = StageClock(listener)
        start, cpu_start = time.perf_counter_ns(), time.process_time()
        try:
            rendering = render_image(self.context, self.scene.camera, clock, progress)
        except MemoryError:
            raise RenderError(
                f"the settings need more memory than there is: {self.settings.global_photons} global photons at "
                f"{self.settings.width}x{self.settings.height}; lower global_photons or samples_per_pixel"
            ) from None
        cpu_s, end = time.process_time() - cpu_start, time.perf_counter_ns()
        return Image(
            rendering.pixels, start, end, cpu_s, clock, photon_counts(rendering, clock),
            irradiance_record_count(rendering), photon_notes(rendering),
        )  # fmt: skip

    def stop(self) -> None:
        """Give up the image that is being rendered: `render` raises StoppedError. May be called by a signal handler."""
        self._pool.stop()

    def build(self) -> dict[str, Any]:
        """What made the picture."""
        return {
            "name": "joulebox-render", "version": __version__, "intersector": self.context.intersector.name,
            "isa": compilation.ISA, "threads": self._pool.threads,
        }  # fmt: skip

    def header(self) -> dict[str, Any]:
        """The part of a report that is known before rendering."""
        return {
            "scene": self.scene.name,
            "scene_sha256": self.scene.sha256,
            "settings": self.settings.model_dump(),
            "build": self.build(),
            "setup": self.setup,
            "plan": {"run": self.plan.run, "left_out": self.plan.left_out},
        }

    def report(self, image: Image) -> dict[str, Any]:
        """The report of one image, as documented in docs/design."""
        return {
            **self.header(),
            "image": {
                "time_s": image.time_s, "cpu_s": image.cpu_s, "width": self.settings.width,
                "height": self.settings.height, "pixel_sha256": image.pixel_sha256,
            },
            "stages": image.clock.totals(),
            "thesis_stages": image.clock.thesis_totals(),
            "photons": image.photons,
            "irradiance_records": image.irradiance_records,
            "notes": [*self.scene.notes, *image.notes],
            "peak_rss_bytes": peak_rss_bytes(),
        }  # fmt: skip

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.__exit__(kind, error, trace)


def photon_counts(rendering: Rendering, clock: StageClock) -> dict[str, int]:
    """Photons stored in each map and emitted for it, 0 where there is no map, and rays that shadow photons saved."""
    counts: dict[str, int] = {}
    for name, photons in (("global", rendering.maps.global_map), ("caustic", rendering.maps.caustic_map)):
        counts[f"{name}_stored"] = photons.stored if photons else 0
        counts[f"{name}_emitted"] = photons.emitted if photons else 0
    seen = rendering.maps.shadow_map
    counts["direct_stored"] = seen.direct_stored if seen else 0
    counts["direct_emitted"] = seen.emitted if seen else 0
    counts["shadow_stored"] = seen.shadow_stored if seen else 0
    counts["shadow_rays_saved"] = sum(interval.rays_saved for interval in clock.intervals)
    return counts


def irradiance_record_count(rendering: Rendering) -> int:
    """Records of the irradiance cache, or, without one, of precomputed irradiance."""
    if rendering.maps.cache is not None:
        return len(rendering.maps.cache.records.radius)
    return len(rendering.maps.irradiance.irradiance) if rendering.maps.irradiance else 0


def photon_notes(rendering: Rendering) -> list[str]:
    """A sentence for each map that could not be filled."""
    maps = (("global", rendering.maps.global_map), ("caustic", rendering.maps.caustic_map))
    notes = [
        f"the {name} photon map holds only {photons.stored} photons after {photons.emitted} were emitted: "
        f"hardly any light takes such paths in this scene"
        for name, photons in maps
        if photons and not photons.complete
    ]
    seen = rendering.maps.shadow_map
    if seen and not seen.complete:
        notes.append(
            f"only {seen.direct_stored} direct photons were stored after {seen.emitted} were emitted: hardly any light "
            f"of area lights falls on surfaces in this scene, so shadow photons save few rays"
        )
    return notes


def peak_rss_bytes() -> int:
    """Largest resident memory of this process so far.

    Linux counts in ru_maxrss what the process was before it became this program, a copy of whoever started it; VmHWM
    counts this program alone.
    """
    status = Path("/proc/self/status")
    if status.is_file() and (found := re.search(r"^VmHWM:\s*(\d+) kB$", status.read_text(), re.MULTILINE)):
        return int(found[1]) * 1024
    try:
        import resource
    except ImportError:
        return int(psutil.Process().memory_info().peak_wset)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if psutil.MACOS else peak * 1024)
