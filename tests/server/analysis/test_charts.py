"""Charts: what they hold, and that Vega draws them. A schema error fails when the specification is made."""

import io
import json
from xml.etree import ElementTree

import pytest
from joulebox_server.analysis.charts import render, stages_chart, tradeoff_chart
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.frame import View
from measured import interval, point, small_sweep, tradeoff_of
from PIL import Image

SVG = "{http://www.w3.org/2000/svg}"


def words(spec):
    """All words in the drawn picture."""
    return [text.text or "" for text in ElementTree.fromstring(render(spec, "svg")).iter(f"{SVG}text")]


def points_of(spec):
    layer = next(layer for layer in spec["layer"] if layer.get("name", "").startswith("points"))
    return spec["datasets"][layer["data"]["name"]]


def test_tradeoff_shows_everything_it_should():
    spec = tradeoff_chart(small_sweep("replayed"), View(budget=21))
    assert spec["width"] == "container"
    told = words(spec)
    assert "energy per image [J], replayed" in told
    assert "difference to the reference (ltdiff-style, no unit)" in told
    assert {"cornell-boxes on laptop", "acceptable below 100", "noise floor 6", "budget 21 J", "reference"} <= {*told}
    assert {"1,000", "2,000", "5,000", "10,000", "photons"} <= {*told}  # the colours' legend
    assert "3 repeats a point, 95% intervals, 256 x 256 pixels" in told


def test_points_carry_intervals_and_settings_for_tooltips():
    rows = points_of(tradeoff_chart(small_sweep(), View(scale="linear")))
    assert [row["configuration_id"] for row in rows] == ["c0", "c1", "c2", "c3"]
    first = rows[0]
    assert first["x_low"] < first["x"] < first["x_high"]
    assert first["y_low"] < first["y"] < first["y_high"]
    assert (first["x"], first["y"]) == pytest.approx((10.1, 244.8))
    assert (first["setting_photons"], first["setting_rays"]) == (1000, 16)
    assert first["energy"].startswith("10.1 J (")
    assert first["difference"].startswith("245")


@pytest.mark.parametrize("x", ["energy_j", "time_s", "energy_j_per_pixel"])
@pytest.mark.parametrize("y", ["difference", "difference_per_pixel"])
def test_every_axis_and_scale_is_drawn(x, y):
    scale = "linear" if (x == "time_s") == (y == "difference") else "log"
    spec = tradeoff_chart(small_sweep(), View(x, y, scale))
    picture = ElementTree.fromstring(render(spec, "svg", 300))
    assert picture.tag == f"{SVG}svg"
    assert "NaN" not in ElementTree.tostring(picture, encoding="unicode")
    factor = 1 / 65536 if x == "energy_j_per_pixel" else 1
    assert points_of(spec)[0]["x"] == pytest.approx({"time_s": 1.01}.get(x, 10.1) * factor)


def test_log_is_taken_where_values_span_a_lot():
    far = tradeoff_of([point("a", interval(1), interval(90)), point("b", interval(30), interval(50))])
    scales = {}
    for name, made in (("near", small_sweep()), ("far", far)):
        layer = next(la for la in tradeoff_chart(made)["layer"] if la.get("name", "").startswith("points"))
        scales[name] = (layer["encoding"]["x"]["scale"]["type"], layer["encoding"]["y"]["scale"]["type"])
    assert scales == {"near": ("linear", "log"), "far": ("log", "linear")}


def test_zero_is_drawn_on_a_logarithmic_axis():
    made = tradeoff_of([point("same", interval(5), interval(0)), point("b", interval(1), interval(50))])
    spec = tradeoff_chart(made, View(scale="log"))
    assert all(row["y_low"] > 0 for row in points_of(spec))
    render(spec, "svg")


def test_an_unconfirmed_front_is_dashed():
    confirmed = tradeoff_chart(small_sweep())
    single = tradeoff_chart(small_sweep(count=1))
    assert "on the front, not confirmed" not in words(confirmed)
    assert "on the front, not confirmed" in words(single)
    assert 'stroke-dasharray="5,4"' in render(single, "svg").decode()
    assert 'stroke-dasharray="5,4"' not in render(confirmed, "svg").decode()


def test_colour_by_words_and_by_many_numbers():
    points = [
        point(f"p{i}", interval(1 + i), interval(90 - i), settings={"kind": "ab"[i % 2], "n": i}) for i in range(12)
    ]
    assert {"a", "b", "kind"} <= {*words(tradeoff_chart(tradeoff_of(points), View(colour_by="kind")))}
    assert "n" in words(tradeoff_chart(tradeoff_of(points), View(colour_by="n")))
    with pytest.raises(AnalysisError, match="no setting is named photon, colour_by must be one"):
        tradeoff_chart(small_sweep(), View(colour_by="photon"))


def test_no_joules_are_drawn_where_none_are_known():
    made = small_sweep("time_only")
    with pytest.raises(AnalysisError, match="the chart must be over time_s"):
        tradeoff_chart(made)
    told = words(tradeoff_chart(made, View(x="time_s")))
    assert "time per image [s]" in told
    assert not any("[J]" in text for text in told)
    assert "time per image [s]" in words(stages_chart(made))


def test_nothing_measured_is_said_and_not_drawn():
    empty = tradeoff_of([], energy_quality="time_only")
    assert "nothing to show yet" in words(tradeoff_chart(empty))
    assert "nothing to show yet" in words(stages_chart(empty))


def test_stages_stack_up_to_the_image():
    """Direct and indirect are 40 and 50 % by construction: a tenth is left over."""
    spec = stages_chart(small_sweep("replayed"))
    rows = [row for row in spec["data"]["values"] if row["configuration"] == "photons=1000"]
    assert [row["stage"] for row in rows] == ["direct", "indirect", "other"]
    assert sum(row["cost"] for row in rows) == pytest.approx(10.1)
    told = words(spec)
    assert {"energy per image [J], replayed", "1,000", "10,000", "reference", "direct", "other"} <= {*told}
    assert "time per image [s]" in words(stages_chart(small_sweep(), unit="time_s"))
    with pytest.raises(AnalysisError, match="has an energy, the chart must be over time_s"):
        stages_chart(small_sweep("time_only"), unit="energy_j")


def test_bars_with_equal_labels_stay_apart():
    points = [
        point(name, interval(1), interval(1), label="same", stages={"direct": {"time_s": 1.0}}) for name in ("a", "b")
    ]
    spec = stages_chart(tradeoff_of(points, axes=[]))
    assert {row["bar"] for row in spec["data"]["values"]} == {"same (a)", "same (b)"}


def test_a_picture_is_as_wide_as_asked():
    spec = tradeoff_chart(small_sweep())
    before = json.dumps(spec)
    with Image.open(io.BytesIO(render(spec, "png", 400))) as picture:
        assert 800 < picture.width < 1000
    assert json.dumps(spec) == before
    with pytest.raises(AnalysisError, match="the width is 10 pixels, it must be from 200"):
        render(spec, "png", 10)
    with pytest.raises(AnalysisError, match="the format is gif"):
        render(spec, "gif")


def test_nothing_is_fetched():
    for spec in (tradeoff_chart(small_sweep()), stages_chart(small_sweep())):
        text = json.dumps({key: value for key, value in spec.items() if key != "$schema"})
        assert "http" not in text
        assert '"url"' not in text
