"""The picture of power over time."""

from pathlib import Path
from typing import Any

import pytest
from joulebox_agent.errors import UsageError
from joulebox_agent.estimates.windows import Window
from joulebox_agent.loop import ImageEvent, StageEvent
from joulebox_agent.measuring.plot import MOST_POINTS, plot_format, power_chart, save_chart
from joulebox_agent.measuring.recording import Recording, VoidWindow
from joulebox_agent.sampling.sampler import Sample
from joulebox_agent.sources.choose import choose
from joulebox_agent.sources.reading import Reading


def recorded(samples: list[Sample]) -> Recording:
    choice = choose("replay")
    record = Recording(choice.source, choice.report, 100.0, samples=samples, idle=[(101.0, 104.0)])
    window = Window(105.0)
    for image in range(3):
        start_s = 105.0 + image
        stages = [
            StageEvent(event="stage", image=image, name="direct", start_s=start_s, end_s=start_s + 0.4),
            StageEvent(event="stage", image=image, name="indirect", start_s=start_s + 0.4, end_s=start_s + 1.0),
        ]
        window.add(ImageEvent(event="image", image=image, start_s=start_s, end_s=start_s + 1.0, time_s=1.0, cpu_s=1.0,
                              pixel_sha256="a"), stages)  # fmt: skip
    record.windows.append(window)
    record.blocks.append(0)
    record.voided.append(VoidWindow(109.0, 112.0, 3, "the machine slept"))
    return record


def rows(spec: dict[str, Any], layer: dict[str, Any]) -> list[dict[str, Any]]:
    """The data of a layer: beside it or among the chart's datasets."""
    return layer["data"].get("values") or spec["datasets"][layer["data"]["name"]]


def test_the_chart_shows_power_windows_idle_voids_and_stages(tmp_path: Path) -> None:
    samples = [Sample(100.0 + i / 2, Reading(power_w=10.0 + i % 3, raw=(i,))) for i in range(30)]
    samples[8] = Sample(104.0, Reading(problem="EIO"))
    spec = power_chart([recorded(samples)]).to_dict()
    whole, stages = spec["vconcat"]
    spans = rows(spec, whole["layer"][0])
    assert [(s["kind"], s["start_s"], s["end_s"]) for s in spans] == [
        ("window", 5.0, 8.0), ("void", 9.0, 12.0), ("idle", 1.0, 4.0)]  # fmt: skip
    points = rows(spec, whole["layer"][1])
    assert points[0] == {"time_s": 0.0, "power_w": 10.0}
    assert points[8]["power_w"] is None  # a failed reading breaks the line
    assert [band["stage"] for band in rows(spec, stages["layer"][0])] == ["direct", "indirect"] * 3
    for name, magic in (("p.png", b"\x89PNG"), ("p.svg", b"<svg")):
        save_chart(power_chart([recorded(samples)]), tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(magic)


def test_a_counter_is_drawn_as_the_power_between_its_movements() -> None:
    samples = [Sample(100.0 + i, Reading(counter_j=20.0 * (i // 2), raw=(i // 2,))) for i in range(9)]
    spec = power_chart([recorded(samples)]).to_dict()
    points = rows(spec, spec["vconcat"][0]["layer"][1])
    assert [point["power_w"] for point in points] == pytest.approx([10.0] * 4)


def test_a_long_session_keeps_its_peaks() -> None:
    samples = [Sample(100.0 + i, Reading(power_w=10.0 + (i == 20_001), raw=(i,))) for i in range(30_000)]
    spec = power_chart([recorded(samples)]).to_dict()
    points = rows(spec, spec["vconcat"][0]["layer"][1])
    assert len(points) <= MOST_POINTS + 1
    assert max(point["power_w"] for point in points) == 11.0
    assert [p["time_s"] for p in points] == sorted(p["time_s"] for p in points)


def test_only_pictures_are_drawn() -> None:
    assert plot_format(Path("a.SVG")) == "svg"
    with pytest.raises(UsageError, match=r"must end in \.png or \.svg"):
        plot_format(Path("a.pdf"))
    with pytest.raises(ValueError, match="at least one recording"):
        power_chart([])
