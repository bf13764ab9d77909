"""The honest absence of a source: time and CPU seconds are measured, energy stays unknown."""

from joulebox_agent.sources.reading import Primary, Quality, Reading, SourceReport


class NoSource:
    """Reads nothing and says so."""

    method = "none"
    scope = "none"
    quality: Quality = "none"
    primary: Primary = "power"
    poll_s = 1.0

    def report(self) -> SourceReport:
        return SourceReport(
            method="none", scope="none", available=True, reason="time and CPU seconds only; energy stays null"
        )

    def read(self) -> Reading:
        return Reading()
