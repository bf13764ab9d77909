"""The attempts that are this agent's: written down, so that one that is killed can give them back."""

import json
from collections.abc import Collection

from joulebox_agent.errors import ServerRefusedError
from joulebox_agent.files import write_whole
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.server import Lease, Server
from joulebox_agent.fleet.state import StateDir


class Attempts:
    """What is leased and not finished, and what is to be given back.

    An attempt's id is the fence: one that was handed to somebody else meanwhile is not ours to hurt. What an earlier
    process held goes back at once and spends no attempt, unless its result is among `spooled`.
    """

    def __init__(self, state: StateDir, server: Server, journal: Journal, spooled: Collection[str]) -> None:
        self._file, self._server, self._journal = state.leases, server, journal
        left_over = [attempt_id for attempt_id in state.leased() if attempt_id not in spooled]
        self._held = set(left_over)
        self._releases = [(attempt, "the agent was killed while it had this job", False) for attempt in left_over]

    def take(self, leases: Collection[Lease]) -> None:
        """These are ours now."""
        self._write(self._held | {lease.attempt_id for lease in leases})

    def finish(self, lease: Lease) -> None:
        """Its result is safe."""
        self._write(self._held - {lease.attempt_id})

    def give_back(self, lease: Lease, reason: str, failed: bool) -> None:
        """Back to the server at the next `settle`; `failed` spends one of the job's attempts."""
        self._journal.say("given back", f"Job {lease.job_id} given back: {reason}", "warning" if failed else "info",
                          job_id=lease.job_id, attempt_id=lease.attempt_id)  # fmt: skip
        self._releases.append((lease.attempt_id, reason, failed))

    def settle(self) -> None:
        """Give back what cannot be done. Raises ServerUnreachableError, TokenRejectedError; the rest is kept."""
        for release in list(self._releases):
            try:
                self._server.release(*release)
            except ServerRefusedError as error:  # deleted with its sweep, or answered meanwhile
                self._journal.say("refused", f"Attempt {release[0]} cannot be given back: {error}", "warning",
                                  attempt_id=release[0])  # fmt: skip
            self._releases.remove(release)
            self._write(self._held - {release[0]})

    def _write(self, held: set[str]) -> None:
        self._held = held
        try:
            write_whole(self._file, json.dumps(sorted(held)).encode())
        except OSError as error:
            self._journal.lasts("disk", f"{self._file} cannot be written: {error.strerror}.", "warning")
