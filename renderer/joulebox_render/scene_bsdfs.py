"""The bsdfs of a scene as rows of Materials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from joulebox_render.records import BLACK, DIFFUSE, F8, GLASS, MIRROR, Materials
from joulebox_render.scene_values import Properties
from joulebox_render.scene_xml import Element, suggest

# Indices of refraction that Mitsuba 3 knows by name.
_IOR = {
    "vacuum": 1.0,
    "helium": 1.00004,
    "hydrogen": 1.00013,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water": 1.3330,
    "acetone": 1.36,
    "ethanol": 1.361,
    "carbon tetrachloride": 1.461,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "silicone oil": 1.52045,
    "bromine": 1.661,
    "water ice": 1.31,
    "fused quartz": 1.458,
    "pyrex": 1.470,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.5750,
    "diamond": 2.419,
}
_DEFAULT_REFLECTANCE = 0.5


@dataclass(frozen=True)
class Material:
    """One row of Materials; see there."""

    kind: int
    albedo: F8
    ior: float = 1.0
    two_sided: bool = False


class MaterialTable:
    """Rows of Materials: one a bsdf element, however many shapes refer to it."""

    def __init__(self, objects_by_id: Mapping[str, Element]) -> None:
        self._objects_by_id = objects_by_id
        self._rows: list[Material] = []
        self._row_of: dict[int | str, int] = {}

    def row(self, bsdf: Element) -> int:
        """The row of a <bsdf>, read on first use; SceneError for one this renderer does not have."""
        key = id(bsdf)
        if key not in self._row_of:
            self._row_of[key] = self._append(self._read(bsdf))
        return self._row_of[key]

    def check(self, bsdfs: Iterable[Element]) -> None:
        """Read also the bsdfs that no shape uses: a mistake in them is a mistake; they get no row."""
        for bsdf in bsdfs:
            if id(bsdf) not in self._row_of:
                self._read(bsdf)

    def default_row(self, emits: bool) -> int:
        """The row of a shape without bsdf: diffuse 0.5, or black for a light (as Mitsuba does)."""
        key = "default of a light" if emits else "default"
        if key not in self._row_of:
            reflectance = 0.0 if emits else _DEFAULT_REFLECTANCE
            self._row_of[key] = self._append(_reflecting(DIFFUSE, np.full(3, reflectance)))
        return self._row_of[key]

    def table(self) -> Materials:
        """All rows so far."""
        rows = self._rows
        return Materials(
            kind=np.array([row.kind for row in rows], dtype=np.int32),
            albedo=np.array([row.albedo for row in rows], dtype=np.float32).reshape(-1, 3),
            ior=np.array([row.ior for row in rows], dtype=np.float32),
            two_sided=np.array([row.two_sided for row in rows], dtype=np.uint8),
        )

    def _append(self, material: Material) -> int:
        self._rows.append(material)
        return len(self._rows) - 1

    def _read(self, bsdf: Element) -> Material:
        readers = {
            "diffuse": _diffuse,
            "dielectric": _dielectric,
            "conductor": _conductor,
            "twosided": self._two_sided,
        }
        if bsdf.type not in readers:
            raise bsdf.error(f'unknown bsdf "{bsdf.type}"{suggest(bsdf.type, readers)}')
        properties = Properties(bsdf, self._objects_by_id)
        material = readers[bsdf.type](properties)
        properties.finish()
        return material

    def _two_sided(self, properties: Properties) -> Material:
        nested = properties.take_objects("bsdf")
        if len(nested) != 1:
            raise properties.element.error(f"twosided has {len(nested)} bsdfs inside; give it one diffuse bsdf")
        if nested[0].type != "diffuse":
            raise nested[0].error(f'twosided works around a diffuse bsdf, not around "{nested[0].type}"')
        inner = self._read(nested[0])
        return Material(inner.kind, inner.albedo, two_sided=True)


def _reflecting(kind: int, albedo: F8) -> Material:
    return Material(kind if albedo.max() > 0.0 else BLACK, albedo)


def _diffuse(properties: Properties) -> Material:
    return _reflecting(DIFFUSE, properties.take_reflectance("reflectance", _DEFAULT_REFLECTANCE))


def _dielectric(properties: Properties) -> Material:
    inside = properties.take_number_or_name("int_ior", _IOR["bk7"], _IOR)
    outside = properties.take_number_or_name("ext_ior", _IOR["air"], _IOR)
    for name in ("specular_reflectance", "specular_transmittance"):
        blame = properties.line_of(name)
        if not np.array_equal(properties.take_reflectance(name, 1.0), np.ones(3)):
            raise blame.error(f'"{name}" of a dielectric must be 1; tinted glass is not supported')
    return Material(GLASS, np.ones(3), ior=inside / outside)


def _conductor(properties: Properties) -> Material:
    properties.take_choice("material", "none", ("none",))
    for name in ("eta", "k"):
        if properties.has(name):
            raise properties.line_of(name).error(
                f'"{name}" of a conductor is not supported; use material "none", a perfect mirror, '
                "with specular_reflectance"
            )
    return _reflecting(MIRROR, properties.take_reflectance("specular_reflectance", 1.0))
