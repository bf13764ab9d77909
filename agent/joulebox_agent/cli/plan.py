"""What `measure` and `calibrate` are asked to do, checked before anything is rendered."""

import math
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import platformdirs
import typer

from joulebox_agent.errors import UsageError
from joulebox_agent.measuring.blocks import Course, Order
from joulebox_agent.measuring.calibrating import companion_of
from joulebox_agent.measuring.charging import Band, Charging, Forecast
from joulebox_agent.measuring.configurations import Entry, read_configurations
from joulebox_agent.measuring.journal import Journal
from joulebox_agent.measuring.measure import make_meter
from joulebox_agent.measuring.meter import Listener
from joulebox_agent.measuring.rule import MeasureRule
from joulebox_agent.measuring.session import Configuration, Session
from joulebox_agent.measuring.visit import Job
from joulebox_agent.sources.choose import KNOWN, Choice

A_VISIT_S = 8.0  # to start a renderer and warm it up, for the forecast
TIMED_S = 30.0  # that a configuration takes which is only timed, for the forecast

Scene = Annotated[str, typer.Argument(help="Scene folder or name, as the renderer takes it.")]
Setting = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting; repeatable.")]
SettingsFile = Annotated[Path | None, typer.Option(help="File of settings (JSON or TOML).")]
Preset = Annotated[str | None, typer.Option(help="Preset of the renderer.")]
Define = Annotated[list[str] | None, typer.Option("-D", "--define", metavar="NAME=VALUE", help="A scene's value.")]
Renderer = Annotated[str | None, typer.Option(help="Command that speaks the loop protocol.")]
Source = Annotated[str, typer.Option(help=", ".join(KNOWN) + ".")]
SysfsRoot = Annotated[Path, typer.Option(help="Folder that plays /sys.")]
StateFolder = Annotated[Path | None, typer.Option("--state-dir", help="Folder of this device's calibration.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the document.")]


@dataclass(frozen=True)
class Plan:
    """Everything a session needs to begin.

    command    the renderer's program
    arguments  scene, settings and defines that all configurations share, as the loop command takes them
    """

    command: list[str]
    arguments: list[str]
    rule: MeasureRule
    choice: Choice
    sysfs_root: Path
    entries: tuple[Entry, ...] = (Entry({}, ""),)
    course: Course = field(default_factory=Course)
    charging: Charging | None = None
    resume: Path | None = None

    def configurations(self, scratch: Path) -> list[Configuration]:
        """The entries as jobs that leave their pictures in `scratch`."""
        return [
            Configuration(
                Job(self.command, [*self.arguments, *entry.arguments()], scratch / f"{number}.exr"),
                entry.label,
                entry.timed_only,
            )
            for number, entry in enumerate(self.entries)
        ]

    def journal(self) -> Journal | None:
        """Where progress is kept, None when nobody asked; another plan's progress is not taken up."""
        if self.resume is None:
            return None
        identity = {
            "arguments": self.arguments,
            "entries": [[*entry.arguments(), entry.timed_only] for entry in self.entries],
            "command": self.command,
            "rule": self.rule.model_dump(),
            "source": self.choice.name,
            "order": [self.course.order, self.course.seed],
        }
        return Journal(self.resume, identity)

    def session(self, configurations: list[Configuration], listener: Listener, journal: Journal | None) -> Session:
        """Ready to run, with RAPL read along where a battery can be calibrated by it."""
        companion = companion_of(self.choice, self.sysfs_root)
        meter = make_meter(self.choice, self.sysfs_root, listener, companion=companion)
        return Session(configurations, self.rule, meter, self.course, self.charging, journal)

    def forecast(self) -> Forecast | None:
        """What the pilot's blocks take from the battery: what every plan takes at the least."""
        if self.charging is None:
            return None
        metered = sum(not entry.timed_only for entry in self.entries)
        visits_s = metered * self.rule.min_windows * (self.rule.window_s + A_VISIT_S)
        idle_s = self.rule.idle_s * (self.rule.min_windows + 1)
        timed_s = (len(self.entries) - metered) * (TIMED_S + A_VISIT_S)
        return self.charging.forecast(visits_s + idle_s + timed_s, self.choice.report.power_w)


def state_folder(given: Path | None) -> Path:
    return given or Path(platformdirs.user_state_dir("joulebox-agent"))


def loop_arguments(
    scene: str, settings: list[str] | None, file: Path | None, preset: str | None, defines: list[str] | None
) -> list[str]:
    """The loop command's arguments. Raises UsageError for what is not key=value, or a missing file."""
    for option, pairs in (("--set", settings or []), ("-D", defines or [])):
        for pair in pairs:
            if "=" not in pair or pair.startswith("="):
                raise UsageError(f"{option} {pair!r} must be key=value.")
    if file is not None and not file.is_file():
        raise UsageError(f"The settings file {file} does not exist.")
    arguments = [scene]
    if file is not None:
        arguments += ["--settings", str(file)]
    if preset is not None:
        arguments += ["--set", f"preset={preset}"]
    for pair in settings or []:
        arguments += ["--set", pair]
    for pair in defines or []:
        arguments += ["-D", pair]
    return arguments


def entries_of(configurations: Path | None, timed_only: Path | None, meter: int | None) -> tuple[Entry, ...]:
    """What is measured: one configuration without a file. Raises UsageError."""
    if configurations is None:
        if timed_only is not None or meter is not None:
            raise UsageError("--timed-only and --meter go with --configurations: joules come from metered ones.")
        return (Entry({}, ""),)
    entries = read_configurations(configurations)
    if meter is not None:
        entries = [replace(e, timed_only=e.timed_only or i >= meter) for i, e in enumerate(entries)]
    if timed_only is not None:
        entries += [replace(entry, timed_only=True) for entry in read_configurations(timed_only)]
    if all(entry.timed_only for entry in entries):
        raise UsageError("Every configuration is timed only; meter at least one.")
    return tuple(entries)


def course_of(order: str, seed: int, control: int, cool_to_c: float | None, entries: tuple[Entry, ...]) -> Course:
    """In which order the entries are visited. Raises UsageError."""
    chosen: dict[str, Order] = {"blocks": "blocks", "sequence": "sequence"}
    if order not in chosen:
        raise UsageError(f"--order {order!r} must be blocks or sequence.")
    if cool_to_c is not None and not math.isfinite(cool_to_c):
        raise UsageError(f"--cool-to {cool_to_c} must be a temperature in °C.")
    if control > len(entries) or entries[control - 1].timed_only:
        raise UsageError(f"--control {control} must be the number of a metered configuration.")
    return Course(chosen[order] if len(entries) > 1 else "sequence", seed, control - 1, cool_to_c)


def charging_of(choice: Choice, root: Path, several: bool, band: str | None, hook: str | None) -> Charging | None:
    """Whether the battery is planned for: when asked, and for several configurations on a battery."""
    if not choice.source.method.startswith("battery"):
        if band or hook:
            raise UsageError(f"A charge band is for a battery; the source here is {choice.source.method}.")
        return None
    if not (several or band or hook):
        return None
    return Charging(Band.parse(band) if band else Band(), root, choice.name, hook)


def make_folder(folder: Path | None) -> None:
    """Raises UsageError for a folder that cannot be written to: before hours of measuring, not after them."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"The folder {folder} cannot be made: {error.strerror}.") from error
    if not os.access(folder, os.W_OK):
        raise UsageError(f"The folder {folder} cannot be written to.")


def say_source(listener: Listener, choice: Choice) -> None:
    """What is measured with, and why not with something better."""
    for report in choice.declined:
        listener.note(
            f"{report.method} cannot be used: {report.reason}" + (f" ({report.remedy})" if report.remedy else "")
        )
    quality, method = choice.source.quality, choice.source.method
    if quality == "none":
        listener.note("No energy source: time and CPU seconds only, energy stays null.")
    elif quality == "replayed":
        listener.note(f"Energy is REPLAYED from {', '.join(choice.report.files)}: not a measurement of this machine.")
    else:
        listener.note(f"Energy from {method} ({choice.source.scope}): {choice.report.reason}")
