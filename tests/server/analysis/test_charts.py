"""Charts: what they hold, and that Vega draws them. A schema error fails when the specification is made."""

import io
import json
from xml.etree import ElementTree

import pytest
from joulebox_server.analysis.candidates import Candidate
from joulebox_server.analysis.charts import MOST_BARS, stages_chart, trace_chart, tradeoff_chart
from joulebox_server.analysis.drawing import render
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.frame import View
from joulebox_server.analysis.trace import read_trace
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


def test_the_limit_and_the_budget_can_be_moved():
    spec = tradeoff_chart(small_sweep(), View(limit=50, budget=21))
    assert {param["name"]: param["value"] for param in spec["params"]} == {"limit": 50, "budget": 21}
    assert {"acceptable below 50", "budget 21 J"} <= {*words(spec)}
    for param in spec["params"]:
        param["value"] = {"limit": 80, "budget": None}[param["name"]]
    told = words(spec)
    assert "acceptable below 80" in told
    assert not any(text.startswith("budget") for text in told)
    with pytest.raises(AnalysisError, match="the limit is 0, it must be"):
        tradeoff_chart(small_sweep(), View(limit=0))


def test_points_are_paled_by_setting():
    spec = tradeoff_chart(small_sweep(), View(only={"photons": ["1,000", "5,000"]}))
    assert [row["shown"] for row in points_of(spec)] == [True, False, True, False]
    assert render(spec, "svg").decode().count('opacity="0.12"') == 2
    with pytest.raises(AnalysisError, match="no setting is named photon"):
        tradeoff_chart(small_sweep(), View(only={"photon": ["1"]}))


def test_fragile_and_predicted_points_have_marks_of_their_own():
    points = [
        point(f"p{i}", interval(1 + i), interval(90 - i), settings={"n": i}, fragile="a cliff" if i == 1 else None)
        for i in range(3)
    ]
    plain = words(tradeoff_chart(tradeoff_of([points[0]])))
    assert not any(text.startswith(("fragile", "predicted")) for text in plain)
    guess = Candidate(None, "n=9", {"n": 9}, {"n": 9}, interval(0.5, 0.1), interval(20, 5), None)
    spec = tradeoff_chart(tradeoff_of(points), predictions=[guess])
    assert {"fragile: a cliff is one step away", "predicted, not measured"} <= {*words(spec)}
    assert spec["datasets"]["predictions"][0]["difference"] == "20 (15 to 25), predicted"


def test_of_many_configurations_the_front_has_bars():
    stages = {"direct": {"time_s": 1.0}}
    many = [
        point(f"p{i}", interval(1 + i), interval(90 - i if i % 3 else 200), settings={"n": i}, stages=stages,
              on_front={"energy_j": bool(i % 3), "time_s": bool(i % 3)})
        for i in range(90)
    ]  # fmt: skip
    spec = stages_chart(tradeoff_of(many, axes=["n"]), chosen="p3")
    bars = {row["configuration"] for row in spec["data"]["values"]}
    assert "p3" in bars
    assert len(bars) <= MOST_BARS + 1
    assert all(int(name[1:]) % 3 for name in bars - {"p3"})
    assert f"{len(bars)} of 90, those on the front" in "".join(words(spec))


def test_a_trace_is_thinned_and_says_what_does_not_count():
    document = {"void_windows": [{"start_s": 0, "time_s": 1, "images": 1, "reason": "mains power appeared"}]}
    lines = b"".join(b'{"time_s": %d, "power_w": 5}\n' % k for k in range(5000))
    spec = trace_chart(small_sweep(), "photons=1000", read_trace(lines, document))
    outlined, line = (layer["data"]["values"] for layer in spec["layer"])
    assert outlined[0]["told"] == "does not count: mains power appeared"
    assert 1000 < len(line) <= 2000
    render(spec, "svg")
    with pytest.raises(AnalysisError, match="line 2 of the samples must be an object with time_s"):
        read_trace(b'{"time_s": 1, "power_w": 2}\n{"watts": 3}', {})
    with pytest.raises(AnalysisError, match="hold no power"):
        trace_chart(small_sweep(), "x", read_trace(b'{"time_s": 1}', {}))


def test_of_many_points_the_front_alone_has_intervals():
    def bars(count):
        points = [point(f"p{i}", interval(1 + i, 0.5), interval(500 + i % 7, 0.5)) for i in range(count)]
        spec = tradeoff_chart(tradeoff_of(points, axes=[]))
        drawn = ElementTree.fromstring(render(spec, "svg"))
        groups = [g for g in drawn.iter(f"{SVG}g") if "mark-rule role-mark" in g.get("class", "")]
        return max(len(list(g)) for g in groups), " ".join(words(spec))

    assert bars(20)[0] == 20
    count, told = bars(500)
    assert count < 20
    assert "95% intervals on the front" in told
