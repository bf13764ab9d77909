"""Windows: `CallNtPowerInformation(SystemBatteryState)`, the batteries of the machine as one.

Source: SYSTEM_BATTERY_STATE of winnt.h, 32 bytes: four flags, three spare bytes and a tag, then six ULONG.
"""

import ctypes
import errno
import struct

from joulebox_agent.sources.command import Ask
from joulebox_agent.sources.packs import JOULES_PER_WH, Pack, Supplies, plausible

STATE = struct.Struct("<4?3xB2IiI2I")  # Rate is declared ULONG and holds a signed number of mW
SYSTEM_BATTERY_STATE = 5  # of POWER_INFORMATION_LEVEL
UNKNOWN_RATE, UNKNOWN_CAPACITY = -0x80000000, 0xFFFFFFFF
RELATIVE_UNITS = 100  # mWh: a battery that calls so much its capacity counts in shares of it
MILLI = 1000  # micro
CALL = "CallNtPowerInformation(SystemBatteryState)"


class WindowsBattery:
    """The battery as Windows tells it.

    ask  gives the 32 bytes of SYSTEM_BATTERY_STATE; raises OSError
    """

    platform = "windows"
    poll_s = 0.5

    def __init__(self, ask: Ask | None = None) -> None:
        self._ask = ask or call_windows

    def read(self) -> Supplies:
        return decode_battery_state(self._ask())

    def origins(self) -> tuple[str, ...]:
        return (CALL,)

    def counter_step_j(self) -> float | None:
        """Windows counts whole mWh; many batteries move in steps of 10."""
        packs = self.read().packs
        return 1e-3 * JOULES_PER_WH if any("energy_now" in pack.micro for pack in packs) else None

    def full_wh(self) -> float | None:
        full_mwh = STATE.unpack(self._ask())[5]
        return full_mwh * 1e-3 if RELATIVE_UNITS < full_mwh < UNKNOWN_CAPACITY else None


def call_windows() -> bytes:
    """The struct from the system. Raises OSError where the call fails, or the system is another one."""
    libraries = getattr(ctypes, "windll", None)
    if libraries is None:
        raise OSError(errno.ENOSYS, "not this platform", CALL)
    buffer = ctypes.create_string_buffer(STATE.size)
    status = libraries.powrprof.CallNtPowerInformation(SYSTEM_BATTERY_STATE, None, 0, buffer, STATE.size)
    if status:
        raise OSError(errno.EIO, f"failed with NTSTATUS {status & 0xFFFFFFFF:#010x}", CALL)
    return buffer.raw


def decode_battery_state(data: bytes) -> Supplies:
    """Packs and cable of a SYSTEM_BATTERY_STATE. Raises OSError for another length."""
    if len(data) != STATE.size:
        raise OSError(errno.EBADMSG, f"gave {len(data)} bytes, not {STATE.size}", CALL)
    on_line, present, charging, discharging, _, full_mwh, left_mwh, rate_mw, *_ = STATE.unpack(data)
    cables = ("AC",) if on_line else ()
    if not present:
        return Supplies((), cables)
    status = "Charging" if charging else "Discharging" if discharging else "Not charging"
    if full_mwh <= RELATIVE_UNITS:
        odd = {"power_now": f"{CALL} counts in shares of a capacity that it does not tell"}
        return Supplies((Pack("battery", status, odd=odd),), cables)
    micro = {"power_now": rate_mw * MILLI} if rate_mw != UNKNOWN_RATE else {}
    if left_mwh != UNKNOWN_CAPACITY:
        micro["energy_now"] = left_mwh * MILLI
    odd = {name: f"{CALL} says {why}" for name, value in micro.items() if (why := plausible(name, value))}
    told = {name: value for name, value in micro.items() if name not in odd}
    return Supplies((Pack("battery", status, told, odd=odd),), cables)
