"""From a sweep's definition to its configurations, and from those to jobs in randomised blocks."""

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

from joulebox_server.schemas.sweep import DRAWN, SweepDefinition
from joulebox_server.store.ids import canonical
from joulebox_server.sweeps.drawing import drawn
from joulebox_server.sweeps.seeds import own_seed

REFERENCE_SEED_STEP = 1000
NOISE_FLOOR_SEED_STEP = 2000
FILM = ("width", "height")

Purpose = Literal["measure", "reference", "noise_floor", "control"]


@dataclass(frozen=True)
class Configuration:
    """Settings to render with (`seed` is that of repeat 0), and those among them that the sweep varies."""

    settings: dict[str, Any]
    changed: dict[str, Any]

    @property
    def key(self) -> str:
        """Equal for equal settings."""
        return canonical(self.settings)


@dataclass(frozen=True)
class PlannedJob:
    """One job for one device: `scene` and `configuration` are positions in the sweep's lists.

    `block` and `position` order the jobs of a device; the reference and its noise floor come before block 0,
    so that differences can be seen while the sweep runs. One that is not `metered` is timed only.
    """

    purpose: Purpose
    scene: int
    configuration: int
    repeat: int
    seed: int
    block: int
    position: int
    metered: bool


def configurations(definition: SweepDefinition) -> list[Configuration]:
    """Every configuration of a sweep once, in the order of its axes or list."""
    base = _base(definition)
    found: dict[str, Configuration] = {}
    for changed in _changes(definition):
        configuration = Configuration(base | changed, changed)
        found.setdefault(configuration.key, configuration)
    return list(found.values())


def added_configuration(definition: SweepDefinition, settings: Mapping[str, Any]) -> Configuration:
    """A combination of values of a sweep's axes that the sweep does not hold of its own accord.

    settings   as a renderer completed them; of these the axes' are taken, the rest is the sweep's own
    """
    changed = {name: settings[name] for name in axis_names(definition) if name in settings}
    return Configuration(_base(definition) | changed, changed)


def axis_names(definition: SweepDefinition) -> list[str]:
    """Settings that a sweep varies."""
    if definition.rule != "list":
        return list(definition.axes)
    return list(dict.fromkeys(name for settings in definition.configurations for name in settings))


def reference_configuration(definition: SweepDefinition) -> Configuration:
    """The settings of the reference; see ReferenceRules. Its seed is the sweep's base seed."""
    rules = definition.reference
    base = _base(definition)
    preset = rules.preset or (None if rules.settings else "reference")
    if preset is not None:
        base = {key: base[key] for key in (*FILM, "seed") if key in base} | {"preset": preset}
    return Configuration(base | rules.settings, {})


def configuration_count(definition: SweepDefinition) -> int:
    """How many configurations there are at most, without making them."""
    if definition.rule == "list":
        return len(definition.configurations)
    if definition.rule in DRAWN:
        return definition.samples or 0
    lengths = [len(values) for values in definition.axes.values() if isinstance(values, list)]
    if definition.rule == "one_at_a_time":
        return 1 + sum(lengths)
    count = 1
    for length in lengths:
        count *= length
    return count


def plan_jobs(
    definition: SweepDefinition, measured: list[Configuration], reference: Configuration, order_key: str
) -> list[PlannedJob]:
    """All jobs of one device; `order_key` seeds the order, so that each device has its own and can repeat it.

    `configuration` counts through `measured`; the reference's is `len(measured)`. A control run is the first
    configuration once more; they lie at equal distances in their block, one at its beginning.
    """
    jobs = list(_reference_jobs(definition, len(measured), _seed(reference)))
    shuffle = random.Random(order_key)
    metered = metered_configurations(definition, measured)
    for repeat in range(definition.repeats):
        block = [
            (scene, configuration) for scene in range(len(definition.scenes)) for configuration in range(len(measured))
        ]
        shuffle.shuffle(block)
        mixed: list[tuple[Purpose, int, int, int]] = [("measure", *entry, repeat) for entry in block]
        for place, control in reversed(list(_controls(definition, repeat, len(block)))):
            mixed.insert(place, control)
        for position, (purpose, scene, configuration, number) in enumerate(mixed):
            seed = _seed(measured[configuration])
            if purpose == "measure":
                seed = repeat_seed(definition, measured[configuration], repeat)
            joules = _any(definition) and purpose == "control"
            joules |= configuration in metered and (repeat == 0 or not _few(definition))
            jobs.append(PlannedJob(purpose, scene, configuration, number, seed, repeat, position, joules))
    return jobs


def repeat_seed(definition: SweepDefinition, configuration: Configuration, repeat: int) -> int:
    """The seed that a configuration's repeat is rendered with: counted on from its first, or its own."""
    first = _seed(configuration)
    return own_seed(first, configuration.settings, repeat) if definition.own_seeds else first + repeat


def metered_configurations(definition: SweepDefinition, measured: list[Configuration]) -> set[int]:
    """Positions of the configurations whose joules are measured; with `meter = "few"` those least alike.

    Each next one is the farthest from all before, settings taken by their rank: stage powers are fitted on what
    differs most. At least two, so that there is something to fit.
    """
    if not _few(definition):
        return set(range(len(measured))) if _any(definition) else set()
    rules = definition.measure
    wanted = min(len(measured), max(2, -(-rules.metered_windows // rules.min_windows)))
    points = _ranks(measured)
    chosen = [0]
    distances = [_apart(points[0], point) for point in points]
    while len(chosen) < wanted:
        chosen.append(max(range(len(points)), key=distances.__getitem__))
        distances = [min(old, _apart(points[chosen[-1]], point)) for old, point in zip(distances, points, strict=True)]
        distances[chosen[-1]] = -1.0
    return set(chosen)


def _any(definition: SweepDefinition) -> bool:
    return definition.measure.meter != "none"


def _few(definition: SweepDefinition) -> bool:
    return definition.measure.meter == "few"


def _ranks(measured: list[Configuration]) -> list[list[float]]:
    """Each configuration as a point: a coordinate from 0 to 1 for each setting that varies."""
    names = list(dict.fromkeys(name for configuration in measured for name in configuration.changed))
    columns = []
    for name in names:
        values = [configuration.settings.get(name) for configuration in measured]
        order = {value: rank for rank, value in enumerate(sorted(set(values), key=_sorting))}
        columns.append([order[value] / max(1, len(order) - 1) for value in values])
    return [list(point) for point in zip(*columns, strict=True)] if columns else [[] for _ in measured]


def _sorting(value: Any) -> tuple[int, float, str]:
    number = isinstance(value, int | float)
    return (0, float(value), "") if number else (1, 0.0, str(value))


def _apart(one: list[float], other: list[float]) -> float:
    return sum((a - b) ** 2 for a, b in zip(one, other, strict=True))


def _controls(
    definition: SweepDefinition, block: int, length: int
) -> Iterator[tuple[int, tuple[Purpose, int, int, int]]]:
    """(place in the block before which it comes, control run), in order of place."""
    count = definition.controls
    for index in range(count):
        for scene in range(len(definition.scenes)):
            yield index * length // count, ("control", scene, 0, block * count + index)


def _reference_jobs(definition: SweepDefinition, configuration: int, seed: int) -> Iterator[PlannedJob]:
    same = definition.reference.seed_policy == "same"
    for scene in range(len(definition.scenes)):
        for repeat in range(definition.repeats if same else 1):
            own = seed + repeat if same else seed + REFERENCE_SEED_STEP
            yield PlannedJob("reference", scene, configuration, repeat, own, -1, scene, metered=_any(definition))
        floor_seed = seed + NOISE_FLOOR_SEED_STEP
        yield PlannedJob("noise_floor", scene, configuration, 0, floor_seed, -1, scene, metered=False)


def _seed(configuration: Configuration) -> int:
    seed = configuration.settings["seed"]
    return seed if isinstance(seed, int) else 0


def _base(definition: SweepDefinition) -> dict[str, Any]:
    preset = {} if definition.preset is None else {"preset": definition.preset}
    return preset | {"seed": definition.base_seed} | definition.settings


def _changes(definition: SweepDefinition) -> Iterator[dict[str, Any]]:
    if definition.rule == "list":
        yield from definition.configurations
    elif definition.rule == "grid":
        for values in product(*_lists(definition).values()):
            yield dict(zip(definition.axes, values, strict=True))
    elif definition.rule in DRAWN:
        yield from drawn(definition)
    else:
        yield {}
        for axis, axis_values in _lists(definition).items():
            for value in axis_values:
                yield {axis: value}


def _lists(definition: SweepDefinition) -> dict[str, list[Any]]:
    """The axes of a rule that takes no ranges."""
    return {axis: values for axis, values in definition.axes.items() if isinstance(values, list)}
