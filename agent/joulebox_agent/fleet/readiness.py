"""Whether this device is fit to measure now: its spool, its charge, its source."""

import time

from joulebox_agent.errors import AgentError
from joulebox_agent.fleet.delivery import Delivery
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.options import RunOptions
from joulebox_agent.measuring.charging import Charging
from joulebox_agent.sources.choose import unfit_reason


class Readiness:
    """Asked before every lease; `charging` keeps a battery in its band where a battery is the source, else None."""

    def __init__(self, options: RunOptions, delivery: Delivery, journal: Journal) -> None:
        self._options, self._delivery, self._journal = options, delivery, journal
        self.charging = _charging(options)
        self._job_share = 0.0  # of the battery, what the dearest job so far took

    def why_not(self) -> str | None:
        """What keeps the device from measuring, as the end of a sentence; None: nothing."""
        spool = self._delivery.spool
        if self._delivery.in_memory:
            return "a result waits in memory because the spool's disk is full"
        if not spool.room():
            return f"less than 64 MiB are free on the disk of {spool.folder}"
        if self.charging is not None:
            try:
                reason = self.charging.step(time.monotonic(), self._say, self._job_share)
            except AgentError as error:  # the hook: a person may have to help
                reason = str(error).rstrip(".")
            if reason:
                return reason
        return unfit_reason(self._options.source, self._options.sysfs_root)

    def share(self) -> float | None:
        """Charge of the battery as a share of full; None without one, or where another source is used."""
        return None if self.charging is None else self.charging.share()

    def took(self, before: float | None) -> None:
        """A job is done that began at this share: the dearest so far decides when to charge."""
        after = self.share()
        if before is not None and after is not None:
            self._job_share = max(self._job_share, before - after)

    def close(self) -> None:
        """Nobody asks any more."""
        if self.charging is not None:
            self.charging.let_go(self._say)

    def _say(self, text: str) -> None:
        self._journal.say("charging", text)


def _charging(options: RunOptions) -> Charging | None:
    if options.source != "auto" and not options.source.startswith("battery"):
        return None
    charging = Charging(options.charge_band, options.sysfs_root, options.source, options.charge_hook, waits=False)
    return charging if charging.share() is not None else None
