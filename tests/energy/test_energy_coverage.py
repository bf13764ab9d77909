"""A small slice of `make test-energy`: fixed seeds, through the agent's own reading code."""

from pathlib import Path

import numpy as np
import pytest

from .coverage import CASES, COARSE, STEADY, coverage
from .discharge import Gauge, Machine, gauge_updates, script
from .reading import Rule, measure
from .sweep import Sweep, sweep_coverage

NAMED = {case.name: case for case in CASES}


def test_the_script_draws_what_its_stages_say() -> None:
    """Sums in closed form: images of known joules, idle and set-up around them; the gauge's mean is the power's."""
    machine = Machine(jitter=0.0)
    discharge = script(np.random.default_rng(1), [machine], 100.0)
    block = discharge.blocks[0]
    start_s, end_s = block[0][0][1], block[-1][0][1]
    images = len(block) - 1
    assert discharge.energy_j(start_s, end_s) == pytest.approx(images * machine.image_j)
    assert machine.image_j == pytest.approx(24 * 0.6 + 17 * 1.3 + 14 * 0.8 + 11 * 0.01)
    assert discharge.energy_j(0.0, start_s) == pytest.approx(40 * 8.0 + 5 * 12.0)
    times_s, power_uw, energy_uwh = gauge_updates(np.random.default_rng(2), discharge, Gauge(4.0, 4.0, noise_w=0.0))
    inside = (times_s > start_s + 4.0) & (times_s < end_s)
    tiles_j = discharge.energy_j(times_s[inside][0] - 4.0, times_s[inside][-1])
    assert np.sum(np.array(power_uw)[inside]) * 4.0 / 1e6 == pytest.approx(tiles_j, rel=1e-4)
    used_j = (energy_uwh[0] - energy_uwh[-1]) * 3600 / 1e6
    assert used_j == pytest.approx(discharge.energy_j(times_s[0], times_s[-1]), abs=2 * 3.6)


def test_a_tree_in_memory_reads_as_one_on_disk(tmp_path: Path) -> None:
    case = NAMED["refresh 4 s"]
    in_memory = measure(5, case.machine, case.gauge, case.rule)
    on_disk = measure(5, case.machine, case.gauge, case.rule, root=tmp_path)
    assert in_memory.gross == on_disk.gross
    assert in_memory.energies == on_disk.energies


IN_SLICE = ("refresh 4 s", "refresh 4 s, mean of 30 s", "refresh 4 s, power in steps of 0.5 W",
            "in blocks, refresh 4 s, mean of 30 s", "in blocks, steps of 36 J")  # fmt: skip


@pytest.mark.parametrize("name", IN_SLICE)
def test_intervals_hold_the_truth_at_their_rate(name: str) -> None:
    """150 fixed seeds: binomial sigma 1.8 %, bounds of 3 sigma. The whole has 2,000 (make test-energy)."""
    found = coverage(NAMED[name], 150)
    assert found.case.group == STEADY
    assert found.resolved == 150
    assert 0.895 <= found.long_run <= 1.0
    assert abs(found.bias) < 0.004  # 3 sigma of the coarsest, whose runs scatter by 0.9 %, are 0.2 %


def test_drift_widens_the_interval_and_a_steady_machine_s_is_left_alone() -> None:
    """Ten windows under 3 % of drift over a minute: the plain interval holds 79 %, the widened one 97 %."""
    case = NAMED["refresh 4 s"]
    wandering = Machine(drift_share=0.03, drift_time_s=60.0)
    rule = Rule(pilot=10, most=10)
    results = [measure(seed, wandering, case.gauge, rule) for seed in range(60)]
    held = [r.gross is not None and r.gross.low <= wandering.image_j <= r.gross.high for r in results]
    assert np.mean(held) >= 0.88  # 3 sigma below 0.97
    plain = [measure(seed, case.machine, case.gauge, rule).energies.least_share for seed in range(40)]
    assert np.median(plain) == 0.0
    assert np.median([r.energies.least_share for r in results]) > 0.02


@pytest.mark.parametrize("name", [case.name for case in CASES if case.group == COARSE])
def test_what_a_source_cannot_resolve_is_not_answered(name: str) -> None:
    assert coverage(NAMED[name], 20).resolved == 0


def test_stage_powers_are_found_where_equation_2_is_wrong() -> None:
    """20 sweeps of 12 windows: the mean of a stage's power has a standard error of 0.25 W / sqrt(20), 0.3 %."""
    found = sweep_coverage(Sweep("slice", windows=12), 20)
    assert found.within_bounds
    assert abs(found.equation_2_w["photon_map"] / 24.0 - 1) > 0.15
    assert np.mean(list(found.holds.values())) >= 0.85
