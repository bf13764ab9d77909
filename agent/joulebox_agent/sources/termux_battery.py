"""Android: what Termux' command `termux-battery-status` prints, for phones whose sysfs is closed to apps.

Source: BatteryStatusAPI of the app Termux:API. Current in uA (of either sign), voltage in mV, charge in uAh; any
of them may be missing.
"""

import errno
import json
import shutil
from typing import Any

from joulebox_agent.sources.command import Ask, run_command
from joulebox_agent.sources.packs import JOULES_PER_WH, Pack, Supplies, plausible

COMMAND = "termux-battery-status"
MILLI = 1000  # micro
FIELDS = {"current": ("current_now", 1), "current_average": ("current_avg", 1), "voltage": ("voltage_now", MILLI),
          "charge_counter": ("charge_now", 1)}  # fmt: skip


class TermuxBattery:
    """The battery as Android tells it to apps.

    ask  gives the JSON text; raises OSError
    """

    platform = "android"
    poll_s = 5.0  # the command starts an app's service for each look

    def __init__(self, ask: Ask | None = None) -> None:
        self._ask = ask or (lambda: run_command((COMMAND,)))

    def read(self) -> Supplies:
        return decode_battery_status(self._ask())

    def origins(self) -> tuple[str, ...]:
        return (COMMAND,)

    def counter_step_j(self) -> float | None:
        """One mAh at the present voltage, the finest that phones' gauges count in."""
        for pack in self.read().packs:
            if pack.charge_ah is not None and pack.voltage_v is not None:
                return 1e-3 * pack.voltage_v * JOULES_PER_WH
        return None

    def full_wh(self) -> float | None:
        return None  # Android tells apps the charge, not how much a full one is


def on_android() -> bool:
    """Whether Termux' command can be called here."""
    return shutil.which(COMMAND) is not None


def decode_battery_status(data: bytes) -> Supplies:
    """Pack and cable of the command's JSON. Raises OSError for anything else."""
    try:
        status = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise OSError(errno.EBADMSG, f"printed no JSON ({type(error).__name__})", COMMAND) from error
    if not isinstance(status, dict):
        raise OSError(errno.EBADMSG, f"printed {type(status).__name__}, not an object", COMMAND)
    plugged = status.get("plugged")
    if not isinstance(plugged, str) or not isinstance(status.get("status"), str):
        said = status.get("error") or status.get("API_ERROR") or "no plugged and status"
        raise OSError(errno.EBADMSG, f"says: {said}", COMMAND)
    cables = () if plugged == "UNPLUGGED" else (plugged,)
    if status.get("present") is False:
        return Supplies((), cables)
    return Supplies((_pack(status),), cables)


def _pack(status: dict[str, Any]) -> Pack:
    told: dict[str, int] = {}
    odd: dict[str, str] = {}
    for key, (name, unit) in FIELDS.items():
        value = status.get(key)
        if value is None:
            continue
        if not isinstance(value, int) or isinstance(value, bool):
            odd[name] = f"{COMMAND} says {key} {ascii(value)[:24]}, which is no whole number"
        elif why := plausible(name, value * unit):
            odd[name] = f"{COMMAND} says {key} {why}"
        else:
            told[name] = value * unit
    words = status["status"].replace("_", " ").capitalize()
    return Pack("battery", words, told, odd=odd)
