"""macOS: the property list that `ioreg -rn AppleSmartBattery -a` prints.

Currents are milliamperes in two's complement of 64 bits, so that a discharge shows as 1.8e19.
"""

import errno
import plistlib
from typing import Any

from joulebox_agent.sources.command import Ask, run_command
from joulebox_agent.sources.packs import JOULES_PER_WH, Pack, Supplies, plausible

COMMAND = ("/usr/sbin/ioreg", "-rn", "AppleSmartBattery", "-a")
MILLI = 1000  # micro
PERCENT = 100


class MacBattery:
    """The battery as IOKit's registry tells it; the gauge behind it refreshes about once a minute.

    ask  gives the property list; raises OSError
    """

    platform = "macos"
    poll_s = 5.0  # a process is started for each look

    def __init__(self, ask: Ask | None = None) -> None:
        self._ask = ask or (lambda: run_command(COMMAND))

    def read(self) -> Supplies:
        return decode_smart_battery(self._ask())

    def origins(self) -> tuple[str, ...]:
        return (" ".join(COMMAND),)

    def counter_step_j(self) -> float | None:
        """One mAh at the present voltage."""
        for pack in self.read().packs:
            if pack.charge_ah is not None and pack.voltage_v is not None:
                return 1e-3 * pack.voltage_v * JOULES_PER_WH
        return None

    def full_wh(self) -> float | None:
        nodes = [node for node in _nodes(self._ask()) if node.get("BatteryInstalled")]
        full_mah = _charge_mah(nodes[0], "AppleRawMaxCapacity", "MaxCapacity") if len(nodes) == 1 else None
        voltage_mv = signed(nodes[0], "Voltage") if nodes else None
        return full_mah * voltage_mv * 1e-6 if full_mah and voltage_mv else None


def decode_smart_battery(data: bytes) -> Supplies:
    """Packs and cable of ioreg's property list; no packs when it is empty. Raises OSError for anything else."""
    nodes = _nodes(data)
    installed = [node for node in nodes if node.get("BatteryInstalled")]
    online = any(node.get("ExternalConnected") for node in nodes)
    packs = tuple(_pack(f"AppleSmartBattery{number or ''}", node) for number, node in enumerate(installed))
    return Supplies(packs, ("AC",) if online else ())


def _nodes(data: bytes) -> list[dict[str, Any]]:
    try:
        nodes = plistlib.loads(data) if data.strip() else []
    except Exception as error:  # plistlib lets its parser's errors through: expat's, struct's, IndexError, ...
        raise OSError(errno.EBADMSG, f"printed no property list ({type(error).__name__})", COMMAND[0]) from error
    if not isinstance(nodes, list) or not all(isinstance(node, dict) for node in nodes):
        raise OSError(errno.EBADMSG, "printed a property list that is no list of nodes", COMMAND[0])
    return nodes


def _charge_mah(node: dict[str, Any], raw: str, other: str) -> int | None:
    """Apple's own chips give CurrentCapacity as a share of MaxCapacity = 100, and the charge under another name."""
    if (charge_mah := signed(node, raw)) is not None:
        return charge_mah
    return signed(node, other) if (signed(node, "MaxCapacity") or 0) > PERCENT else None


def _pack(name: str, node: dict[str, Any]) -> Pack:
    current_ma = signed(node, "InstantAmperage")
    if current_ma is None:
        current_ma = signed(node, "Amperage")
    values = {
        "current_now": current_ma,
        "voltage_now": signed(node, "Voltage"),
        "charge_now": _charge_mah(node, "AppleRawCurrentCapacity", "CurrentCapacity"),
    }
    micro = {key: value * MILLI for key, value in values.items() if value is not None}
    odd = {key: f"{name} says {why}" for key, value in micro.items() if (why := plausible(key, value))}
    told = {key: value for key, value in micro.items() if key not in odd}
    updated = signed(node, "UpdateTime")
    if updated is not None:  # tells a refresh apart from a held value even where the current is the same
        told["update_time"] = updated
    return Pack(name, _status(node), told, odd=odd)


def _status(node: dict[str, Any]) -> str:
    if node.get("ExternalConnected"):
        return "Charging" if node.get("IsCharging") else "Full" if node.get("FullyCharged") else "Not charging"
    return "Charging" if node.get("IsCharging") else "Discharging"


def signed(node: dict[str, Any], key: str) -> int | None:
    """An integer of the registry as the signed 64 bits that it stands for; None when it is none."""
    value = node.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or not -(2**63) <= value < 2**64:
        return None
    return value - 2**64 if value >= 2**63 else value
