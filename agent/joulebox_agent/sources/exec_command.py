"""A command of the user's that prints watts or joules: a smart plug, a USB meter, a bench supply.

It prints one JSON object and ends: {"power_w": 12.3} or {"energy_j": 456.7} (used since some moment, growing), or
both, and if it likes {"scope": "whole machine"}. It is called for every reading.
"""

import errno
import json
import math
import os
import shlex
from collections.abc import Callable

from joulebox_agent.errors import UsageError
from joulebox_agent.sources.command import Ask, run_command
from joulebox_agent.sources.packs import HIGHEST_W
from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport
from joulebox_agent.sources.sysfs import sentence

PREFIX = "exec:"
SHOWN = 60
Told = dict[str, float | str]


class ExecCommand:
    """Energy as an outside instrument tells it.

    ask  gives what the command printed; raises OSError
    """

    method = "exec"
    quality: Quality = "measured"
    poll_s = 1.0

    def __init__(self, command: str, ask: Ask | None = None) -> None:
        words = split_command(command)
        self._command, self._name = command, words[0]
        self._ask: Callable[[], bytes] = ask or (lambda: run_command(words))
        self.scope = "as the command states"
        self.primary: Primary = "power"
        self._first_j: float | None = None
        self._last_j: float | None = None
        self._epoch = 0

    def report(self) -> SourceReport:
        try:
            told = self._look()
        except OSError as error:
            return self._report(None, False, sentence(error), 'make the command print {"power_w": 12.3}')
        power_w = told.get("power_w")
        what = "watts" if power_w is not None else "joules"
        return self._report(power_w if isinstance(power_w, float) else None, True, f"the command tells {what}", "")

    def _report(self, power_w: float | None, available: bool, reason: str, remedy: str) -> SourceReport:
        return SourceReport(
            method=self.method,
            scope=self.scope,
            available=available,
            power_w=power_w,
            files=(self._command,),
            reason=reason,
            remedy=remedy,
        )

    def _look(self) -> Told:
        told = decode_output(self._ask(), self._name)
        self.primary = "power" if "power_w" in told else "counter"
        self.scope = str(told.get("scope", self.scope))
        return told

    def read(self) -> Reading:
        try:
            told = self._look()
        except OSError as error:
            return Reading(epoch=self._epoch, problem=sentence(error))
        power_w, energy_j = told.get("power_w"), told.get("energy_j")
        used_j = None
        if isinstance(energy_j, float):
            if self._first_j is None or (self._last_j is not None and energy_j < self._last_j):
                self._epoch += 0 if self._first_j is None else 1  # a counter that fell was reset
                self._first_j = energy_j
            self._last_j = energy_j
            used_j = energy_j - self._first_j
        raw = tuple(value for value in (power_w, energy_j) if isinstance(value, float))
        return Reading(
            power_w=power_w if isinstance(power_w, float) else None, counter_j=used_j, epoch=self._epoch, raw=raw
        )


def decode_output(data: bytes, name: str) -> Told:
    """The numbers of what a command printed. Raises OSError that says what is wrong with it."""

    def wrong(text: str) -> OSError:
        return OSError(errno.EBADMSG, text, name)

    text = data.decode(errors="replace").strip()
    try:
        told = json.loads(text, parse_int=float)  # of any length
    except (ValueError, RecursionError):
        raise wrong(f"printed {text[:SHOWN]!a}, not JSON" if text else "printed nothing") from None
    if not isinstance(told, dict) or not {"power_w", "energy_j"} & set(told):
        raise wrong(f"printed {text[:SHOWN]!a}, not an object with power_w or energy_j")
    found: Told = {}
    for key, highest in (("power_w", HIGHEST_W * 10), ("energy_j", 1e15)):
        if told.get(key) is None:
            continue
        value = told[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise wrong(f"says {key} is {ascii(value)[:SHOWN]}, which is no number")
        if not 0.0 <= value <= highest:
            raise wrong(f"says {key} is {value:g}; from 0 to {highest:g} is right")
        found[key] = float(value)
    if not found:
        raise wrong("says null for power_w and energy_j: it has no reading")
    scope = told.get("scope")
    return found | {"scope": scope[:SHOWN]} if isinstance(scope, str) and scope else found


def split_command(command: str) -> list[str]:
    """Words of a command line, as a shell would split them; no shell runs it. Raises UsageError."""
    try:
        words = shlex.split(command, posix=os.name != "nt")
    except ValueError as error:
        raise UsageError(f"The command in exec:{command} cannot be read: {error}.") from None
    if not words:
        raise UsageError("exec needs a command that prints JSON, as in exec:'read-meter --json'.")
    return words
