"""The replay source and the trace that travels in the package."""

from pathlib import Path

import numpy as np
import pytest
from agent_testing import ScriptedClock
from joulebox_agent.errors import UsageError
from joulebox_agent.sources.choose import choose, parse_replay
from joulebox_agent.sources.replay import Replay, bundled_trace, parse_trace, read_trace


def test_bundled_trace_is_what_it_says_it_is() -> None:
    """Refreshed every 3 to 5 s, 16.8 W on average over the time each reading is held."""
    trace = bundled_trace()
    held_s = np.diff([*trace.times_s, trace.period_s])
    assert held_s.min() >= 3.0
    assert held_s.max() <= 5.0
    assert np.average(trace.power_w, weights=held_s) == pytest.approx(16.8, abs=0.01)


def test_it_is_labelled_and_never_chosen_by_itself(tmp_path: Path) -> None:
    choice = choose("replay")
    assert choice.source.quality == "replayed"
    assert "never accepted as a measurement" in choice.report.reason
    assert choose("auto", tmp_path).source.method == "none"


def test_rows_are_held_and_the_trace_loops() -> None:
    clock = ScriptedClock()
    source = Replay(parse_trace("t_s,power_w\n10,5\n12,7\n", "t", as_json=False), clock=clock)
    seen = []
    for _ in range(5):
        seen.append(source.read())
        clock.time_s += 1.0
    assert [reading.power_w for reading in seen] == [5, 5, 7, 7, 5]
    assert seen[0].raw == seen[1].raw != seen[2].raw
    assert seen[4].raw != seen[0].raw  # the second round is another update


def test_a_chosen_refresh_interpolates_between_rows() -> None:
    clock = ScriptedClock()
    source = Replay(parse_trace("t_s,power_w\n0,4\n2,8\n", "t", as_json=False), refresh_s=0.5, clock=clock)
    source.read()
    clock.time_s += 0.7
    assert source.read().power_w == pytest.approx(5.0)  # the tick at 0.5 s


def test_ndjson_is_read_like_csv(tmp_path: Path) -> None:
    file = tmp_path / "trace.ndjson"
    file.write_text('{"t_s": 0, "power_w": 3}\n{"t_s": 1, "power_w": 4}\n')
    assert read_trace(file).power_w == (3.0, 4.0)
    assert parse_replay(f"replay:{file}@0.25").refresh_s == 0.25
    assert parse_replay(f"replay:{file}").refresh_s is None
    assert parse_replay("replay@2").trace.name == bundled_trace().name


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t_s,power_w\n0,1\n", "at least two rows"),
        ("t_s,power_w\n0,1\n0,2\n", "Row 2"),
        ("t_s,power_w\n0,1\n1,-2\n", "Row 2"),
        ("t_s,power_w\n0,1\n1,nan\n", "power_w from 0 to 10000"),
        ("t_s,power_w\n0,1\n1,10001\n", "power_w from 0 to 10000"),
        ("t_s,power_w\n-1e308,1\n1e308,2\n", "t_s must be within"),
        ('t_s,power_w\n0,"' + "1" * 200_000 + '"\n', "not CSV"),
        ("time,watts\n0,1\n1,2\n", "Row 1"),
        ("t_s,power_w\n0,1\n1\n", "Row 2"),
    ],
)
def test_a_bad_trace_names_its_row(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        parse_trace(text, "bad.csv", as_json=False)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("[1, 2]", "Row 1"),
        ("[" * 100_000, "not NDJSON"),
        ('{"t_s": 0, "power_w": ' + "9" * 5000 + "}", "power_w from 0 to 10000"),
        ('{"t_s": 0, "power_w": 1e400}', "power_w from 0 to 10000"),
    ],
)
def test_a_bad_line_names_itself(line: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        parse_trace(line, "bad.ndjson", as_json=True)


def test_a_table_saved_by_an_office_program_is_read(tmp_path: Path) -> None:
    file = tmp_path / "trace.csv"
    file.write_text("t_s,power_w\n0,3\n1,4\n", encoding="utf-8-sig")
    assert read_trace(file).power_w == (3.0, 4.0)


@pytest.mark.parametrize("name", ["replay@soon", "replay@0", "replay@-1", "replay@1e-320", "replay@nan", "replay:/",
                                  "solar", "replay:/no/such.csv", "replay:/dev/zero", "replay:/dev/null"])  # fmt: skip
def test_a_bad_source_is_wrong_use(name: str) -> None:
    with pytest.raises(UsageError):
        choose(name)


def test_a_device_is_no_trace() -> None:
    """It may never end."""
    with pytest.raises(UsageError, match="is no file"):
        choose("replay:/dev/null")


def test_a_recorded_zero_is_a_void_sample_not_a_free_picture() -> None:
    """As of a gauge: no machine draws 0 W, and a picture of 0 J is no answer."""
    clock = ScriptedClock()
    source = Replay(parse_trace("t_s,power_w\n0,5\n1,0\n2,0.01\n", "t", as_json=False), clock=clock)
    assert source.read().power_w == 5
    for said in ("0 W", "0.01 W"):
        clock.time_s += 1.0
        reading = source.read()
        assert (reading.power_w, reading.problem) == (None, f"the recording says {said}, which no machine draws")


def test_a_trace_may_have_an_at_in_its_name(tmp_path: Path) -> None:
    file = tmp_path / "me@home" / "t.csv"
    file.parent.mkdir()
    file.write_text("t_s,power_w\n0,4\n2,8\n")
    assert parse_replay(f"replay:{file}").refresh_s is None
    assert parse_replay(f"replay:{file}@0.5").refresh_s == 0.5
