"""Images of a loop, gathered into contiguous windows that end where an image ends."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from joulebox_agent.loop import ImageEvent, StageEvent


@dataclass
class StageTotals:
    """Sums over the images of a window [s, s, count], and when the stage ran: (start_s, end_s) in order.

    specular_*  the part that went to what is seen through mirrors and glass
    """

    time_s: float = 0.0
    cpu_s: float = 0.0
    rays: float = 0.0
    specular_time_s: float = 0.0
    specular_cpu_s: float = 0.0
    intervals: list[tuple[float, float]] = field(default_factory=list)


@dataclass
class Window:
    """A stretch of wall time that holds whole images, gaps between them included.

    image_time_s  sum of the images' own times (first photon to last pixel), at most `wall_s`
    image_ends_s  when its images ended, in order; empty where only their number is known
    lead_s        how long the same images were rendered before it, and
    trail_s       after it, as far as is known
    """

    start_s: float
    end_s: float = 0.0
    images: int = 0
    image_time_s: float = 0.0
    cpu_s: float = 0.0
    stages: dict[str, StageTotals] = field(default_factory=dict)
    image_ends_s: list[float] = field(default_factory=list)
    lead_s: float = 0.0
    trail_s: float = 0.0

    @property
    def load_s(self) -> tuple[float, float]:
        """The stretch (start, end) of the same load that it lies in."""
        return self.start_s - self.lead_s, self.end_s + self.trail_s

    @property
    def wall_s(self) -> float:
        return self.end_s - self.start_s

    def pieces(self, count: int) -> list[tuple[float, float, float]]:
        """The window cut into `count` stretches of about equal length: (start_s, end_s, images in it).

        They end where an image ends; where only the number of images is known they hold equal parts of it.
        """
        cuts = range(1, count + 1)
        if len(self.image_ends_s) < count:
            ends = [(self.start_s + self.wall_s * cut / count, self.images * cut / count) for cut in cuts]
        else:
            ends_at = [round(len(self.image_ends_s) * cut / count) for cut in cuts]
            ends = [(self.image_ends_s[images - 1], float(images)) for images in ends_at]
        begins = [(self.start_s, 0.0), *ends[:-1]]
        return [(b_s, e_s, upto - done) for (b_s, done), (e_s, upto) in zip(begins, ends, strict=True)]

    def add(self, image: ImageEvent, stages: list[StageEvent]) -> None:
        self.end_s = image.end_s
        self.image_ends_s.append(image.end_s)
        self.images += 1
        self.image_time_s += image.time_s
        self.cpu_s += image.cpu_s
        for stage in stages:
            totals = self.stages.setdefault(stage.name, StageTotals())
            totals.time_s += stage.end_s - stage.start_s
            totals.cpu_s += stage.cpu_s
            totals.rays += stage.rays
            if stage.through_specular:
                totals.specular_time_s += stage.end_s - stage.start_s
                totals.specular_cpu_s += stage.cpu_s
            totals.intervals.append((stage.start_s, stage.end_s))


def stage_intervals(windows: Iterable[Window]) -> dict[str, list[tuple[float, float]]]:
    """When each stage ran, (start_s, end_s), over all windows."""
    found: dict[str, list[tuple[float, float]]] = {}
    for window in windows:
        for name, totals in window.stages.items():
            found.setdefault(name, []).extend(totals.intervals)
    return found


def stage_energies_j(window: Window, energy_j: float) -> Mapping[str, float]:
    """Equation 2 of the thesis: E_stage = T_stage / T_total x E_total, over the window's whole wall time.

    Right only if every stage draws the same power; time between stages keeps its share for itself.
    """
    return {name: totals.time_s / window.wall_s * energy_j for name, totals in window.stages.items()}
