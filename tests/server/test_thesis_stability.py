"""The rules of where methods fail, and of what goes beyond the thesis, on rows of our invention."""

from dataclasses import replace

import pytest
from invented import invented, without
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.stability import over_seeds, relative_spread
from joulebox_server.thesis import beyond, stability
from joulebox_server.thesis.batch import Plan
from joulebox_server.thesis.beyond import path_cost_at
from joulebox_server.thesis.stability_points import REGIMES, SEEDS, found
from joulebox_server.thesis.verdicts import judge

DEFAULTS = {
    "indirect": "final_gather",
    "samples_per_pixel": 8,
    "global_photons": 100_000,
    "caustic_photons": 100_000,
    "gather_count": 100,
    "gather_distance_m": 0.02,
    "final_gather_rays": 256,
    "irradiance_cache_tolerance": 0.8,
    "irradiance_gradients": True,
    "importance_sampling": False,
    "sampler": "stratified",
    "caustic_hints": True,
    "shadow_rays": 4,
    "use_shadow_photons": False,
}

# --- where methods fail: a world with a cliff on every setting; the limit is 6.25 at 64x64 ------------------------


def cost(scene, s):
    return {"photon_map": s["global_photons"] / 100_000, "direct": 1.0, "indirect": s["final_gather_rays"] / 64}


def difference(scene, s):
    if "thin-wall" in scene:
        return 5.0 if "thickness=0.05" in scene else 30.0
    if "scaled-room" in scene:
        return 3.0
    if "veach" in scene:
        return 30.0
    if s["indirect"] == "path":
        return {1: 200, 4: 50, 16: 15, 64: 4}[s["samples_per_pixel"]]
    if s["indirect"] == "direct_visualization":
        far = {0.002: 80, 0.004: 20, 0.01: 3, 0.02: 2, 0.05: 8, 0.2: 40}[s["gather_distance_m"]]
        return far * 100_000 / s["global_photons"]
    tolerance = {0.0: 1, 0.2: 1, 0.8: 1.5, 1.6: 4, 4.0: 30}[s["irradiance_cache_tolerance"]]
    return tolerance * {256: 1, 64: 3, 16: 12, 4: 50}[s["final_gather_rays"]]


def flat(scene, s):
    return 1.0


def one_bad_seed(results):
    """As if the first seed of everything were far off."""
    far = [replace(row, difference=40 * row.difference) if row.repeat == 0 and row.difference else row
           for row in results.rows]  # fmt: skip
    return replace(results, rows=tuple(far))


def failing(**changed):
    return invented(stability.BATCH, cost, **{"difference": difference, "defaults": DEFAULTS, **changed})


FAILING = {claim.id: claim for claim in stability.BATCH.claims}
FAULTS = {
    "seed-tells": lambda: failing(noise=0.3),
    "seed-cost": lambda: failing(noise=0.3),
    "seed-worst": lambda: one_bad_seed(failing()),
    "fail-photons": lambda: failing(difference=flat),
    "fail-tolerance": lambda: failing(difference=flat),
    "fail-radius": lambda: failing(difference=flat),
    "fail-leak": lambda: failing(difference=flat),
    "fail-gap": lambda: failing(difference=flat),
    "fail-scale": lambda: failing(difference=lambda scene, s: 8.0 if "exponent=4" in scene else difference(scene, s)),
    "cliffs": lambda: failing(difference=flat),
}


@pytest.mark.parametrize("claim_id", FAILING)
def test_where_methods_fail(claim_id):
    assert judge(FAILING[claim_id], failing()).finding.verdict == "holds"
    assert judge(FAILING[claim_id], FAULTS[claim_id]()).finding.verdict == "fails"
    empty = judge(FAILING[claim_id], without(failing(), ""))
    assert empty.finding.verdict == "unclear"
    assert "not judged" in empty.finding.words


@pytest.mark.parametrize("claim_id", ["fail-photons", "fail-tolerance", "fail-gap"])
def test_some_seeds_beyond_the_limit_are_unclear(claim_id):
    """Around the limit, 6.25, by a factor of e^0.5 both ways: the mean is beyond it, half of the seeds are not."""
    found = judge(FAILING[claim_id], failing(difference=lambda scene, s: 6.25, noise=0.5)).finding
    assert found.verdict == "unclear"
    assert "50 % of the seeds are beyond" in found.words


def test_every_regime_has_its_seeds_and_all_figures_are_drawn():
    results = failing()
    assert [one.regime.name for one in found(results)] == [regime.name for regime in REGIMES]
    assert {one.stability.seeds for one in found(results)} == {SEEDS}
    drawn = {figure.number: figure.draw(results) for figure in stability.BATCH.figures}
    assert all(drawn.values())
    table = drawn["stability-table"]
    assert len(table.rows) == len(REGIMES)
    cliffs = {row[0]: row[3] for row in drawn["stability-cliffs"].rows}
    assert (
        cliffs["gather_distance_m"] == "0.004 to 0.002: 20 to 80; 0.01 to 0.004: 3 to 20; 0.02 to 0.05: 2 to 8; "
        "0.05 to 0.2: 8 to 40"
    )
    assert len(drawn["stability-pictures"]) == 3 * len(REGIMES)
    advised = stability.BATCH.advice(results)
    assert len(advised) == 5
    assert (
        "Where methods fail: stay clear of the cliff of irradiance_cache_tolerance (final gathering, cornell-boxes). "
        "The difference on its two sides is, from 1.6 to 4: 4 to 30; 6.25 is acceptable."
    ) in advised
    assert sum("(direct visualisation, cornell-boxes)" in sentence for sentence in advised) == 2
    assert sum("(path tracing, cornell-boxes)" in sentence for sentence in advised) == 1


def test_one_setting_without_a_cliff_is_one_too_many():
    """Gathering and direct visualisation differ too, which is a step of no line here."""
    level = failing(difference=lambda scene, s: difference(scene, s | {"irradiance_cache_tolerance": 0.8}))
    found = judge(FAILING["cliffs"], level).finding
    assert (found.verdict, found.value.value) == ("fails", 4)


def test_a_full_run_has_every_seed_everywhere():
    for sweep in stability.BATCH.sweeps(Plan(quick=False)):
        assert sweep["repeats"] >= SEEDS


def test_stability_of_known_values():
    """Of 1, 2, 3, 6: mean 3, variance 14/3; chi-square of 3 degrees of freedom: 0.2158 and 9.348 at 2.5 and 97.5 %."""
    known = over_seeds([1, 2, 3, 6], limit=2.5)
    share = (14 / 3) ** 0.5 / 3
    assert (known.seeds, known.mean, known.worst, known.share_beyond) == (4, 3, 6, 0.5)
    assert known.spread.value == pytest.approx(share)
    assert known.spread.low == pytest.approx(share * (3 / 9.348) ** 0.5, rel=1e-3)
    assert known.spread.high == pytest.approx(share * (3 / 0.2158) ** 0.5, rel=1e-3)
    assert relative_spread([0.0, 0.0]).high == 0
    with pytest.raises(AnalysisError, match="two or more are needed"):
        relative_spread([1.0])


# --- beyond the thesis ---------------------------------------------------------------------------------------------


def beyond_cost(scene, s):
    if s["indirect"] == "path":
        return {"indirect": s["samples_per_pixel"] * 1.0}
    hints = 1.0 if s["caustic_hints"] else 5.0
    tolerance = 1 / (0.1 + s["irradiance_cache_tolerance"])
    spacing = 0.9 if s["photon_spacing"] == 8 else 1.0
    gather = s["final_gather_rays"] / 256 * tolerance * spacing
    threads = {1: 1.0, 2: 0.8}[s["threads"]]
    return {"photon_map": hints * s["global_photons"] / 100_000 * threads, "indirect": 10 * gather * threads}


def beyond_difference(scene, s):
    if s["indirect"] == "path":
        return 100 / s["samples_per_pixel"] ** 0.5
    better = 0.5 if s["sampler"] == "sobol" or s["importance_sampling"] else 1.0
    gradients = 0.4 if s["irradiance_gradients"] else 1.0
    return better * gradients * 2 * (256 / s["final_gather_rays"]) ** 0.5


def world(cost=beyond_cost, difference=beyond_difference, **changed):
    return invented(beyond.BATCH, cost, difference, **{"defaults": DEFAULTS, **changed})


def no_gain(scene, s):
    return 100 / s["samples_per_pixel"] ** 0.5 if s["indirect"] == "path" else 3.0


def far_from_paths(scene, s):
    """Final gathering at a difference that a few paths reach too."""
    return 100 / s["samples_per_pixel"] ** 0.5 if s["indirect"] == "path" else 25.0


def dear(factor, when):
    """A fault: everything costs so much more where `when(settings)`."""
    return lambda: world(
        cost=lambda scene, s: {k: v * (factor if when(s) else 1) for k, v in beyond_cost(scene, s).items()}
    )


BEYOND = {claim.id: claim for claim in beyond.BATCH.claims}
BEYOND_FAULTS = {
    "gradients": [lambda: world(difference=no_gain), dear(2.0, lambda s: s["irradiance_gradients"])],
    "sobol": [lambda: world(difference=no_gain), dear(2.0, lambda s: s["sampler"] == "sobol")],
    "importance": [lambda: world(difference=no_gain), dear(2.0, lambda s: s["importance_sampling"])],
    "hints": [dear(5.0, lambda s: s["caustic_hints"])],
    "path-tracing": [lambda: world(difference=far_from_paths, cost=lambda scene, s: {"indirect": 10.0})],
    "combined": [lambda: world(difference=lambda scene, s: 2 * no_gain(scene, s) + 1),
                 dear(50.0, lambda s: s["photon_spacing"] == 8)],
    "race-to-idle": [dear(2.0, lambda s: s["threads"] == 2)],
}  # fmt: skip


@pytest.mark.parametrize("claim_id", BEYOND)
def test_beyond_the_thesis(claim_id):
    claim = BEYOND[claim_id]
    assert judge(claim, world()).finding.verdict == "holds"
    for fault in BEYOND_FAULTS[claim_id]:
        assert judge(claim, fault()).finding.verdict == "fails"
    assert judge(claim, world(noise=1.5)).finding.verdict == "unclear"
    assert "not judged" in judge(claim, without(world(), "")).finding.words


def test_all_figures_beyond_the_thesis_are_drawn():
    assert all(figure.draw(world()) for figure in beyond.BATCH.figures)
    assert "save" in beyond.BATCH.advice(world())[0]


def test_threads_need_joules():
    found = judge(BEYOND["race-to-idle"], world(basis="time"))
    assert found.finding.verdict == "unclear"
    assert "needs joules" in found.why


def test_too_cheap_a_bound_on_path_tracing_is_unclear():
    """No number of paths comes as near, and the dearest costs less than final gathering: nothing is known."""
    found = judge(BEYOND["path-tracing"], dear(0.001, lambda s: s["indirect"] == "path")()).finding
    assert found.verdict == "unclear"
    assert "at least" in found.words


def test_path_tracing_of_a_difference():
    """Differences of 50, 25, 12.5, 6.25 at costs of 4, 16, 64, 256: a straight line in logarithms."""
    results = world(noise=0.0)
    assert path_cost_at(results, 12.5)[0].value == pytest.approx(64)
    between, bound = path_cost_at(results, 12.5 * 2**0.5)
    assert (between.value, bound) == (pytest.approx(32), False)
    assert path_cost_at(results, 1.0)[1] is True
    assert path_cost_at(results, 1000.0)[0].value == pytest.approx(4)


def test_no_finding_ends_in_the_middle_of_a_sentence():
    """Words get their number after a colon, which follows no comma and no preposition."""
    judged = [judge(claim, failing()) for claim in stability.BATCH.claims]
    for one in [*judged, *(judge(claim, world()) for claim in beyond.BATCH.claims)]:
        assert not one.finding.words.rsplit(":", 1)[0].endswith((",", " of", " by", " to")), one.finding.words
