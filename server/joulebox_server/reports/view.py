"""The part of a report about one scene on one device."""

from collections.abc import Sequence

from joulebox_server.analysis import charts, frame
from joulebox_server.analysis.documents import Choice, Point, Rating, Recommendation, Step, Tradeoff
from joulebox_server.analysis.words import figure, setting, share
from joulebox_server.reports.document import Block, Chart, Facts, Fold, Picture, Pictures, Points, Section, Table, Words
from joulebox_server.reports.gathering import Compared, View
from joulebox_server.reports.wording import QUALITY_MEANS, cost_told, energy_told, quality_label, render_command

SETTINGS = "settings"
"""The folder of recommended settings."""
MOST_ROWS = 200
"""Configurations in the page's own tables; the CSV file has all."""

ROLES = {
    "recommended": "Recommended",
    "best": "Least difference",
    "worst": "Greatest difference",
}


def view_section(view: View, name: str, csv_name: str, heading: str) -> Section:
    """Trade-off, answer, stages, ratings, pictures and points of a view; `name` begins its figures' names."""
    tradeoff = view.tradeoff
    label = quality_label(tradeoff.energy_quality)
    if not tradeoff.points:
        nothing = Words("Nothing has been measured here yet: no job of this scene and device has a result.", "notice")
        return Section(heading, name, [nothing])
    blocks: list[Block] = [Words(QUALITY_MEANS[tradeoff.energy_quality]), *_floor_words(tradeoff)]
    sections = [
        Section(
            "What it costs and what it changes", f"{name}-tradeoff", [_tradeoff_chart(tradeoff, name)], label=label
        ),
        Section("Which settings to take", f"{name}-answer", _answer(view, settings_file(name)), label=label),
        Section("Where the cost goes", f"{name}-stages", [_stages_chart(view, name)]),
        Section("What each setting does", f"{name}-ratings", _ratings(tradeoff)),
        Section("How the pictures look", f"{name}-pictures", _pictures(view, name)),
        Section("All configurations", f"{name}-points", [_points_table(tradeoff, csv_name)], label=label),
    ]
    return Section(heading, name, blocks, sections, label)


def settings_file(name: str) -> str:
    """Where the recommended settings of a view stand in the report's folder."""
    return f"{SETTINGS}/{name}.json"


def answer_sentence(view: View) -> str:
    """What a view comes to, in one sentence."""
    tradeoff, found = view.tradeoff, view.recommendation
    where = f"{tradeoff.scene} on {tradeoff.device or 'no device yet'}"
    if found is None:
        return f"{where}: {view.unanswered}"
    if found.answer == "none":
        return f"{where}: no setting meets {_asked(found)}. {' '.join(found.why[:1])}"
    saves = "" if found.saves_share is None else f", which saves {share(found.saves_share)} of what the reference costs"
    basis = ", a prediction that was never measured," if found.basis == "predicted" else ""
    fragile = " It is fragile." if found.fragile else ""
    difference = figure(found.difference.value) if found.difference else "unknown"
    return (
        f"{where}: with {found.label}{basis} an image costs {_cost(found)}, at a difference of {difference} "
        f"(limit {figure(found.limit)}){saves}.{fragile}"
    )


def _floor_words(tradeoff: Tradeoff) -> list[Block]:
    floor = tradeoff.noise_floor
    if floor is None:
        return []
    told = (
        f"The reference differs from itself by {figure(floor.value)} when it is rendered with another seed "
        f"({share(floor.share_of_limit)} of the limit {figure(tradeoff.limit)})"
    )
    if floor.too_noisy:
        return [Words(f"{told}: it is too noisy to judge small differences by.", "notice")]
    return [Words(f"{told}: smaller differences than that say nothing.")]


def _tradeoff_chart(tradeoff: Tradeoff, name: str) -> Block:
    compared = [point for point in tradeoff.points if point.difference is not None]
    if not compared:
        return Words("No picture has been compared with the reference yet, so there is no trade-off to show.", "notice")
    cost = "time" if tradeoff.main_axis == "time_s" else "energy"
    front = [p for p in compared if (p.on_front.time_s if cost == "time" else p.on_front.energy_j)]
    within = sum(bool(point.acceptable) for point in compared)
    quality = "" if tradeoff.energy_quality in ("measured", "time_only") else f" ({tradeoff.energy_quality})"
    caption = (
        f"Each point is one configuration: further left costs less {cost}{quality}, further down looks more like the "
        f"reference. Bars are {tradeoff.confidence:.0%} intervals; points whose bars overlap may change places. Points "
        "below the limit are acceptable. The line joins the front: no other point is both cheaper and closer; it is "
        "dashed where the intervals do not confirm that."
    )
    alt = (
        f"Trade-off chart of {tradeoff.scene} on {tradeoff.device}: {len(compared)} configurations, "
        f"{within} within the limit {figure(tradeoff.limit)}, {len(front)} on the front."
    )
    return Chart(f"{name}-tradeoff", charts.tradeoff_chart(tradeoff, frame.View(x=tradeoff.main_axis)), caption, alt)


def _stages_chart(view: View, name: str) -> Block:
    tradeoff = view.tradeoff
    if not any(point.stages for point in tradeoff.points):
        return Words("The renderer told nothing of its stages.", "notice")
    chosen = view.recommendation.configuration_id if view.recommendation else None
    caption = "What each stage of an image costs, the cheapest configuration first and the reference last."
    alt = f"Stacked bars of the stages' costs of {tradeoff.scene} on {tradeoff.device}, a bar a configuration."
    return Chart(f"{name}-stages", charts.stages_chart(tradeoff, chosen=chosen), caption, alt)


def _spread_over(points: Sequence[Point], most: int) -> list[Point]:
    """At most so many of the points, evenly over their order, both ends among them."""
    if len(points) <= most:
        return list(points)
    return [points[round(place * (len(points) - 1) / (most - 1))] for place in range(most)]


def _answer(view: View, told_in: str) -> list[Block]:
    found = view.recommendation
    if found is None:
        return [Words(view.unanswered, "notice")]
    if found.answer == "none":
        nearest = [f"{choice.label}: {choice.misses}" for choice in found.nearest]
        none: list[Block] = [Words(f"No setting meets {_asked(found)}.", "notice"), Points(found.why)]
        return [*none, Words("Nearest to it:"), Points(nearest)] if nearest else none
    rows = [("Settings", found.label or "")]
    if found.energy_j is not None:
        rows.append(("Energy an image", _with_quality(frame.spread(found.energy_j, "J"), found)))
    if found.time_s is not None:
        rows.append(("Time an image", frame.spread(found.time_s, "s")))
    rows.append(("Difference", f"{frame.spread(found.difference, '')}, limit {figure(found.limit)}"))
    if found.saves_share is not None:
        rows.append(("Saves", f"{share(found.saves_share)} of what the reference costs"))
    rows.append(("Basis", "measured runs" if found.basis == "measured" else "predicted: never measured"))
    rows.append(("To render with it", render_command(found.scene, told_in)))
    blocks: list[Block] = [Facts(rows)]
    if found.fragile:
        blocks.append(Words(f"Fragile: {found.fragile}.", "notice"))
    blocks.append(Points(found.why))
    if found.runner_up:
        blocks.append(Words(f"Runner-up: {_choice_told(found.runner_up)}."))
    if found.settings:
        blocks.append(Fold("All its settings", [Facts([(n, setting(v)) for n, v in found.settings.items()])]))
    return blocks


def _asked(found: Recommendation) -> str:
    budget = (
        f"{figure(found.budget_j)} J" if found.budget_j else f"{figure(found.budget_s)} s" if found.budget_s else ""
    )
    limit = f"the difference limit {figure(found.limit)}"
    return f"{limit} within {budget}" if budget else limit


def _cost(found: Recommendation) -> str:
    if found.energy_quality == "time_only" or found.energy_j is None:
        return frame.spread(found.time_s, "s")
    return _with_quality(frame.spread(found.energy_j, "J"), found)


def _with_quality(told: str, found: Recommendation) -> str:
    return told if found.energy_quality in ("measured", "time_only") else f"{told}, {found.energy_quality}"


def _choice_told(choice: Choice) -> str:
    cost = frame.spread(choice.energy_j, "J") if choice.energy_j else frame.spread(choice.time_s, "s")
    return f"{choice.label}, {cost}, difference {frame.spread(choice.difference, '')}"


def _ratings(tradeoff: Tradeoff) -> list[Block]:
    if not tradeoff.ratings:
        return [Words("No setting was varied alone, so none can be rated.")]
    rows = [
        (
            rating.setting,
            rating.energy_impact,
            figure(rating.elasticity),
            rating.image_sensitivity,
            "; ".join(_step(cliff) for cliff in rating.cliffs) or _still(rating),
        )
        for rating in tradeoff.ratings
    ]
    what = "time" if tradeoff.main_axis == "time_s" else "energy"
    return [
        Words(
            f"Impact says how strongly the {what} of an image answers to a setting (the exponent at its steepest step: "
            "1 is in proportion). Sensitivity says what changing it does to the picture: low stays within the limit, "
            "high leaves it by three limits at the first step. A cliff is a step that multiplies the difference by "
            "three or more, to beyond the limit."
        ),
        Table(("setting", f"{what} impact", "exponent", "image sensitivity", "cliffs"), rows, numeric=frozenset({2})),
    ]


def _step(step: Step) -> str:
    return f"{setting(step.start)} to {setting(step.end)}"


def _still(rating: Rating) -> str:
    return "none; not a pixel changes" if all(step.same_picture for step in rating.steps) else "none"


def _pictures(view: View, name: str) -> list[Block]:
    tradeoff = view.tradeoff
    if view.reference is None:
        return [Words("The pictures are not stored any more.", "notice")]
    shown = [
        Picture(
            f"{name}-reference", view.reference, "Reference", f"{tradeoff.scene}, rendered with the reference settings"
        )
    ]
    for role, compared in view.pictures.items():
        shown += _of_role(role, compared, tradeoff, name)
    caption = (
        f"Shown at exposure {figure(tradeoff.exposure)}. In the error maps brighter pixels differ more visibly; black "
        "ones look the same as the reference."
    )
    return [Words(caption), Pictures(shown)]


def _of_role(role: str, compared: Compared, tradeoff: Tradeoff, name: str) -> list[Picture]:
    point, pictures = compared.point, []
    told = f"{point.label}, difference {frame.spread(point.difference, '')}, {cost_told(point, tradeoff)}"
    if compared.picture is not None:
        alt = f"{tradeoff.scene} with {point.label}"
        pictures.append(Picture(f"{name}-{role}", compared.picture, f"{ROLES[role]}: {told}", alt))
    if compared.delta is not None:
        alt = f"Error map of {point.label} against the reference"
        pictures.append(Picture(f"{name}-{role}-delta", compared.delta, f"Error map of: {point.label}", alt))
    return pictures


def _points_table(tradeoff: Tradeoff, csv_name: str) -> Block:
    shown = _spread_over(tradeoff.points, MOST_ROWS)
    rows = [
        (
            point.label,
            energy_told(point),
            frame.spread(point.time_s, "s"),
            frame.spread(point.difference, ""),
            {True: "yes", False: "no", None: "unknown"}[point.acceptable],
            _standing(point, tradeoff),
            "yes" if point.fragile else "",
        )
        for point in shown
    ]
    columns = ("settings", "energy an image", "time an image", "difference", "acceptable", "front", "fragile")
    some = "" if len(shown) == len(tradeoff.points) else f"{len(shown)} of {len(tradeoff.points)} configurations"
    return Table(columns, rows, some, file=csv_name)


def _standing(point: Point, tradeoff: Tradeoff) -> str:
    on = point.on_front.time_s if tradeoff.main_axis == "time_s" else point.on_front.energy_j
    return ("yes" if point.confirmed else "yes, unconfirmed") if on else ""
