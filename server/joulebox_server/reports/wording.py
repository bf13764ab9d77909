"""What reports say of costs, qualities and settings, in sentences for a reader who was not there."""

from collections.abc import Mapping, Sequence

from joulebox_server.analysis.documents import EnergyQuality, Point, Tradeoff
from joulebox_server.analysis.frame import spread

QUALITY_LABELS: Mapping[EnergyQuality, str] = {
    "measured": "measured joules",
    "estimated": "estimated joules",
    "replayed": "replayed joules",
    "time_only": "time only",
}
QUALITY_MEANS: Mapping[EnergyQuality, str] = {
    "measured": "Joules were measured on the device while it rendered.",
    "estimated": (
        "Joules are estimated from processor time and a model of the device's power. They order settings well; "
        "their size is a guess."
    ),
    "replayed": (
        "Joules come from a recorded discharge that was replayed while the device rendered: the arithmetic is "
        "real, the power is another device's. Read them as an example and not as this device's joules."
    ),
    "time_only": (
        "This device has no energy source that can be read, so costs are seconds. Fewer seconds mean fewer joules "
        "only as long as the power is the same."
    ),
}


def quality_label(quality: EnergyQuality) -> str:
    """The word that stands beside every cost of this quality."""
    return QUALITY_LABELS[quality]


def cost_told(point: Point, tradeoff: Tradeoff) -> str:
    """A point's main cost with interval and quality: 3.84 J (3.72 to 3.96), replayed."""
    if tradeoff.main_axis == "time_s" or point.energy_j is None:
        return spread(point.time_s, "s")
    return energy_told(point)


def energy_told(point: Point) -> str:
    """A point's energy with interval and quality; "not known" without one."""
    told = spread(point.energy_j, "J")
    return told if point.energy_j is None or point.quality == "measured" else f"{told}, {point.quality}"


def render_command(scene: str, settings_file: str) -> str:
    """How to render a scene, by its label (`cornell-bunny detail=948`), with the settings in a file."""
    name, *defines = scene.split()
    return " ".join(["joulebox-render render", name, *(f"-D {d}" for d in defines), "--settings", settings_file])


def count_of(count: int, noun: str) -> str:
    """1 scene, 2 scenes."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def listed(names: Sequence[str]) -> str:
    """a, b and c."""
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else "".join(names)
