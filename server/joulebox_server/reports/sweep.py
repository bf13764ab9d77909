"""The report of sweeps: what was swept and how, what came out for every scene and device, and what to take."""

import json
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from joulebox_server import __version__
from joulebox_server.analysis.words import figure, setting, settings
from joulebox_server.reports.comparison import comparable, comparison_section
from joulebox_server.reports.document import Block, Facts, Points, Report, Section, Table, Words
from joulebox_server.reports.gathering import Findings, View
from joulebox_server.reports.points_csv import points_csv
from joulebox_server.reports.view import answer_sentence, settings_file, view_section
from joulebox_server.reports.wording import QUALITY_MEANS, count_of, listed, quality_label

TABLES = "tables"
POINTS_FILE = f"{TABLES}/points.csv"
MOST_FAILURES = 50
PURPOSES = {"measure": "measurement", "noise_floor": "noise floor", "control": "control run"}

HOW_TO_READ = (
    "Difference: how visibly a picture differs from the reference, summed over its pixels (just noticeable "
    "differences, with contrast sensitivity and masking). 0 is the same picture. It has no unit and grows with the "
    "number of pixels.",
    "Limit: up to it a picture is acceptable. It is 100 at 256 x 256 pixels unless the sweep says otherwise, and "
    "scales with the number of pixels.",
    "Noise floor: the reference against itself at another seed. Differences of that size are noise.",
    "Interval: where the value is, with the stated confidence, judged by its scatter over repeats and seeds.",
    "Front: the configurations that no other beats in both cost and difference. Unconfirmed: the intervals allow "
    "another order.",
    "Fragile: one step of a setting away the picture falls off a cliff, or another seed may leave the limit.",
    *(f"{quality_label(quality).capitalize()}: {means}" for quality, means in QUALITY_MEANS.items()),
)


def sweep_report(findings: Sequence[Findings], now: datetime | None = None) -> Report:
    """The report of one sweep or several, each of its views in a section of its own.

    now     stands in the footer; the present unless given
    """
    views = [view for found in findings for view in found.views]
    names = _names(views, several=len(findings) > 1)
    sides = comparable(views)
    sections = [
        Section("In short", "summary", _summary(findings, views)),
        *(Section(*_swept(found, len(findings) > 1), _set_up(found)) for found in findings),
        *(comparison_section(scene, found, f"devices-{k}") for k, (scene, found) in enumerate(sides.items(), 1)),
        *(view_section(v, n, POINTS_FILE, _heading(v, len(findings) > 1)) for v, n in zip(views, names, strict=True)),
        Section("How to read this", "reading", [Points(HOW_TO_READ)]),
    ]
    made = now or datetime.now(UTC)
    return Report(
        title=_title(findings),
        subtitle=_subtitle(findings, views),
        sections=sections,
        footer=f"Made by joulebox {__version__} on {made:%Y-%m-%d %H:%M} UTC. This page asks nothing of any network.",
        attachments=_attachments(findings, views, names),
    )


def _title(findings: Sequence[Findings]) -> str:
    names = [str(found.document["name"]) for found in findings]
    return f"{'Sweep' if len(names) == 1 else 'Sweeps'} {listed(names)}"


def _subtitle(findings: Sequence[Findings], views: Sequence[View]) -> str:
    scenes = {view.tradeoff.scene for view in views}
    devices = {view.tradeoff.device for view in views if view.tradeoff.device}
    points = sum(len(view.tradeoff.points) for view in views)
    measured = f"{count_of(points, 'configuration')} measured"
    return f"{count_of(len(scenes), 'scene')} on {count_of(len(devices), 'device')}, {measured}"


def _summary(findings: Sequence[Findings], views: Sequence[View]) -> list[Block]:
    blocks: list[Block] = []
    for found in findings:
        blocks += _state_words(found)
    qualities = {view.tradeoff.energy_quality for view in views if view.tradeoff.points}
    for quality in QUALITY_MEANS:
        if quality in qualities and quality != "measured":
            where = listed(sorted({v.tradeoff.device for v in views if v.tradeoff.energy_quality == quality}))
            blocks.append(Words(f"{where}: {QUALITY_MEANS[quality]}", "notice"))
    return [Points([answer_sentence(view) for view in views]), *blocks]


def _state_words(found: Findings) -> list[Block]:
    document, jobs = found.document, found.document["jobs"]
    name, told = document["name"], []
    if document["state"] in ("running", "paused", "cancelled"):
        told.append(f"{name} is {document['state']}: {jobs['done']} of {jobs['total']} jobs are done. ")
    if document["differences_pending"]:
        told.append(f"{count_of(document['differences_pending'], 'difference')} of {name} are still to be computed. ")
    if found.failures:
        told.append(f"{count_of(len(found.failures), 'job')} of {name} failed; what they would have shown is missing. ")
    return [Words("".join(told).strip(), "notice")] if told else []


def _swept(found: Findings, several: bool) -> tuple[str, str]:
    """Heading and anchor."""
    name = str(found.document["name"])
    return (
        (f"What was swept: {name}", f"swept-{_slug(name)}-{found.document['id'][-6:]}")
        if several
        else (
            "What was swept",
            "swept",
        )
    )


def _set_up(found: Findings) -> list[Block]:
    document, definition = found.document, found.document["definition"]
    jobs = document["jobs"]
    methods = found.methods()
    devices = [f"{device}: {methods.get(device, 'nothing measured yet')}" for device in document["devices"]]
    rows = [
        ("Sweep", f"{document['name']} ({document['id']}), made {document['created_at']}"),
        ("State", f"{document['state']}: {jobs['done']} of {jobs['total']} jobs done, {jobs['failed']} failed"),
        ("Scenes", ", ".join(document["scenes"])),
        ("Devices and method", "; ".join(devices) or "no device has taken a job yet"),
        *_axes(definition),
        ("Other settings", _base(definition)),
        ("Repeats", f"{definition['repeats']} of each configuration, each with a seed of its own"),
        ("Reference", _reference(definition)),
        ("Acceptable difference", f"{figure(definition['limit'])} at 256 x 256 pixels"),
        ("Measuring", _measuring(definition["measure"])),
    ]
    blocks: list[Block] = [Facts(rows)]
    if found.failures:
        shown = [(scene, PURPOSES.get(purpose, purpose), reason) for scene, purpose, reason in found.failures]
        caption = f"The {count_of(len(shown), 'job')} that failed"
        if len(shown) > MOST_FAILURES:
            caption += f", the first {MOST_FAILURES} of them"
        blocks.append(Table(("scene", "job", "reason"), shown[:MOST_FAILURES], caption))
    return blocks


def _axes(definition: dict[str, Any]) -> list[tuple[str, str]]:
    rule = definition["rule"]
    if rule == "list":
        count = len(definition["configurations"])
        return [("Varied", f"{count_of(count, 'configuration')} as listed in the sweep")]
    how = {"grid": "every combination of", "one_at_a_time": "one at a time:"}.get(rule)
    how = how or f"{definition['samples']} drawn by {rule} from"
    told = [f"{name} {_axis(values)}" for name, values in definition["axes"].items()]
    return [("Varied", f"{how} {'; '.join(told)}" if told else "nothing: one configuration")]


def _axis(values: Any) -> str:
    if isinstance(values, dict):
        return f"{setting(values['low'])} to {setting(values['high'])} ({values['scale']})"
    return ", ".join(setting(value) for value in values)


def _base(definition: dict[str, Any]) -> str:
    told = [f"preset {definition['preset']}"] if definition["preset"] else []
    told += [settings(definition["settings"])] if definition["settings"] else []
    return ", ".join(told) or "the renderer's defaults"


def _reference(definition: dict[str, Any]) -> str:
    rules = definition["reference"]
    told = [f"preset {rules['preset']}"] if rules["preset"] else []
    told += [settings(rules["settings"])] if rules["settings"] else []
    seed = "the same seed" if rules["seed_policy"] == "same" else "another seed"
    return f"{', '.join(told) or 'preset reference'}; rendered with {seed}"


def _measuring(rules: dict[str, Any]) -> str:
    windows = f"{rules['min_windows']} to {rules['max_windows']} windows of {figure(rules['window_s'])} s"
    few = f"; about {rules['metered_windows']} windows of a device metered" if rules["meter"] == "few" else ""
    return f"{windows}, until the interval is within {rules['half_width']:.0%}{few}"


def _heading(view: View, several: bool) -> str:
    where = f"{view.tradeoff.scene} on {view.tradeoff.device or 'no device yet'}"
    return f"{where} ({view.sweep})" if several else where


def _names(views: Sequence[View], several: bool) -> list[str]:
    """A name for each view's figures, of letters, digits and hyphens, no two alike."""
    names: list[str] = []
    for view in views:
        parts = [*([view.sweep] if several else []), view.tradeoff.scene, view.tradeoff.device or "no-device"]
        name = "-".join(_slug(part) for part in parts)
        count = sum(known == name or known.startswith(f"{name}--") for known in names)
        names.append(f"{name}--{count + 1}" if count else name)
    return names


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:40] or "x"


def _attachments(findings: Sequence[Findings], views: Sequence[View], names: Sequence[str]) -> dict[str, bytes]:
    made = {POINTS_FILE: points_csv([(view.sweep, view.tradeoff) for view in views])}
    for found in findings:
        name = "results" if len(findings) == 1 else f"results-{_slug(found.document['name'])}-{found.document['id']}"
        made[f"{TABLES}/{name}.csv"] = found.results_csv
    for view, name in zip(views, names, strict=True):
        if view.recommendation and view.recommendation.settings:
            made[settings_file(name)] = json.dumps(view.recommendation.settings, indent=1).encode()
    return made
