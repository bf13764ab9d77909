"""A battery as a budget: the band in which is measured, the charges that a plan needs, and how one is had."""

import math
import shlex
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.conditions import read_conditions
from joulebox_agent.errors import ChargingError, UsageError
from joulebox_agent.measuring.meter import Meter
from joulebox_agent.process import program_words
from joulebox_agent.sources.choose import unfit_reason
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.sysfs import Sysfs

LOOK_EVERY_S = 10.0
STUCK_AFTER_S = 900.0  # without the charge rising: a threshold of the firmware's own, a weak charger
HOOK_WITHIN_S = 60.0
WORTH_A_START = 0.05  # of full above the lower end, for a charge that stopped early to be used at all


@dataclass(frozen=True)
class Band:
    """Charge between which is measured, as shares of full: charged up to `high`, stopped at `low`."""

    high: float = 0.9
    low: float = 0.3

    @classmethod
    def parse(cls, text: str) -> "Band":
        """`90-30`, in percent. Raises UsageError."""
        first, _, second = text.partition("-")
        try:
            high, low = float(first) / 100, float(second) / 100
        except ValueError:
            high = low = -1.0
        if not 0 <= low < high <= 1:
            raise UsageError(f"The charge band {text!r} must be two percentages, the higher first, as in 90-30.")
        return cls(high, low)

    def words(self) -> str:
        """As it is written on the command line."""
        return f"{100 * self.high:g}-{100 * self.low:g}"


MEASURING_BAND = Band()


def hook_words(hook: str) -> list[str]:
    """The words of a charge hook. Raises UsageError, before hours of measuring rather than at the first charge."""
    return program_words(hook, "charge hook", "--charge-hook")


@dataclass(frozen=True)
class Forecast:
    """What a plan takes from the battery.

    charges  how often it will have to be charged on the way; None where capacity, charge or power are unknown
    """

    time_s: float
    energy_j: float | None
    charges: int | None

    def words(self) -> str:
        if self.energy_j is None or self.charges is None:
            return f"planned: about {self.time_s / 60:.0f} minutes; the charges needed cannot be told here"
        need = "no charge" if not self.charges else f"{self.charges} charge{'s' if self.charges > 1 else ''}"
        return f"planned: about {self.time_s / 60:.0f} minutes, {self.energy_j / 3600:.1f} Wh, {need} on the way"


class Charging:
    """Keeps the battery within its band between windows: measures, charges, waits for the cable to go, measures.

    hook   a command that is called with `on` to charge and `off` to stop (a smart plug's); None: a person does it
    waits  whether a session waits for its charges; False: it ends at the lower end with what it has, as one does whose
           job is only lent to it for a while
    """

    def __init__(
        self,
        band: Band,
        sysfs_root: Path,
        source: str = "battery_gauge",
        hook: str | None = None,
        waits: bool = True,
    ) -> None:
        self.band, self.waits, self._root, self._source = band, waits, sysfs_root, source
        self._hook = None if hook is None else hook_words(hook)
        self._supplies = PowerSupplyClass(Sysfs(sysfs_root))
        # a plug that is on when we start was left so by a process that was killed while charging
        self._charging = self._hook is not None and self.plugged()
        self._unplugging = False
        self._highest, self._since_s = 0.0, math.inf

    def share(self) -> float | None:
        """Charge as a share of full, None where it cannot be read."""
        share = read_conditions(self._root).get("battery_charge_share")
        return float(share) if isinstance(share, int | float) else None

    def must_charge(self, reserve: float = 0.0) -> bool:
        """Whether the charge, less a reserve (a share of full), is at the band's lower end."""
        share = self.share()
        return self._charging or (share is not None and share - reserve <= self.band.low)

    def used_up(self) -> str:
        """That the band's lower end is reached, as the beginning of a reason."""
        return f"the charge is {self.share() or 0.0:.0%}, the lower end of its band {self.band.words()} %,"

    def from_full(self, share: object) -> bool:
        """Whether whoever began at this charge had all of the band to use."""
        return isinstance(share, float) and share >= self.band.high - WORTH_A_START

    def plugged(self) -> bool:
        """Whether a cable is online now, or the battery charges."""
        return unfit_reason(self._source, self._root) is not None

    def forecast(self, time_s: float, power_w: float | None) -> Forecast:
        """Energy and charges that measuring for `time_s` at `power_w` takes, from the charge there is now."""
        conditions = read_conditions(self._root)
        full_j, share = conditions.get("battery_full_j"), self.share()
        if power_w is None or share is None or not isinstance(full_j, int | float):
            return Forecast(time_s, None, None)
        energy_j = time_s * power_w
        first_j = max(0.0, share - self.band.low) * full_j
        charge_j = (self.band.high - self.band.low) * full_j
        further_j = max(0.0, energy_j - first_j)
        return Forecast(time_s, energy_j, math.ceil(further_j / charge_j))

    def charge(self, meter: Meter) -> None:
        """Waits for a charge up to the band's upper end, then for a discharge. Raises StoppedError, ChargingError."""
        said = ""
        try:
            while (reason := self.step(meter.clock.now_s(), meter.listener.note)) is not None:
                meter.check_stop()
                if not self._charging and reason != said:
                    said = reason
                    meter.listener.note(f"waiting for a discharge: {reason}")
                meter.pause(LOOK_EVERY_S)
        finally:
            self.let_go(meter.listener.note)
        meter.listener.note(f"discharging from {self.share() or 0.0:.0%}")

    def wait_for_discharge(self, meter: Meter) -> None:
        """Waits until the machine runs from its battery. Raises StoppedError, ChargingError."""
        self._unplugging = True
        self.charge(meter)

    def let_go(self, say: Callable[[str], None]) -> None:
        """Nobody watches the charge from now on: a machine on its cable must not go on draining its battery."""
        if self._unplugging:
            self._set_behaviour("auto", say)

    def step(self, now_s: float, say: Callable[[str], None], reserve: float = 0.0) -> str | None:
        """Does what is due now and returns why measuring has to wait, or None. Raises ChargingError (the hook)."""
        share = self.share()
        if self._charging or (share is not None and share - reserve <= self.band.low):
            if not self._charging or self._since_s == math.inf:
                self._begin(share or 0.0, now_s, say)
            if not self._charged(share or 0.0, now_s, say):
                return f"the charge is {share or 0.0:.0%} and goes up to {self.band.high:.0%}"
            self._end(say)
        if self._unplugging:
            reason = unfit_reason(self._source, self._root)
            if reason is not None:
                return reason + ("" if self._hook else "; pull the power cable out")
            self._unplugging = False
            self._set_behaviour("auto", say)
        return None

    def _begin(self, share: float, now_s: float, say: Callable[[str], None]) -> None:
        self._charging, self._highest, self._since_s = True, share, now_s
        say(f"the charge is {share:.0%}: charging to {self.band.high:.0%}")
        self._set_behaviour("auto", say)
        if self._hook:
            self._call("on")
        elif not self.plugged():
            say("plug the power cable in")

    def _charged(self, share: float, now_s: float, say: Callable[[str], None]) -> bool:
        """Full enough, or as full as the firmware lets it become."""
        if share > self._highest:
            self._highest, self._since_s = share, now_s
        if share >= self.band.high:
            return True
        stuck = now_s - self._since_s > STUCK_AFTER_S and share > self.band.low + WORTH_A_START and self.plugged()
        if stuck:
            say(f"charging stopped at {share:.0%}: a threshold of the firmware's own?")
        return stuck

    def _end(self, say: Callable[[str], None]) -> None:
        self._charging, self._unplugging, self._since_s = False, True, math.inf
        if self._hook:
            self._call("off")
        self._set_behaviour("force-discharge", say)

    def _call(self, word: str) -> None:
        assert self._hook is not None
        command = [*self._hook, word]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=HOOK_WITHIN_S, check=False, stdin=subprocess.DEVNULL
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ChargingError(f"The charge hook {shlex.join(command)} failed: {error}.") from error
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise ChargingError(f"The charge hook {shlex.join(command)} left with code {done.returncode}: {said}")

    def _set_behaviour(self, wanted: str, say: Callable[[str], None]) -> None:
        """Writes `charge_behaviour` of every pack whose kernel offers `wanted` and has another one selected."""
        for pack in self._supplies.pack_folders():
            file = pack / "charge_behaviour"
            try:
                offered = file.read_text().split()
            except OSError:
                continue
            if wanted not in offered:  # not offered, or selected already: that one stands in brackets
                continue
            try:
                file.write_text(wanted)
            except OSError as error:
                say(f"{file} cannot be set to {wanted} ({error.strerror}): sudo chmod a+w {file}")
