"""Stage powers from a sweep of metered windows, and how far Equation 2 is from them."""

from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from joulebox_agent.estimates.energies import window_energies
from joulebox_agent.estimates.stage_power import StagePowerFit, WindowTotals, fit_stage_powers
from joulebox_agent.estimates.windows import Window, stage_energies_j

from .discharge import Gauge, Machine, configured, script
from .reading import Run, lead_s, windows_of


@dataclass(frozen=True)
class Sweep:
    """Configurations of one machine whose stages take different times; some windows are held out."""

    name: str
    machine: Machine = field(default_factory=Machine)
    gauge: Gauge = field(default_factory=Gauge)
    windows: int = 16
    held_out: int = 3
    window_s: float = 60.0


@dataclass(frozen=True)
class SweepResult:
    """powers_w by stage as fitted; which intervals hold; Equation 2's powers; which priced windows hold."""

    fitted: StagePowerFit
    holds: dict[str, bool]
    equation_2_w: dict[str, float]
    priced: list[bool]
    priced_truth: list[bool]


def run_sweep(seed: int, sweep: Sweep) -> SweepResult:
    """One window of every configuration, read as the agent reads it, fitted without the ones held out."""
    rng = np.random.default_rng(seed)
    machines = [configured(rng, sweep.machine) for _ in range(sweep.windows + sweep.held_out)]
    before_s = lead_s(sweep.gauge, sweep.window_s)
    discharge = script(rng, machines, sweep.window_s + 2 * before_s + 3.2 * max(m.image_s for m in machines))
    windows = [windows_of(block, sweep.window_s, before_s)[0] for block in discharge.blocks]
    run = Run(rng, discharge, sweep.gauge, "battery_gauge")
    series = run.read_until(windows[-1].load_s[1])
    found = window_energies(series, run.source, windows, run.resolution_j)
    energies_j = [energy_j for energy_j in found.gross_j if energy_j is not None]
    totals = [_totals(w, energy_j) for w, energy_j in zip(windows, energies_j, strict=True)]
    fitted = fit_stage_powers(totals[: sweep.windows])
    truth = {name: power_w for name, power_w, _ in sweep.machine.stages}
    held = range(sweep.windows, len(windows))
    prices = [fitted.price(totals[row].stages_s, totals[row].time_s) for row in held]
    drawn_j = [discharge.energy_j(windows[row].start_s, windows[row].end_s) for row in held]
    return SweepResult(
        fitted,
        {name: fitted.powers_w[name].low <= watts <= fitted.powers_w[name].high for name, watts in truth.items()},
        _equation_2_w(windows, energies_j),
        [price.low <= totals[row].energy_j <= price.high for row, price in zip(held, prices, strict=True)],
        [price.low <= energy_j <= price.high for price, energy_j in zip(prices, drawn_j, strict=True)],
    )


def _totals(window: Window, energy_j: float) -> WindowTotals:
    stages_s = {name: totals.time_s for name, totals in window.stages.items()}
    return WindowTotals(window.wall_s, stages_s, energy_j, window.start_s)


def _equation_2_w(windows: list[Window], energies_j: list[float]) -> dict[str, float]:
    """Power that Equation 2 gives each stage, over all windows."""
    joules: dict[str, float] = {}
    seconds: dict[str, float] = {}
    for window, energy_j in zip(windows, energies_j, strict=True):
        for name, share_j in stage_energies_j(window, energy_j).items():
            joules[name] = joules.get(name, 0.0) + share_j
            seconds[name] = seconds.get(name, 0.0) + window.stages[name].time_s
    return {name: joules[name] / seconds[name] for name in joules}


SWEEPS = (
    Sweep("refresh 1 s, 16 windows", gauge=Gauge(1.0, 1.0)),
    Sweep("refresh 4 s, 12 windows", windows=12),
    Sweep("refresh 4 s, mean of 10 s, 16 windows", gauge=Gauge(4.0, 10.0)),
    Sweep("refresh 4 s, drift 2 % over 180 s, 20 windows", Machine(drift_share=0.02, drift_time_s=180.0), windows=20),
)


@dataclass(frozen=True)
class SweepCoverage:
    """Means over runs: fitted_w, equation_2_w and holds by stage; shares of held-out windows whose price holds
    what the gauge gave them, and what they really drew."""

    sweep: Sweep
    runs: int
    fitted_w: dict[str, float]
    equation_2_w: dict[str, float]
    holds: dict[str, float]
    priced: float
    priced_drawn: float

    @property
    def within_bounds(self) -> bool:
        """Fitted powers within 2 %, where Equation 2 is off by more than 10 %; prices hold at least 92 %."""
        truth_w = {name: power_w for name, power_w, _ in self.sweep.machine.stages}
        fitted = max(abs(self.fitted_w[name] / watts - 1) for name, watts in truth_w.items())
        equation_2 = max(abs(self.equation_2_w[name] / watts - 1) for name, watts in truth_w.items())
        return fitted < 0.02 and equation_2 > 0.10 and self.priced >= 0.92


def sweep_coverage(sweep: Sweep, runs: int, pool: Executor | None = None) -> SweepCoverage:
    """Runs a sweep with seeds 0 to runs - 1."""
    run = partial(run_sweep, sweep=sweep)
    results = list(pool.map(run, range(runs), chunksize=5) if pool else map(run, range(runs)))
    names = [name for name, _, _ in sweep.machine.stages]
    return SweepCoverage(
        sweep,
        runs,
        {name: float(np.mean([r.fitted.powers_w[name].value for r in results])) for name in names},
        {name: float(np.mean([r.equation_2_w[name] for r in results])) for name in names},
        {name: float(np.mean([r.holds[name] for r in results])) for name in names},
        float(np.mean([r.priced for r in results])),
        float(np.mean([r.priced_truth for r in results])),
    )
