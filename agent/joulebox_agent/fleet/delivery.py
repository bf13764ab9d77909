"""From the spool to the server: blobs first, then the result that names them, then the entry is forgotten."""

from dataclasses import dataclass, field

from joulebox_agent.errors import ServerRefusedError, SpoolFullError
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.spool import BadEntryError, Entry, Spool


@dataclass
class Delivery:
    """Keeps every result until the server has it: on disk, or in memory while the disk is full."""

    spool: Spool
    server: Server
    journal: Journal
    in_memory: list[tuple[Entry, dict[str, bytes]]] = field(default_factory=list)

    def keep(self, entry: Entry, blobs: dict[str, bytes]) -> None:
        """Takes a result. A full disk is said once and the result held in memory."""
        try:
            self.spool.put(entry, blobs)
        except SpoolFullError as error:
            self.journal.say("disk", str(error), "warning")
            self.in_memory.append((entry, blobs))

    def send_all(self) -> None:
        """Sends what waits. Raises ServerUnreachableError, TokenRejectedError; the unsent is kept."""
        self._send_from_memory()
        for path in self.spool.waiting():
            try:
                entry, blobs = self.spool.read(path)
                self._send(entry, blobs)
            except (BadEntryError, ServerRefusedError) as error:
                self.spool.set_aside(path, str(error))
                self.journal.say("set aside", f"Set aside in {self.spool.bad}: {path.name}: {error}", "warning",
                                 attempt_id=path.stem)  # fmt: skip
            else:
                self.spool.done(path)

    def _send_from_memory(self) -> None:
        """Room may be back, else straight to the server: a result must not hang on this process for long."""
        for item in list(self.in_memory):
            try:
                self.spool.put(*item)
            except SpoolFullError:
                try:
                    self._send(*item)
                except ServerRefusedError as error:  # it stays in memory until there is room to set it aside
                    attempt_id = item[0].attempt_id
                    self.journal.say("refused", f"The result of attempt {attempt_id} is refused: {error}", "warning",
                                     attempt_id=attempt_id)  # fmt: skip
                    continue
            self.in_memory.remove(item)

    def _send(self, entry: Entry, blobs: dict[str, bytes]) -> None:
        for sha256, content in blobs.items():
            self.server.put_blob(sha256, content)
        try:
            accepted = self.server.put_result(entry.attempt_id, entry.document)
        except ServerRefusedError as error:
            if error.status != 422 or "blob" not in f"{error.code} {error}":
                raise
            # the server dropped a blob between our question and the result: send them whatever it says
            for sha256, content in blobs.items():
                self.server.put_blob(sha256, content, even_if_there=True)
            accepted = self.server.put_result(entry.attempt_id, entry.document)
        words = f"Result of attempt {entry.attempt_id} delivered ({accepted})."
        self.journal.say("delivered", words, attempt_id=entry.attempt_id)
