"""How a sweep's file becomes configurations: every rule, drawn or written out, and what a preview says."""

import math
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from fake_device import sweep
from hypothesis import given
from hypothesis import strategies as st
from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.sweeps.expansion import configuration_count, configurations, plan_jobs, reference_configuration
from pydantic import ValidationError
from server_testing import Server
from test_errors import told


def definition(**changes: Any) -> SweepDefinition:
    return SweepDefinition.model_validate(sweep(**changes))


RANGES = {"gather_count": {"low": 10, "high": 500, "scale": "log"}, "gather_distance_m": {"low": 0.01, "high": 0.05}}


@pytest.mark.parametrize("rule", ["random", "sobol"])
def test_drawn_from_ranges(rule: str) -> None:
    """As many as asked, all different, whole where the ends are, within them, the same for the same seed."""
    drawn = definition(rule=rule, samples=50, axes=RANGES)
    found = [configuration.changed for configuration in configurations(drawn)]
    assert len(found) == configuration_count(drawn) == 50
    assert len({tuple(changed.values()) for changed in found}) == 50
    assert all(type(changed["gather_count"]) is int and 10 <= changed["gather_count"] <= 500 for changed in found)
    assert all(0.01 <= changed["gather_distance_m"] <= 0.05 for changed in found)
    assert found == [configuration.changed for configuration in configurations(drawn)]
    other = definition(rule=rule, samples=50, axes=RANGES, sample_seed=1)
    assert found != [configuration.changed for configuration in configurations(other)]


def test_sobol_fills_the_space_evenly() -> None:
    """32 points of a Sobol sequence: one in each 32nd of every axis, on the scale of the axis."""
    axes = {"a": {"low": 0.0, "high": 1.0}, "b": {"low": 1.0, "high": 1024.0, "scale": "log"}}
    found = configurations(definition(rule="sobol", samples=32, axes=axes))
    assert sorted(int(configuration.changed["a"] * 32) for configuration in found) == list(range(32))
    places = [math.log2(configuration.changed["b"]) / 10 * 32 for configuration in found]
    assert sorted(int(place) for place in places) == list(range(32))


def test_a_whole_range_draws_each_value_alike() -> None:
    """Ends included: 5 values of 2,000 draws without repetition are all of them."""
    found = configurations(definition(rule="random", samples=5, axes={"n": {"low": 1, "high": 5}}))
    assert sorted(configuration.changed["n"] for configuration in found) == [1, 2, 3, 4, 5]


def test_the_ends_of_a_whole_range_come_as_often_as_its_middle() -> None:
    """3,000 draws of 1, 2, 3: each 1,000 times, sigma 26; 5 sigma either way is a false alarm once in a million."""
    axes = {"n": {"low": 1, "high": 3}, "other": {"low": 0.0, "high": 1.0}}
    found = [one.changed["n"] for one in configurations(definition(rule="random", samples=3000, axes=axes))]
    assert all(abs(found.count(value) - 1000) < 130 for value in (1, 2, 3))


def test_a_space_that_holds_fewer_than_asked() -> None:
    for rule in ("random", "sobol"):
        found = configurations(definition(rule=rule, samples=50, axes={"a": [1, 2], "b": ["x", "y", True]}))
        assert len(found) == 6


@given(
    low=st.integers(-1000, 1000),
    width=st.integers(1, 1000),
    samples=st.integers(1, 20),
    rule=st.sampled_from(["random", "sobol"]),
    seed=st.integers(0, 2**53),
)
def test_any_range(low: int, width: int, samples: int, rule: str, seed: int) -> None:
    drawn = definition(rule=rule, samples=samples, sample_seed=seed, axes={"n": {"low": low, "high": low + width}})
    found = [configuration.changed["n"] for configuration in configurations(drawn)]
    assert all(low <= value <= low + width for value in found)
    assert 1 <= len(found) <= samples


VALUES = st.none() | st.booleans() | st.floats() | st.text(max_size=3) | st.integers()
DOCUMENTS = st.recursive(
    VALUES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
)


@given(DOCUMENTS, st.sampled_from(sorted(SweepDefinition.model_fields)))
def test_any_value_in_any_field_is_a_sweep_or_a_sentence(value: Any, field: str) -> None:
    """Whatever stands in a field: a definition whose plan can be made, or pydantic's errors and nothing else."""
    try:
        found = SweepDefinition.model_validate(sweep(**{field: value}))
    except ValidationError:
        return
    if configuration_count(found) > 2000 or found.repeats * found.controls > 2000:
        return  # refused by the server's limits before anything is made
    measured = configurations(found)
    jobs = plan_jobs(found, measured, reference_configuration(found), "key")
    places = [(job.block, job.position, job.purpose, job.scene, job.repeat) for job in jobs]
    assert len(set(places)) == len(places)
    counted = {(job.purpose, job.scene, job.configuration, job.repeat) for job in jobs}
    assert len(counted) == len(jobs)  # what the table of jobs asks for


BAD: list[tuple[dict[str, Any], str]] = [
    ({"rule": "random"}, "samples and rule"),
    ({"samples": 4}, "samples and rule"),
    ({"rule": "sobol", "samples": 4, "axes": {}}, "draws from axes"),
    ({"axes": {"n": {"low": 1, "high": 5}}}, "needs a list of values"),
    ({"rule": "random", "samples": 4, "axes": {"n": {"low": 5, "high": 5}}}, "low 5 must be less than high 5"),
    ({"rule": "random", "samples": 4, "axes": {"n": {"low": 0, "high": 5, "scale": "log"}}}, "must be more than 0"),
    ({"rule": "random", "samples": 4, "axes": {"n": {"low": 0}}}, "axes.n.high: this field is missing"),
    ({"rule": "random", "samples": 4, "axes": {"gather_count": {"low": 0, "high": 9}}}, "0 must be at least 1"),
    ({"rule": "random", "samples": 9999}, "at most 2000"),
    ({"controls": 100, "repeats": 1000}, "at most 20000"),
]


@pytest.mark.parametrize(("changes", "sentence"), BAD)
def test_rules_that_cannot_be_followed(server: Server, changes: dict[str, Any], sentence: str) -> None:
    server.device()
    answer = server.client.post("/v1/sweeps:preview", headers=server.operator, json=sweep(**changes))
    told(answer, 422, "invalid", sentence)


def test_preview_of_charges(server: Server) -> None:
    """Joules from the power that was measured, charges from the battery that the device told of."""
    device = server.device()
    server.add_sweep(axes={}, repeats=1)
    asked = sweep(repeats=2, controls=1)

    def preview() -> dict[str, Any]:
        answer = server.client.post("/v1/sweeps:preview", headers=server.operator, json=asked)
        assert answer.status_code == 200, answer.text
        return dict(answer.json())

    unknown = preview()
    assert (unknown["energy_j"], unknown["battery_charges"]) == (None, None)
    while leased := device.lease(conditions={"battery_full_j": 36_000.0}):
        device.finish(leased[0])
    found = preview()
    assert found["jobs"] == {"total": 8, "measure": 4, "reference": 1, "noise_floor": 1, "control": 2, "metered": 7}
    least_s = 7 * (2 * 1.0 + 20) + 20
    assert found["time_s"]["low"] == pytest.approx(least_s)
    assert found["power_w"] == pytest.approx(10, rel=1e-3)
    assert found["energy_j"] == pytest.approx(10 * least_s, rel=1e-3)
    assert found["battery_charges"] == pytest.approx(10 * least_s / (0.6 * 36_000), rel=1e-3)
    assert found["battery_full_j"] == 36_000.0


def test_the_sweep_in_the_docs() -> None:
    """docs/fleet.md shows a sweep that is one: 64 configurations, of which four fill 20 windows."""
    text = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text(encoding="utf-8")
    shown = tomllib.loads(re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1])  # type: ignore[index]
    found = SweepDefinition.model_validate(shown)
    measured = configurations(found)
    jobs = plan_jobs(found, measured, reference_configuration(found), "docs")
    assert len(measured) == 64
    assert sum(job.metered and job.purpose == "measure" for job in jobs) == 4 * 2
    assert sum(job.purpose == "control" for job in jobs) == 2 * 3 * 2


def planned_seeds(definition: SweepDefinition) -> dict[str, list[int]]:
    jobs = plan_jobs(definition, configurations(definition), reference_configuration(definition), "order")
    return {purpose: [job.seed for job in jobs if job.purpose == purpose] for purpose in {job.purpose for job in jobs}}


def test_own_seeds_are_no_one_elses() -> None:
    """Of 2 x 3 configurations, 4 repeats: 24 seeds, the same each time; what is judged by keeps the sweep's."""
    axes = {"gather_count": [50, 100, 150], "global_photons": [1000, 2000]}
    own = planned_seeds(definition(axes=axes, repeats=4, controls=1, seeds="own"))
    shared = planned_seeds(definition(axes=axes, repeats=4, controls=1))
    assert len(set(own["measure"])) == 24
    assert all(0 <= seed <= 2**53 for seed in own["measure"])
    assert sorted(shared["measure"]) == sorted(6 * [0, 1, 2, 3])
    assert all(own[purpose] == shared[purpose] for purpose in ("reference", "noise_floor", "control"))
    assert own == planned_seeds(definition(axes=axes, repeats=4, controls=1, seeds="own"))
    other = planned_seeds(definition(axes=axes, repeats=4, seeds="own", settings={"seed": 1}))
    assert not set(own["measure"]) & set(other["measure"])


def test_a_configuration_has_the_same_own_seeds_in_any_sweep() -> None:
    """So that its picture can be found again; what else the sweep varies changes nothing."""
    one = planned_seeds(definition(axes={"gather_count": [50]}, repeats=2, seeds="own"))
    more = planned_seeds(definition(axes={"gather_count": [50, 100]}, repeats=2, seeds="own"))
    assert set(one["measure"]) < set(more["measure"])


@pytest.mark.parametrize(
    ("changes", "own"),
    [
        ({"rule": "grid", "axes": {"gather_count": [1, 2]}}, False),
        ({"rule": "one_at_a_time", "axes": {"gather_count": [1, 2]}}, False),
        ({"rule": "random", "samples": 5, "axes": RANGES}, True),
        ({"rule": "sobol", "samples": 5, "axes": RANGES}, True),
        ({"rule": "sobol", "samples": 5, "axes": RANGES, "seeds": "shared"}, False),
        ({"rule": "sobol", "samples": 5, "axes": RANGES, "reference": {"seed_policy": "same"}}, False),
    ],
)
def test_what_is_drawn_has_own_seeds_unless_told_otherwise(changes: dict[str, Any], own: bool) -> None:
    assert definition(**changes).own_seeds is own


def test_own_seeds_cannot_be_compared_with_references_of_the_same_seed() -> None:
    with pytest.raises(ValidationError, match=r'seeds = "own" needs reference\.seed_policy = "other"'):
        definition(seeds="own", reference={"seed_policy": "same"})
