"""Irradiance from photon maps: density estimates at points, estimates made ahead, and direct visualisation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from joulebox_render.kernels.gathering import estimate_irradiance, nearest_irradiance
from joulebox_render.records import F4, F8, Points, Scratch, Tree
from joulebox_render.stages.context import Context
from joulebox_render.stages.photon_map import PhotonMap, grow_tree

FILTERS = {"constant": 0, "cone": 1, "epanechnikov": 2}
# A density estimate visits about as much memory as this many rays.
RAYS_PER_ESTIMATE = 16


class IrradianceRecords(NamedTuple):
    """Irradiance computed ahead at some photons' positions: tree, irradiance (R, 3) f4 in its order [W m^-2].

    reach_m is how far a look-up may go: records of every nth photon lie sqrt(n) times as far apart as photons.
    """

    tree: Tree
    irradiance: F4
    reach_m: float


@dataclass(frozen=True)
class DensityEstimate:
    """How photons around a point become irradiance."""

    photons: PhotonMap
    count: int
    reach_m: float
    cos_limit: float
    filter_kind: int

    def __call__(self, position: F4, normal: F4) -> F4:
        """Irradiance (N, 3) f4 at points [W m^-2]."""
        irradiance = np.empty((len(position), 3), np.float32)
        estimate_irradiance(
            self.photons.tree, self.photons.flux, position, normal, self.count, self.reach_m,
            self.cos_limit, self.filter_kind, Scratch.empty(self.count), irradiance,
        )  # fmt: skip
        return irradiance


def global_estimate(context: Context, photons: PhotonMap) -> DensityEstimate:
    """The estimate that the settings ask for in the global map."""
    settings = context.settings
    return DensityEstimate(
        photons, settings.gather_count, settings.gather_distance_m,
        math.cos(math.radians(settings.normal_angle_deg)), FILTERS[settings.gather_filter],
    )  # fmt: skip


def caustic_estimate(context: Context, photons: PhotonMap) -> DensityEstimate:
    """The estimate that the settings ask for in the caustic map, with its own count and distance."""
    settings = context.settings
    return DensityEstimate(
        photons, settings.caustic_gather_count, settings.caustic_gather_distance_m,
        math.cos(math.radians(settings.normal_angle_deg)), FILTERS[settings.gather_filter],
    )  # fmt: skip


@dataclass(frozen=True)
class Illumination:
    """What a gather ray asks where it ends.

    resolution_m is the distance below which the photon map cannot tell places apart [m].
    """

    estimate: DensityEstimate
    records: IrradianceRecords | None
    caustics: DensityEstimate | None

    @property
    def resolution_m(self) -> float:
        return self.estimate.reach_m

    def look_up(self, points: Points) -> F4:
        """Irradiance (N, 3) f4: that of the records, or a density estimate where none are kept."""
        if self.records is None:
            return self.estimate(points.position, points.normal)
        irradiance = np.empty((len(points.owner), 3), np.float32)
        nearest_irradiance(
            self.records.tree, self.records.irradiance, points.position, points.normal,
            self.records.reach_m, self.estimate.cos_limit, Scratch.empty(1), irradiance,
        )  # fmt: skip
        return irradiance


def precompute_irradiance(context: Context, photons: PhotonMap) -> IrradianceRecords:
    """Irradiance at every nth photon of the global map, n = photon_spacing (Christensen 1999)."""
    step = context.settings.photon_spacing
    position = np.ascontiguousarray(photons.tree.position[::step])
    normal = np.ascontiguousarray(photons.tree.normal[::step])
    estimate = global_estimate(context, photons)

    def chunk(first: int, last: int) -> F4:
        return estimate(position[first:last], normal[first:last])

    parts = list(context.pool.map_chunks(chunk, len(position), RAYS_PER_ESTIMATE))
    irradiance = np.concatenate(parts) if parts else np.zeros((0, 3), np.float32)
    tree, order = grow_tree(position, normal)
    return IrradianceRecords(tree, np.ascontiguousarray(irradiance[order]), estimate.reach_m * math.sqrt(step))


def show_photons(context: Context, estimate: DensityEstimate, points: Points) -> F8:
    """Radiance (points, 3) f8 that points reflect of the photons around them (direct visualisation)."""

    def chunk(first: int, last: int) -> F8:
        irradiance = estimate(points.position[first:last], points.normal[first:last])
        return points.albedo[first:last].astype(np.float64) / math.pi * irradiance

    parts = list(context.pool.map_chunks(chunk, len(points.owner), RAYS_PER_ESTIMATE))
    return np.concatenate(parts) if parts else np.zeros((0, 3))
