"""Ray queries: Embree or a BVH for triangles, closed forms for spheres and disks, behind one interface.

Embree is called through embreex in batches; where embreex has no wheel (ARM Linux) our own bounding volume
hierarchy takes its place. Both, and the kernels, release the GIL, so threads of the worker pool trace at the same
time. A query's answer does not depend on the batch it was asked in.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from joulebox_render.bvh import Bvh, Stack, grow_bvh
from joulebox_render.errors import SettingsError
from joulebox_render.kernels.bvh import closest_triangles, occluded_triangles
from joulebox_render.kernels.surface import closest_analytic, occluded_analytic
from joulebox_render.records import F4, U1, Hits
from joulebox_render.tables import SceneTables

try:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
except ImportError:
    TriangleMesh = EmbreeScene = None

FAR = np.float32(1e30)


def choose(wanted: str) -> str:
    """ "embree" or "bvh" for what was asked for; "auto" is Embree where embreex can be imported.

    Raises SettingsError for anything else, and for Embree where there is none.
    """
    if wanted not in ("auto", "embree", "bvh"):
        raise SettingsError(f"intersector is auto, embree or bvh, not {wanted!r}")
    if wanted == "embree" and EmbreeScene is None:
        raise SettingsError("the intersector embree needs the package embreex, which cannot be imported; take bvh")
    if wanted == "auto":
        return "bvh" if EmbreeScene is None else "embree"
    return wanted


class Intersector:
    """The acceleration structure of one scene; `name` says which it is, "embree" or "bvh".

    traced counts the rays of all queries so far.
    """

    def __init__(self, tables: SceneTables, wanted: str = "auto") -> None:
        self.name = choose(wanted)
        self.tables = tables
        self.traced = 0
        self._counting = threading.Lock()
        self.embree: Any = None
        self.bvh: Bvh | None = None
        if len(tables.triangles) == 0:
            return
        if self.name == "bvh":
            self.bvh = grow_bvh(tables.vertices, tables.triangles)
        else:
            self.embree = EmbreeScene(robust=True)
            TriangleMesh(self.embree, tables.vertices, tables.triangles)
            # Embree commits on the first query, which must not happen on two threads at once.
            self.closest(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def closest(self, origin: F4, direction: F4) -> Hits:
        """Nearest hit of each ray; origin and direction (N, 3) f4, directions unit."""
        count = len(origin)
        self._count(count)
        if self.embree is not None and count:
            answer = self.embree.run(origin, direction, query="INTERSECT", output=True)
            distance, primitive = answer["tfar"], answer["primID"].astype(np.int32, copy=False)
            np.copyto(distance, FAR, where=primitive < 0)
            u, v = answer["u"], answer["v"]
        else:
            distance, primitive = np.full(count, FAR, np.float32), np.full(count, -1, np.int32)
            u, v = np.zeros((2, count), np.float32)
            if self.bvh is not None:
                closest_triangles(self.bvh, origin, direction, Stack.empty(), distance, primitive, u, v)
        if len(self.tables.analytic_kind):
            closest_analytic(self.tables, origin, direction, distance, primitive)
        return Hits(distance, primitive, u, v)

    def occluded(self, origin: F4, direction: F4, limit: F4) -> U1:
        """1 where anything lies on the ray nearer than `limit` (N,) f4 [m], which is not overwritten."""
        count = len(origin)
        self._count(count)
        blocked = np.zeros(count, np.uint8)
        if self.embree is not None and count:
            answer = self.embree.run(origin, direction, dists=limit.copy(), query="OCCLUDED")
            blocked = (answer >= 0).view(np.uint8)
        elif self.bvh is not None:
            occluded_triangles(self.bvh, origin, direction, limit, Stack.empty(), blocked)
        if len(self.tables.analytic_kind):
            occluded_analytic(self.tables, origin, direction, limit, blocked)
        return blocked

    def _count(self, rays: int) -> None:
        with self._counting:
            self.traced += rays
