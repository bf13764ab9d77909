"""What `run` was asked for."""

from dataclasses import dataclass
from pathlib import Path

from joulebox_agent.measuring.charging import MEASURING_BAND, Band


@dataclass(frozen=True)
class RunOptions:
    """Choices of whoever started the agent.

    once         one lease at most, and an unreachable server is an error
    max_jobs     end after this many jobs; None: never
    idle_exit_s  end after this long without a job [s]; None: never
    wait_s       how long the server may hold a lease request [s]
    pause_s      first pause after trouble [s]; doubles up to `longest_pause_s`, jittered
    silence_s    longest silence of the renderer before it counts as hung [s]
    charge_band  measure within it; below it the device is not fit until it was charged
    charge_hook  command that switches a charger on and off
    """

    source: str = "auto"
    sysfs_root: Path = Path("/sys")
    once: bool = False
    max_jobs: int | None = None
    idle_exit_s: float | None = None
    wait_s: float = 5.0
    pause_s: float = 1.0
    longest_pause_s: float = 60.0
    silence_s: float = 600.0
    charge_band: Band = MEASURING_BAND
    charge_hook: str | None = None
