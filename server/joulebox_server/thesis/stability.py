"""Where methods fail: every method in its bad regimes, over many seeds."""

from typing import Any

from joulebox_server.analysis.documents import Rating, Step
from joulebox_server.analysis.intervals import exactly
from joulebox_server.analysis.words import figure, setting, share
from joulebox_server.reports.document import Table
from joulebox_server.thesis import quantities
from joulebox_server.thesis.batch import Batch, Figure, Finding, Spec, Tile, Verdict
from joulebox_server.thesis.claims import claims_of
from joulebox_server.thesis.judging import between, every, finding, ratio, told
from joulebox_server.thesis.ratings import limit_of
from joulebox_server.thesis.results import MissingError, Results, compared, only
from joulebox_server.thesis.scatter import interval_of
from joulebox_server.thesis.spreads import clouds, strips
from joulebox_server.thesis.stability_points import (
    LEAK_SWEEPS,
    LINES,
    LINES_SCENE,
    LINES_SWEEP,
    SEEDS,
    Found,
    found,
    line,
    lines_tradeoff,
    method_of,
    of,
    sweeps,
)

# --- claims: how far one seed speaks for others, and whether each regime is as bad as it is known to be ----------


def _seed_tells(results: Results) -> Finding:
    spreads = {one.regime.name: one.stability.spread for one in found(results)}
    worst = max(spreads, key=lambda name: spreads[name].value)
    verdict = every([between(spread, high=0.1) for spread in spreads.values()])
    return finding(spreads[worst], verdict, f"the widest is {worst}; its standard deviation over its mean")


def _cost_tells(results: Results) -> Finding:
    spreads = {one.regime.name: one.cost_spread for one in found(results)}
    worst = max(spreads, key=lambda name: spreads[name].value)
    verdict = every([between(spread, high=0.05) for spread in spreads.values()])
    return finding(spreads[worst], verdict, f"the widest is {worst}; its standard deviation over its mean")


def _worst_seed(results: Results) -> Finding:
    ratios = {one.regime.name: one.stability.worst / one.stability.mean for one in found(results) if one.stability.mean}
    if not ratios:
        raise MissingError("no regime differs from its reference")
    name = max(ratios, key=lambda regime: ratios[regime])
    value = exactly(ratios[name])
    return finding(
        value, between(value, high=2.0), f"the widest is {name}; the difference of its worst seed over the mean"
    )


def _beyond(results: Results, name: str, words: str) -> Finding:
    """Holds when every seed is beyond the limit, fails when the mean's interval is within it."""
    one = of(results, name)
    mean = compared(one.point)
    if one.stability.share_beyond == 1:
        return finding(
            mean, "holds", f"{words}: all of {one.stability.seeds} seeds are beyond {figure(one.limit)}; mean"
        )
    verdict: Verdict = "fails" if mean.high <= one.limit else "unclear"
    beyond = share(one.stability.share_beyond)
    return finding(mean, verdict, f"{words}: {beyond} of the seeds are beyond {figure(one.limit)}; mean")


def _radius(results: Results) -> Finding:
    points = line(results, "gather_distance_m")
    if len(points) != len(LINES["gather_distance_m"][1]):
        raise MissingError("the line of gather distances is not whole")
    differences = [compared(point) for point in points]
    best = min(differences, key=lambda one: one.value)
    ends = [ratio(end, best) for end in (differences[0], differences[-1])]
    at = points[differences.index(best)].settings["gather_distance_m"]
    words = f"best at {setting(at)} m; over that the largest differs {told(ends[1])} times as much, the smallest"
    return finding(ends[0], every([between(end, low=2.0) for end in ends]), words)


def _leak(results: Results) -> Finding:
    thin, thick = (only(results.points(sweep)) for sweep in LEAK_SWEEPS)
    times = ratio(compared(thin), compared(thick))
    verdict = every([between(times, low=2.0), between(compared(thin), low=limit_of(thin))])
    words = f"a wall of 0.004 m differs by {told(compared(thin))}, one of 0.05 m by {told(compared(thick))}; the ratio"
    return finding(times, verdict, words)


def _scale(results: Results) -> Finding:
    means = [compared(of(results, name).point) for name in ("tiny", "huge")]
    # seed by seed: both rooms have the same seeds, so what these do to a picture says nothing of its size
    pairs = zip(*(of(results, name).differences for name in ("tiny", "huge")), strict=True)
    apart = interval_of([max(pair) / min(pair) for pair in pairs if min(pair) > 0], None)
    limit = of(results, "tiny").limit
    verdict = every([between(apart, high=1.1), *(between(mean, high=limit) for mean in means)])
    words = f"differences of {told(means[0])} and {told(means[1])}; the larger over the other, seed by seed"
    return finding(apart, verdict, words)


def _cliffs(results: Results) -> Finding:
    tradeoff = lines_tradeoff(results)
    with_cliff = [rated.setting for rated in tradeoff.ratings if rated.cliffs and rated.setting in LINES]
    missing = [name for name in LINES if name not in {rated.setting for rated in tradeoff.ratings}]
    if missing:
        raise MissingError(f"no line of {', '.join(missing)} was rendered")
    count = exactly(float(len(with_cliff)))
    verdict: Verdict = "holds" if len(with_cliff) == len(LINES) else "fails"
    words = f"cliffs are on {', '.join(with_cliff) or 'none'}; of {len(LINES)} settings"
    return finding(count, verdict, words)


CLAIMS = claims_of(
    "stability",
    {
        "seed-tells": _seed_tells,
        "seed-cost": _cost_tells,
        "seed-worst": _worst_seed,
        "fail-photons": lambda results: _beyond(results, "few-photons", "5,000 photons"),
        "fail-tolerance": lambda results: _beyond(results, "high-tolerance", "a tolerance of 4"),
        "fail-radius": _radius,
        "fail-leak": _leak,
        "fail-gap": lambda results: _beyond(results, "gap", "a door 5 degrees open"),
        "fail-scale": _scale,
        "cliffs": _cliffs,
    },
)

# --- figures -----------------------------------------------------------------------------------------------------


def _names(ones: list[Found]) -> dict[str, Found]:
    return {one.regime.name: one for one in ones}


def _difference_strips(results: Results) -> Spec | None:
    ones = found(results)
    values = {name: one.differences for name, one in _names(ones).items()}
    return strips(values, "difference to the reference, every seed", ones[0].limit, log=True)


def _cost_strips(results: Results) -> Spec | None:
    values = {name: [cost / (sum(one.costs) / len(one.costs)) for cost in one.costs]
              for name, one in _names(found(results)).items()}  # fmt: skip
    return strips(values, f"cost of an image [{results.unit}] over the mean of its seeds", log=False)


def _clouds(results: Results) -> Spec | None:
    ones = found(results)
    values = {name: (one.regime.method, one.costs, one.differences) for name, one in _names(ones).items()}
    return clouds(values, f"cost of an image [{results.unit}]", "difference to the reference", ones[0].limit)


def _table(results: Results) -> Table:
    rows = []
    for one in found(results):
        stable = one.stability
        rows.append(
            (
                one.regime.name,
                f"{one.regime.method}: {one.regime.words}",
                told(compared(one.point)),
                share(stable.spread.value),
                figure(stable.worst),
                share(stable.share_beyond),
                f"{figure(one.point.cost.value)} {results.unit}",
                share(one.cost_spread.value),
                one.fragile or ("" if stable.mean <= one.limit else "not acceptable"),
            )
        )
    columns = ("regime", "what is bad", "mean difference", "spread", "worst", "beyond the limit", "mean cost",
               "cost spread", "fragile")  # fmt: skip
    limit = figure(found(results)[0].limit)
    caption = f"Over {SEEDS} seeds; the limit is {limit}; spreads are standard deviations over means"
    return Table(columns, rows, caption)


def _cliff_table(results: Results) -> Table:
    rows = [
        (
            rated.setting,
            rated.energy_impact,
            rated.image_sensitivity,
            "; ".join(_cliff_told(cliff) for cliff in rated.cliffs) or "none",
        )
        for rated in lines_tradeoff(results).ratings
        if rated.setting in LINES
    ]
    return Table(("setting", "cost impact", "image sensitivity", "cliffs, and the difference on both sides"), rows)


def _cliff_told(cliff: Step) -> str:
    differences = [figure(value or 0.0) for value in (cliff.difference_start, cliff.difference_end)]
    return f"{setting(cliff.start)} to {setting(cliff.end)}: {' to '.join(differences)}"


def _line_series(name: str) -> Any:
    def series(results: Results) -> quantities.Series:
        points = line(results, name)
        return {"": [(float(point.settings[name]), point) for point in points]}

    return series


LIMITED = quantities.Quantity("difference to the reference", lambda point: point.difference)


def _over(name: str) -> Any:
    """Difference along a line on logarithmic axes, with the limit of its size."""

    def draw(results: Results) -> Spec | None:
        points = line(results, name)
        if not points:
            raise MissingError(f"no line of {name} was rendered")
        limited = quantities.Quantity(LIMITED.title, LIMITED.of, {"acceptable": limit_of(points[0])})
        return quantities.over(limited, _line_series(name), name, log_x=True, log_y=True)(results)

    return draw


def _pictures(results: Results) -> list[Tile]:
    """Of each regime its reference, its worst seed, and the error map of that."""
    tiles = []
    for one in found(results):
        row = max(one.point.rows, key=lambda r: r.difference or 0.0)
        named = f"{one.regime.name}: {one.regime.method}, {one.regime.words}"
        captions = (
            (row.reference_sha256, f"{one.regime.name}: the reference"),
            (row.image_sha256, f"{named}; its worst seed differs by {figure(row.difference or 0.0)}"),
            (row.delta_sha256, f"{one.regime.name}: error map of the worst seed"),
        )
        tiles += [Tile(sha256, words) for sha256, words in captions if sha256]
    return tiles


ALL = f"Every tick is one of {SEEDS} seeds; the point is their mean, the bar one standard deviation; the dashed line is"
FIGURES = (
    Figure("stability-table", "Every method where it fails, over its seeds",
           "Fragile is what a recommendation would say of the same seeds.", _table),
    Figure("stability-differences", "How far pictures differ, seed by seed", f"{ALL} the acceptable difference.",
           _difference_strips),
    Figure("stability-costs", "How much costs vary, seed by seed", "As above; 1 is the mean. What a busy machine adds "
           "is in it.", _cost_strips),
    Figure("stability-clouds", "Speed against accuracy with the spread drawn",
           "Small points are seeds, bars one standard deviation both ways.", _clouds),
    Figure("stability-cliffs", "The cliff of each setting", "A cliff multiplies the difference by three or more, to "
           "beyond the limit. Each setting was moved alone, the others at the renderer's defaults.", _cliff_table),
    *(Figure(f"stability-line-{name.replace('_', '-')}", f"Difference over {name}", "", _over(name)) for name in LINES),
    Figure("stability-pictures", "What failure looks like", "", _pictures),
)  # fmt: skip


def advice(results: Results) -> list[str]:
    """Where not to go, from the cliffs."""
    limit = limit_of(results.points(LINES_SWEEP)[0])
    return [
        _warning(rated, limit) for rated in lines_tradeoff(results).ratings if rated.cliffs and rated.setting in LINES
    ]


def _warning(rated: Rating, limit: float) -> str:
    """Every cliff of one setting, in a sentence."""
    cliffs = "; ".join(_cliff_told(cliff) for cliff in rated.cliffs)
    return (
        f"Where methods fail: stay clear of the cliff of {rated.setting} ({method_of(rated.setting)}, {LINES_SCENE}). "
        f"The difference on its two sides is, from {cliffs}; {figure(limit)} is acceptable."
    )


BATCH = Batch(
    "stability",
    "Where methods fail",
    f"Each method is rendered with {SEEDS} seeds where it is known to be weak: few photons, look-ups too small or too "
    "large, few rays, a tiny caustic, light through a gap, a thin wall, corners, tiny and huge scenes, glass of high "
    "index, many lamps. The reference gathers at every point with many rays and photons, at another seed. What was "
    "looked for: how far one seed speaks for the others, and at which step of a setting the picture falls off a cliff.",
    sweeps,
    FIGURES,
    CLAIMS,
    advice,
)
