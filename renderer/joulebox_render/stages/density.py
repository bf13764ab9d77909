"""Irradiance from photon maps: density estimates at points, and direct visualisation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from joulebox_render.kernels.gathering import aim_at_witnesses, estimate_irradiance
from joulebox_render.records import F4, F8, I4, U8, Estimates, Points, Scratch
from joulebox_render.stages.context import Context
from joulebox_render.stages.coverage import correct_boundaries
from joulebox_render.stages.photon_map import PhotonMap

FILTERS = {"constant": 0, "cone": 1, "epanechnikov": 2}
# A density estimate visits about as much memory as this many rays.
RAYS_PER_ESTIMATE = 16
# How far above the surface sight lines between points and photons bulge, as a share of their length.
SIGHT_LIFT = 0.1
# Every how many-th of an estimate's witnesses is looked at where there are many points to ask for.
FEW_WITNESSES_STEP = 4


@dataclass(frozen=True)
class DensityEstimate:
    """How photons around a point become irradiance.

    Given a context, estimates are corrected for discs that hang over edges, or, where `in_sight`, for photons that
    something hides from the point.
    """

    photons: PhotonMap
    count: int
    reach_m: float
    cos_limit: float
    filter_kind: int
    context: Context | None = None
    in_sight: bool = False

    def __call__(self, position: F4, normal: F4, key: U8) -> Estimates:
        """Irradiance at points with position [m] and normal (N, 3) f4 and random key (N,) u8."""
        estimates = Estimates.empty(len(position))
        estimate_irradiance(
            self.photons.tree, self.photons.flux, position, normal, self.count, self.reach_m,
            self.cos_limit, self.filter_kind, Scratch.empty(self.count), estimates,
        )  # fmt: skip
        if self.context is not None and self.in_sight:
            some = np.flatnonzero(estimates.found)
            few = np.ascontiguousarray(estimates.witness[some, ::FEW_WITNESSES_STEP])
            share = share_in_sight(self.context, self.photons, position[some], normal[some], few)
            estimates.irradiance[some] *= share[:, None]
        elif self.context is not None:
            correct_boundaries(self.context, self.cos_limit, self.filter_kind, position, normal, key, estimates)
        return estimates


def share_in_sight(context: Context | None, photons: PhotonMap, position: F4, normal: F4, witness: I4) -> F4:
    """Share (N,) f4 of the photons named in witness (N, W) i4 that nothing hides from points.

    Sight lines run a tenth of their length above the surface, clear of what it curves: what hides photons is a wall
    thinner than the disc.
    """
    if context is None:
        return np.ones(len(position), np.float32)
    count = witness.shape[1]
    room = len(position) * count
    origin, direction = np.empty((2, room, 3), np.float32)
    limit = np.empty(room, np.float32)
    aim_at_witnesses(
        photons.tree, witness, np.ascontiguousarray(position), np.ascontiguousarray(normal),
        float(context.tables.epsilon[0]), SIGHT_LIFT, origin, direction, limit,
    )  # fmt: skip
    hidden = context.intersector.occluded(origin, direction, limit).reshape(-1, count)
    share: F4 = np.float32(1) - hidden.mean(axis=1, dtype=np.float32)
    return share


def global_estimate(context: Context, photons: PhotonMap) -> DensityEstimate:
    """The estimate that the settings ask for in the global map."""
    settings = context.settings
    return DensityEstimate(
        photons, settings.gather_count, settings.gather_distance_m,
        math.cos(math.radians(settings.normal_angle_deg)), FILTERS[settings.gather_filter], context,
    )  # fmt: skip


def caustic_estimate(context: Context, photons: PhotonMap) -> DensityEstimate:
    """The estimate that the settings ask for in the caustic map, with its own count and distance.

    Its filter is always the cone, which keeps the edges of caustics (Jensen 2001, section 7.2). It is not corrected at
    edges: a caustic seldom fills its disc anyway, and what it lacks is no surface. But it ends at thin mirrors.
    """
    settings = context.settings
    return DensityEstimate(
        photons, settings.caustic_gather_count, settings.caustic_gather_distance_m,
        math.cos(math.radians(settings.normal_angle_deg)), FILTERS["cone"], context, in_sight=True,
    )  # fmt: skip


def probe_keys(points: Points) -> U8:
    """A random key (N,) u8 for each point's probes."""
    keys: U8 = points.key + points.sample.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    return keys


def show_photons(context: Context, estimate: DensityEstimate, points: Points) -> F8:
    """Radiance (points, 3) f8 that points reflect of the photons around them (direct visualisation)."""
    keys = probe_keys(points)

    def chunk(first: int, last: int) -> F8:
        irradiance = estimate(points.position[first:last], points.normal[first:last], keys[first:last]).irradiance
        return points.albedo[first:last].astype(np.float64) / math.pi * irradiance

    parts = context.pool.map_chunks(chunk, len(points.owner), RAYS_PER_ESTIMATE)
    return np.concatenate(parts) if parts else np.zeros((0, 3))
