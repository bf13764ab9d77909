"""Where methods fail: the regimes, each rendered with many seeds, and lines of single settings that show cliffs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from joulebox_server.analysis.documents import Point as TradePoint
from joulebox_server.analysis.documents import Tradeoff
from joulebox_server.analysis.ratings import why_fragile
from joulebox_server.analysis.stability import Stability, over_seeds, relative_spread
from joulebox_server.thesis.batch import Plan, Sweep
from joulebox_server.thesis.ratings import limit_of, tradeoff_of
from joulebox_server.thesis.results import MissingError, Point, Results

SEEDS = 16
SIDE = {"quick": 64, "full": 256}
EXPONENTS = (-4, 4)
"""Powers of ten of the room's size."""
DIRECT_VISUALISATION: dict[str, Any] = {"indirect": "direct_visualization", "global_photons": 100_000}
GOOD: dict[str, Any] = {
    "indirect": "final_gather",
    "samples_per_pixel": 4,
    "global_photons": 200_000,
    "final_gather_rays": 256,
    "irradiance_cache_tolerance": 0.0,
    "shadow_rays": 16,
    "caustic_photons": 200_000,
}
"""The reference of every regime: a gather at every point, with many rays and photons."""


@dataclass(frozen=True)
class Regime:
    """Settings, on a scene, where a method is expected to fail; the renderer's defaults but for these."""

    name: str
    words: str
    method: str
    scene: str
    settings: Mapping[str, Any]
    defines: Mapping[str, str] = field(default_factory=dict)
    base: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def sweep(self) -> str:
        """The sweep that renders it: one a scene with its variables."""
        return "-".join(["stability", self.scene, *(f"{name}{value}" for name, value in self.defines.items())])


def _of_size(exponent: int) -> Regime:
    size = "tiny" if exponent < 0 else "huge"
    words = f"a room of 0.555 m times 1e{exponent}"
    # lengths among the settings go with the scene; what is left is what the renderer makes of coordinates
    lengths = {"gather_distance_m": 0.02 * 10.0**exponent, "caustic_gather_distance_m": 0.006 * 10.0**exponent}
    return Regime(size, words, "final gathering", "scaled-room", {"final_gather_rays": 64},
                  {"exponent": str(exponent)}, lengths)  # fmt: skip


def _dv(name: str, words: str, scene: str, **changed: Any) -> Regime:
    return Regime(name, words, "direct visualisation", scene, DIRECT_VISUALISATION | changed)


def _fg(name: str, words: str, scene: str, defines: Mapping[str, str] | None = None, **changed: Any) -> Regime:
    return Regime(name, words, "final gathering", scene, changed, defines or {})


REGIMES: tuple[Regime, ...] = (
    _dv("few-photons", "5,000 photons", "cornell-boxes", global_photons=5_000),
    _dv("small-radius", "a gather distance of 0.004 m", "cornell-boxes", gather_distance_m=0.004),
    _dv("large-radius", "a gather distance of 0.2 m", "cornell-boxes", gather_distance_m=0.2, gather_count=1_000),
    _fg("high-tolerance", "a tolerance of 4", "cornell-boxes", irradiance_cache_tolerance=4.0),
    _fg("few-rays", "16 gather rays", "cornell-boxes", final_gather_rays=16),
    Regime("few-paths", "4 paths a pixel", "path tracing", "cornell-boxes",
           {"indirect": "path", "samples_per_pixel": 4}),
    Regime("tiny-caustic", "5,000 caustic photons for spheres of 0.02 m", "caustic map", "cornell-spheres",
           {"caustic_photons": 5_000, "caustic_hints": False}, {"radius": "0.02"}),
    Regime("high-ior", "5,000 caustic photons through glass of index 2.4", "caustic map", "cornell-spheres",
           {"caustic_photons": 5_000}, {"ior": "2.4"}),
    _fg("gap", "light through a door that is 5 degrees open", "veach-door", {"opening": "5"}, global_photons=20_000),
    _dv("thin-wall", "a wall of 0.004 m between light and dark", "thin-wall"),
    _fg("corners", "a lamp in a corner, 64 gather rays", "corner-light", final_gather_rays=64),
    Regime("many-lights", "sixteen lamps, one shadow ray and 1,000 direct photons each", "direct light", "many-lights",
           {"shadow_rays": 1, "use_shadow_photons": True, "direct_photons": 1_000}),
    *(_of_size(exponent) for exponent in EXPONENTS),
)  # fmt: skip

LINES: Mapping[str, tuple[Mapping[str, Any], tuple[Any, ...]]] = {
    "global_photons": (DIRECT_VISUALISATION, (1_000, 5_000, 25_000, 100_000)),
    "gather_distance_m": (DIRECT_VISUALISATION | {"gather_count": 1_000}, (0.002, 0.004, 0.01, 0.02, 0.05, 0.2)),
    "irradiance_cache_tolerance": ({}, (0.2, 0.8, 1.6, 4.0)),
    "final_gather_rays": ({}, (4, 16, 64, 256)),
    "samples_per_pixel": ({"indirect": "path"}, (1, 4, 16, 64)),
}
"""Settings that are moved alone, from good to bad, and where the others stay meanwhile."""
LINES_SWEEP = "stability-lines"
LINES_SCENE = "cornell-boxes"
LEAK_SWEEPS = {"stability-leak-0.004": "0.004", "stability-leak-0.05": "0.05"}
"""With and without a leak, by the wall's thickness [m]."""
LEAK: Mapping[str, Any] = DIRECT_VISUALISATION | {"global_photons": 1_000_000, "gather_count": 1_000}
"""So many photons that their noise is not all of the difference: with a tenth of them it hides the leak."""
METHODS = {"direct_visualization": "direct visualisation", "path": "path tracing", "final_gather": "final gathering"}


def sweeps(plan: Plan) -> list[Sweep]:
    """One a scene, every regime on it with all seeds; then the lines, and a thin wall beside a thick one."""
    made: dict[str, Sweep] = {}
    for regime in REGIMES:
        scene: Any = {"name": regime.scene, "defines": dict(regime.defines)} if regime.defines else regime.scene
        sweep = made.setdefault(regime.sweep, _sweep(plan, regime.sweep, scene, dict(regime.base), SEEDS))
        sweep["configurations"].append(dict(regime.settings))
    lines = _sweep(plan, LINES_SWEEP, LINES_SCENE, {}, plan.pick(1, SEEDS))
    lines["configurations"] = [{**rest, name: v} for name, (rest, values) in LINES.items() for v in values]
    return [*made.values(), lines, *(_leak_sweep(plan, name, wall_m) for name, wall_m in LEAK_SWEEPS.items())]


def _leak_sweep(plan: Plan, name: str, wall_m: str) -> Sweep:
    scene: Any = {"name": "thin-wall", "defines": {"thickness": wall_m}}
    return _sweep(plan, name, scene, {}, plan.pick(8, SEEDS)) | {"configurations": [dict(LEAK)]}


def _sweep(plan: Plan, name: str, scene: Any, base: dict[str, Any], repeats: int) -> Sweep:
    side = plan.pick(SIDE["quick"], SIDE["full"])
    return {
        "name": name,
        "scenes": [scene],
        "settings": base | {"width": side, "height": side},
        "rule": "list",
        "configurations": [],
        "repeats": repeats,
        "controls": 0,
        "reference": {"settings": GOOD, "seed_policy": "other"},
    }


@dataclass(frozen=True)
class Found:
    """A regime with what its seeds showed; costs are joules or CPU seconds, whatever the run rests on."""

    regime: Regime
    point: Point
    limit: float
    stability: Stability
    fragile: str | None

    @property
    def differences(self) -> list[float]:
        """To the reference, one a seed."""
        return _differences(self.point)

    @property
    def costs(self) -> list[float]:
        """Of an image, one a seed."""
        return [row.image.on(self.point.basis) for row in self.point.rows]

    @property
    def cost_spread(self) -> Any:
        """Standard deviation of the costs over their mean, with its interval."""
        return relative_spread(self.costs)


def found(results: Results) -> list[Found]:
    """Every regime that was rendered with two seeds or more. Raises MissingError for none."""
    known = [one for regime in REGIMES if (one := _found(results, regime)) is not None]
    if not known:
        raise MissingError("no regime was rendered with two seeds or more")
    return known


def of(results: Results, name: str) -> Found:
    """One regime. Raises MissingError without it."""
    for one in found(results):
        if one.regime.name == name:
            return one
    raise MissingError(f"the regime {name} was not rendered with two seeds or more")


def _found(results: Results, regime: Regime) -> Found | None:
    points = results.points(regime.sweep, None, **{**regime.base, **regime.settings})
    if len(points) != 1 or len(_differences(points[0])) < 2:
        return None
    point, limit = points[0], limit_of(points[0])
    tradeoff = tradeoff_of(points, results.points(regime.sweep, purpose="reference"))
    return Found(regime, point, limit, over_seeds(_differences(point), limit), _fragile(tradeoff, limit))


def _fragile(tradeoff: Tradeoff, limit: float) -> str | None:
    """As a recommendation would say it of the one point there is; beyond the limit it would not be recommended."""
    only: TradePoint = tradeoff.points[0]
    return why_fragile(tradeoff, only, limit)


def method_of(name: str) -> str:
    """The method whose setting a line moves."""
    return METHODS[LINES[name][0].get("indirect", "final_gather")]


def line(results: Results, name: str) -> list[Point]:
    """The points along a line, from its first value to its last."""
    rest, values = LINES[name]
    found = [results.points(LINES_SWEEP, LINES_SCENE, **{**rest, name: value}) for value in values]
    return [points[0] for points in found if len(points) == 1]


def lines_tradeoff(results: Results) -> Tradeoff:
    """All lines as one trade-off, whose ratings tell the cliffs. Raises MissingError without points."""
    points = results.points(LINES_SWEEP, LINES_SCENE)
    if not points:
        raise MissingError("no line of a setting was rendered")
    return tradeoff_of(points, results.points(LINES_SWEEP, purpose="reference"), tuple(LINES))


def _differences(point: Point) -> list[float]:
    return [row.difference for row in point.rows if row.difference is not None]
