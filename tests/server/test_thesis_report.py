"""What a study writes of its rows: the report, claims.json, the page of the documentation; ratings; the booking."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from invented import invented
from joulebox_server.cli.connection import CommandError, WrongUseError
from joulebox_server.schemas.measure import Stage
from joulebox_server.thesis import catalogue, direct, discharge, dv
from joulebox_server.thesis.evaluation import write
from joulebox_server.thesis.ratings import ratings
from joulebox_server.thesis.reading import thesis_stages
from joulebox_server.thesis.results import Results
from joulebox_server.thesis.rows import Cost
from joulebox_server.thesis.scatter import Scatters, interval_of, paired
from joulebox_server.thesis.study import Study, basis_of


def cost(scene, s):
    share = 0.3 if s["use_shadow_photons"] else 1.0
    return {"photon_map": 0.1, "direct": s["shadow_rays"] / 50 * share}


def difference(scene, s):
    return {16: 350, 64: 40, 144: 0, 256: 10}[s["shadow_rays"]]


RESULTS = invented(direct.BATCH, cost, difference, noise=0.05)


@pytest.fixture
def study(tmp_path):
    """A study's folder with the rows of direct lighting and a replayed discharge."""
    found = Study.opened(tmp_path / "out", quick=True)
    rows = "".join(json.dumps(asdict(row)) + "\n" for row in RESULTS.rows)
    (found.folder / "rows.ndjson").write_text(rows)
    (found.folder / "discharge.json").write_text(json.dumps({"quality": "replayed", "samples": [[0, 16.0]] * 9}))
    return found


def test_rows_come_back_as_they_were(study):
    assert study.rows() == list(RESULTS.rows)
    results = study.results()
    assert (results.basis, results.quick, results.unit) == ("measured", True, "J")
    assert results.discharge == discharge.Discharge("replayed", ((0.0, 16.0),) * 9)


def test_the_report_holds_claims_figures_and_what_to_set(study, tmp_path):
    written = write(study, catalogue.BATCHES, tmp_path / "thesis.md")
    names = {path.name for path in written.files}
    assert {"report.html", "claims.json", "thesis.md", "figure-direct-cost.svg", "figure-direct-cost.png"} <= names
    claims = json.loads((study.folder / "claims.json").read_text())
    assert [claim["id"] for claim in claims] == ["ch8-rays", "ch8-photons", "ch8-picture"]
    assert claims[1]["verdict"] == "holds"
    assert claims[1]["basis"] == "measured"
    assert claims[1]["ours"]["value"] == pytest.approx(0.3)
    assert claims[1]["ours"]["low"] < 0.3 < claims[1]["ours"]["high"]
    assert written.document()["verdicts"] == {"holds": 3, "fails": 0, "unclear": 0}
    page, markdown = (study.folder / "report.html").read_text(), (tmp_path / "thesis.md").read_text()
    for text in (page, markdown):
        assert "What to set" in text
        assert "64 shadow rays, 1,000 photons, is the cheapest within the acceptable difference" in text
        assert "another seed of the reference differs by" in text
        assert "learnt from what the same sweep rendered more than once" in text
    assert 'src="http' not in page
    assert "| ch8-photons |" in markdown


def test_a_folder_that_holds_none_of_the_batches_says_so(study):
    with pytest.raises(CommandError, match="holds no result of dv yet"):
        write(study, [dv.BATCH], None)


def test_a_page_that_cannot_be_written_is_a_sentence(study, tmp_path):
    with pytest.raises(CommandError, match=r"no/thesis\.md cannot be written: No such file"):
        write(study, [direct.BATCH], tmp_path / "no" / "thesis.md")


def test_rows_that_are_damaged_are_a_sentence(study):
    with (study.folder / "rows.ndjson").open("a") as file:
        file.write('{"sweep": ')
    with pytest.raises(CommandError, match=r"rows\.ndjson cannot be read"):
        study.rows()


def test_batches_are_chosen_by_name_and_a_wrong_one_is_told():
    assert [batch.name for batch in catalogue.chosen(["dv", "fg"])] == ["fg", "dv"]
    assert catalogue.chosen(None) == list(catalogue.BATCHES)
    with pytest.raises(WrongUseError, match="no batch 'caustic'; did you mean caustics"):
        catalogue.chosen(["caustic"])


def test_ratings_follow_the_rules_of_the_analysis():
    """At 256 rays twice the cost of 64 and more: elasticity 1; the first step from 144 leads to 64 and 256."""
    (found,) = ratings(RESULTS, "direct", direct.SCENE, ["shadow_rays", "gather_count"]).values()
    assert (found.setting, found.energy_impact, found.image_sensitivity) == ("shadow_rays", "high", "medium")
    assert [(cliff.start, cliff.end) for cliff in found.cliffs] == [(64, 16)]


def test_what_is_seen_through_glass_is_booked_under_direct():
    told = {
        "photon_map": Stage(time_s=1.0, cpu_s=2.0, energy_j={"equation_2": 10.0}),
        "precomputed_irradiance": Stage(time_s=0.5, cpu_s=1.0, energy_j={"equation_2": 5.0}),
        "direct": Stage(time_s=2.0, cpu_s=4.0, energy_j={"equation_2": 20.0}),
        "indirect": Stage(
            time_s=4.0, cpu_s=8.0, energy_j={"equation_2": 40.0}, specular_time_s=1.0, specular_cpu_s=3.0
        ),
    }
    assert thesis_stages(told) == {
        "photon_map": Cost(1.5, 3.0, 15.0),
        "direct": Cost(3.0, 7.0, 30.0),
        "indirect": Cost(3.0, 5.0, 30.0),
    }
    without_joules = {
        name: stage.model_copy(update={"energy_j": Stage(time_s=1).energy_j}) for name, stage in told.items()
    }
    assert all(stage.energy_j is None for stage in thesis_stages(without_joules).values())


def rendered(sweep, costs, settings, purpose="measure"):
    """Rows of one configuration, a seed a cost."""
    row = RESULTS.rows[0]
    return [
        replace(row, sweep=sweep, purpose=purpose, settings={**row.settings, **settings, "seed": seed}, seed=seed,
                image=Cost(cost, cost, cost), stages={"direct": Cost(cost, cost, cost)}, difference=cost)
        for seed, cost in enumerate(costs)
    ]  # fmt: skip


def half(interval):
    """Half-width of an interval in logarithms; both sides are alike."""
    assert math.log(interval.high / interval.value) == pytest.approx(math.log(interval.value / interval.low))
    return math.log(interval.high / interval.value)


def test_one_render_has_the_scatter_of_the_run_and_three_have_their_own():
    pair = rendered("some", [1.0, math.e**0.2], {})
    # two logarithms 0.2 apart: variance 0.02 with one degree of freedom, of which Student's t at 99 % is 63.657
    whole = Scatters(pair, "measured").cost
    assert (whole.sigma, whole.freedom) == (pytest.approx(0.02**0.5), 1)
    assert half(interval_of([10.0], whole=whole)) == pytest.approx(63.657 * 0.02**0.5, rel=1e-4)
    three = interval_of([9.0, 10.0, 11.0], whole=whole)
    # Student's t of 2 degrees at 99 %, 9.9248, times 1 / sqrt(3)
    assert (three.value, three.high) == (10.0, pytest.approx(10 + 9.9248 / 3**0.5, rel=1e-4))
    assert interval_of([10.0]).low == 10.0


def test_few_points_of_a_family_are_judged_by_their_pooled_scatter():
    """Two configurations of three seeds, logarithms -0.1, 0, 0.1: variance 0.01 with four degrees of freedom."""
    values = [math.exp(x) for x in (-0.1, 0.0, 0.1)]
    rows = [*rendered("some", values, {}), *rendered("some-again", values, {"shadow_rays": 3})]
    rows += rendered("some", [7.0], {"shadow_rays": 5})
    results = Results(tuple(rows), "measured", quick=True)
    # Student's t of 4 degrees at 99 %: 4.6041
    assert half(results.point("some", shadow_rays=3).cost) == pytest.approx(4.6041 * 0.1 / 3**0.5, rel=1e-4)
    assert half(results.point("some", shadow_rays=5).cost) == pytest.approx(4.6041 * 0.1, rel=1e-4)
    assert half(results.point("some", shadow_rays=5).difference) == pytest.approx(4.6041 * 0.1, rel=1e-4)


def test_what_a_sweep_renders_again_joins_its_points_and_the_first_seed_leads():
    again = rendered("some-again", [2.0, 3.0], {})
    again = [replace(row, seed=row.seed + 1, image_sha256="later") for row in again]
    results = Results((*again, *rendered("some", [1.0], {})), "measured", quick=True)
    (point,) = results.points("some")
    assert [row.seed for row in point.rows] == [0, 1, 2]
    assert point.rows[0].image_sha256 != "later"
    assert point.cost.value == pytest.approx(2.0)


def test_an_interval_covers_the_truth_as_often_as_it_says():
    """Eight configurations of three seeds and eight of one, scatter 0.1: 99 % intervals of 1,600 means.

    Those of a family share its estimate, so their misses cluster: over families the standard error of the share is
    0.003. From 0.97 to 0.999 is seven of them below 0.99 and three above.
    """
    random, hits = np.random.default_rng(5), []
    for _ in range(100):
        drawn = np.exp(0.1 * random.standard_normal((8, 3)) - 0.005)
        rows = [row for n, values in enumerate(drawn) for row in rendered("some", values, {"shadow_rays": n})]
        single = np.exp(0.1 * random.standard_normal(8) - 0.005)
        rows += [row for n, value in enumerate(single) for row in rendered("some", [value], {"shadow_rays": 50 + n})]
        costs = [point.cost for point in Results(tuple(rows), "measured", quick=True).points("some")]
        hits.append(np.mean([cost.low <= 1 <= cost.high for cost in costs]))
    assert 0.97 < np.mean(hits) < 0.999


def test_a_comparison_seed_by_seed_knows_nothing_of_what_seeds_share():
    """Seeds differ threefold, the ratio is always near 1/2: logarithms of the ratios scatter by 0.1 alone."""
    luck, scatter = [1.0, 3.0, 9.0], [-0.1, 0.0, 0.1]
    on = {seed: 0.5 * x * math.exp(s) for seed, (x, s) in enumerate(zip(luck, scatter, strict=True))}
    found = paired(on, dict(enumerate(luck)))
    assert found.value == pytest.approx(0.5)
    assert half(found) == pytest.approx(9.9248 * 0.1 / 3**0.5, rel=1e-4)
    assert paired({0: 1.0, 1: 2.0}, {0: 1.0, 1: 2.0}) is None
    assert paired({0: 1.0, 1: 2.0, 2: 0.0}, {0: 1.0, 1: 2.0, 2: 3.0}) is None


def test_the_basis_is_what_all_rows_have():
    rows = list(RESULTS.rows)
    assert basis_of(rows) == "measured"
    assert basis_of([type(row)(**{**row.__dict__, "quality": "replayed"}) for row in rows]) == "replayed"
    assert basis_of([type(rows[0])(**{**rows[0].__dict__, "quality": "none"}), *rows[1:]]) == "time"


def test_a_full_study_without_a_source_is_timed_and_a_quick_one_rendered_once(tmp_path):
    sweep = direct.sweeps(Study.opened(tmp_path / "q", quick=True).plan)[0]
    kinds = {
        "none": Study.opened(tmp_path / "q", quick=True),
        "timed": Study.opened(tmp_path / "t", quick=False, can_meter=lambda: False),
        "metered": Study.opened(tmp_path / "m", quick=False),
    }
    found = {name: kind.definition(sweep) for name, kind in kinds.items()}
    assert found["none"]["measure"]["meter"] == "none"
    assert found["none"]["settings"]["threads"] == 1
    assert found["none"]["repeats"] == 1
    assert found["timed"]["measure"]["window_s"] < found["metered"]["measure"]["window_s"]
    assert found["metered"]["repeats"] == 3
    assert "threads" not in found["metered"]["settings"]
    assert all(definition["reference"]["seed_policy"] == "same" for definition in found.values())
    assert all(definition["preset"] == "reference" for definition in found.values())
