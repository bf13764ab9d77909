"""A power or energy sensor of Linux' class/hwmon, for boards without a battery.

What such a sensor covers (the whole board, one rail, a graphics card) only its owner knows, so nothing is taken
without being named: `hwmon:CHIP/SENSOR`, and what it covers behind `=`.
Source: Documentation/hwmon/sysfs-interface: powerN_input and powerN_average [uW], energyN_input [uJ].
"""

import re
from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.errors import UsageError
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import Sysfs, remedy_for_error, sentence

PREFIX = "hwmon"
MICRO = 1e-6
SENSOR = re.compile(r"(power|energy)(\d+)_(input|average)")
HIGHEST_W = 10_000.0


@dataclass(frozen=True)
class Sensor:
    """A sensor's file, the chip it sits on, its number (power1) and the driver's label for it, if any."""

    file: Path
    chip: str
    name: str
    label: str

    @property
    def title(self) -> str:
        label = f" ({self.label})" if self.label else ""
        return f"{self.chip}/{self.name}{label} at {self.file.parent.name}"


class Hwmon:
    """One named sensor; without a name, the list of those there are."""

    method = "hwmon"
    quality: Quality = "measured"
    poll_s = 0.5

    def __init__(self, sysfs: Sysfs, wanted: str = "", covers: str = "") -> None:
        self._sysfs, self._wanted = sysfs, wanted
        self.scope = covers or (f"sensor {wanted}" if wanted else "as stated")
        self._sensor: Sensor | None = None
        self._first_uj: int | None = None
        self._last_uj: int | None = None
        self._epoch = 0

    @property
    def primary(self) -> Primary:
        return "counter" if self._sensor is not None and self._sensor.name.startswith("energy") else "power"

    def report(self) -> SourceReport:
        try:
            sensors = find_sensors(self._sysfs)
            if not sensors:
                return self._report((), False, None, "no power or energy sensor in class/hwmon", "")
            if not self._wanted:
                return self._unnamed(sensors)
            sensor = self._chosen(sensors)
            if sensor is None:
                reason = f"{self._wanted} is not one sensor; there are {_titles(sensors)}"
                return self._report(
                    (), False, None, reason, "name one of them (hwmonN in place of a chip that is there twice)"
                )
            self._sensor = sensor
            value = self._sysfs.integer(sensor.file)
        except OSError as error:
            return self._report((), False, None, sentence(error), remedy_for_error(error))
        if value is None:
            return self._report((sensor,), False, None, f"{sensor.title} tells no value now", "")
        power_w = value * MICRO if self.primary == "power" else None
        return self._report((sensor,), True, power_w, f"sensor {sensor.title}, which covers: {self.scope}", "")

    def _unnamed(self, sensors: list[Sensor]) -> SourceReport:
        remedy = f"say which and what it covers: --source 'hwmon:{sensors[0].chip}/{sensors[0].name}=whole machine'"
        return self._report(tuple(sensors), False, None, f"sensors: {_titles(sensors)}", remedy)

    def _report(
        self, sensors: tuple[Sensor, ...], available: bool, power_w: float | None, reason: str, remedy: str
    ) -> SourceReport:
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=available,
            power_w=power_w,
            files=tuple(str(sensor.file) for sensor in sensors),
            reason=reason,
            remedy=remedy,
        )

    def _chosen(self, sensors: list[Sensor]) -> Sensor | None:
        """The sensor called CHIP, CHIP/powerN or CHIP/LABEL, CHIP a name or hwmonN; None unless one answers."""
        chip, slash, name = self._wanted.partition("/")
        found = [
            s for s in sensors if chip in (s.chip, s.file.parent.name) and (not slash or name in (s.name, s.label))
        ]
        return found[0] if len(found) == 1 else None

    def read(self) -> Reading:
        try:
            if self._sensor is None:
                self._sensor = self._chosen(find_sensors(self._sysfs)) if self._wanted else None
            if self._sensor is None:
                return Reading(epoch=self._epoch, problem=f"there is no sensor {self._wanted or 'without a name'}")
            value = self._sysfs.integer(self._sensor.file)
        except OSError as error:
            return Reading(epoch=self._epoch, problem=sentence(error))
        if value is None:
            self._sensor = None  # hwmonN is renumbered when a driver comes back
            return Reading(epoch=self._epoch, problem="the sensor tells no value")
        if self.primary == "counter":
            return self._counted(value)
        if not 0.0 <= value * MICRO <= HIGHEST_W:
            return Reading(epoch=self._epoch, problem=f"{self._sensor.title} says {value * MICRO:.3g} W")
        return Reading(power_w=value * MICRO, epoch=self._epoch, raw=(value,))

    def _counted(self, value_uj: int) -> Reading:
        if self._first_uj is None or self._last_uj is None or value_uj < self._last_uj:
            self._epoch += 0 if self._first_uj is None else 1
            self._first_uj = value_uj
        self._last_uj = value_uj
        return Reading(counter_j=(value_uj - self._first_uj) * MICRO, epoch=self._epoch, raw=(value_uj,))


def find_sensors(sysfs: Sysfs) -> list[Sensor]:
    """Every sensor that tells watts or joules; of powerN_input and powerN_average the first. Raises OSError."""
    found: dict[tuple[Path, str], Sensor] = {}
    for chip in sysfs.children(sysfs.root / "class" / "hwmon"):
        files = sorted(sysfs.children(chip), key=lambda file: (file.name.endswith("average"), file.name))
        for file in files:
            match = SENSOR.fullmatch(file.name)
            if match:
                name = f"{match[1]}{match[2]}"
                label = sysfs.value(chip / f"{name}_label") or ""
                found.setdefault((chip, name), Sensor(file, sysfs.value(chip / "name") or chip.name, name, label))
    return list(found.values())


def parse_hwmon(text: str, sysfs: Sysfs) -> Hwmon:
    """`hwmon`, `hwmon:CHIP[/SENSOR]`, either of the latter with `=WHAT IT COVERS`. Raises UsageError."""
    wanted, equals, covers = text.removeprefix(PREFIX).removeprefix(":").partition("=")
    if (equals and not (wanted and covers.strip())) or (text != PREFIX and not wanted):
        raise UsageError(f"{text!r} must be like 'hwmon:ina226/power1=whole machine'.")
    return Hwmon(sysfs, wanted, covers.strip())


def _titles(sensors: list[Sensor]) -> str:
    return ", ".join(sensor.title for sensor in sensors)
