"""The bsdfs of a scene as rows of Materials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from joulebox_render.records import BLACK, DIFFUSE, F8, GLASS, MIRROR, PHONG, Materials
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
# Beyond it a lobe is narrower than single precision resolves; a conductor is meant.
_LARGEST_EXPONENT = 1e5


@dataclass(frozen=True)
class Material:
    """One row of Materials; see there."""

    kind: int
    albedo: F8
    ior: float = 1.0
    two_sided: bool = False
    glossy: F8 = field(default_factory=lambda: np.zeros(3))
    exponent: float = 0.0


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
            glossy=np.array([row.glossy for row in rows], dtype=np.float32).reshape(-1, 3),
            exponent=np.array([row.exponent for row in rows], dtype=np.float32),
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
            "phong": _phong,
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
            raise properties.element.error(
                f"twosided has {len(nested)} bsdfs inside; give it one diffuse or phong bsdf"
            )
        if nested[0].type not in ("diffuse", "phong"):
            raise nested[0].error(f'twosided works around a diffuse or phong bsdf, not around "{nested[0].type}"')
        return replace(self._read(nested[0]), two_sided=True)


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


def _phong(properties: Properties) -> Material:
    """Mitsuba 0.6's Phong: albedo / pi + glossy (n + 2) / (2 pi) cos^n, the cosine taken to the mirror direction."""
    blame = properties.line_of("exponent")
    exponent = properties.take_float("exponent", 30.0, at_least=0.0)
    if exponent > _LARGEST_EXPONENT:
        raise blame.error(f'"exponent" is {exponent:g}; it must be at most {_LARGEST_EXPONENT:g}')
    albedo = properties.take_reflectance("diffuse_reflectance", _DEFAULT_REFLECTANCE)
    glossy = properties.take_reflectance("specular_reflectance", 0.2)
    if (albedo + glossy).max() > 1.0 + 1e-6:
        raise properties.element.error(
            f"phong reflects {(albedo + glossy).max():.3g} of the light in one channel; diffuse_reflectance and "
            "specular_reflectance must add up to at most 1"
        )
    if not glossy.any():
        return _reflecting(DIFFUSE, albedo)
    return Material(PHONG, albedo, glossy=glossy, exponent=exponent)
