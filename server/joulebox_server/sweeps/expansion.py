"""From a sweep's definition to its configurations, and from those to jobs in randomised blocks."""

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

from joulebox_server.schemas.sweep import SweepDefinition
from joulebox_server.store.ids import canonical

REFERENCE_SEED_STEP = 1000
NOISE_FLOOR_SEED_STEP = 2000
FILM = ("width", "height")

Purpose = Literal["measure", "reference", "noise_floor"]


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
    so that differences can be seen while the sweep runs.
    """

    purpose: Purpose
    scene: int
    configuration: int
    repeat: int
    seed: int
    block: int
    position: int


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
    lengths = [len(values) for values in definition.axes.values()]
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

    `configuration` counts through `measured`; the reference's is `len(measured)`.
    """
    jobs = list(_reference_jobs(definition, len(measured), _seed(reference)))
    shuffle = random.Random(order_key)
    for repeat in range(definition.repeats):
        block = [
            (scene, configuration) for scene in range(len(definition.scenes)) for configuration in range(len(measured))
        ]
        shuffle.shuffle(block)
        for position, (scene, configuration) in enumerate(block):
            seed = _seed(measured[configuration]) + repeat
            jobs.append(PlannedJob("measure", scene, configuration, repeat, seed, repeat, position))
    return jobs


def _reference_jobs(definition: SweepDefinition, configuration: int, seed: int) -> Iterator[PlannedJob]:
    same = definition.reference.seed_policy == "same"
    for scene in range(len(definition.scenes)):
        for repeat in range(definition.repeats if same else 1):
            own = seed + repeat if same else seed + REFERENCE_SEED_STEP
            yield PlannedJob("reference", scene, configuration, repeat, own, -1, scene)
        yield PlannedJob("noise_floor", scene, configuration, 0, seed + NOISE_FLOOR_SEED_STEP, -1, scene)


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
        for values in product(*definition.axes.values()):
            yield dict(zip(definition.axes, values, strict=True))
    else:
        yield {}
        for axis, axis_values in definition.axes.items():
            for value in axis_values:
                yield {axis: value}
