"""The agent's folder: who this device is, its lock, and the places of spool, scenes and scratch."""

import contextlib
import json
import os
import sys
import tempfile
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import platformdirs
from pydantic import BaseModel, ConfigDict, ValidationError

from joulebox_agent.errors import AgentError, UsageError

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
NO_LINK = getattr(os, "O_NOFOLLOW", 0)


class Enrolment(BaseModel):
    """What the server gave when this device enrolled; the token is a secret."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    server: str
    device_id: str
    token: str
    name: str


@dataclass(frozen=True)
class StateDir:
    """One folder holds everything, so that two agents on one machine (or a test) never meet."""

    root: Path

    @classmethod
    def at(cls, given: Path | None) -> "StateDir":
        """The given folder, else the user's state folder. Raises UsageError when it cannot be made."""
        root = given or Path(platformdirs.user_state_dir("joulebox-agent"))
        try:
            root.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"The state folder {root} cannot be made: {error.strerror}.") from error
        return cls(root)

    @property
    def spool(self) -> Path:
        return self.root / "spool"

    @property
    def scenes(self) -> Path:
        return self.root / "scenes"

    @property
    def scratch(self) -> Path:
        return self.root / "scratch"

    @property
    def doing(self) -> Path:
        """What a running agent does now, for `status`."""
        return self.root / "doing.json"

    @property
    def leases(self) -> Path:
        """Attempts that are ours and unfinished: what a killed agent gives back when it starts again."""
        return self.root / "leases.json"

    def leased(self) -> list[str]:
        """Ids of those attempts; none when the file is missing or damaged, as they then expire by themselves."""
        try:
            attempts = json.loads(self.leases.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return []
        return [str(attempt) for attempt in attempts] if isinstance(attempts, list) else []

    @property
    def _device_file(self) -> Path:
        return self.root / "device.json"

    def enrolment(self) -> Enrolment | None:
        """Who this device is, None before `enroll`. Raises AgentError when the file is damaged."""
        try:
            content = self._device_file.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except OSError as error:
            raise AgentError(f"{self._device_file} cannot be read: {error.strerror}.") from error
        try:
            return Enrolment.model_validate_json(content)
        except ValidationError as error:
            raise AgentError(f"{self._device_file} is damaged; enrol again with --again.") from error

    def save(self, enrolment: Enrolment) -> None:
        """Writes the enrolment so that only this user can read the token."""
        draft = self._device_file.with_suffix(".tmp")
        try:
            with open(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="utf-8") as file:
                os.chmod(draft, 0o600)  # an old draft keeps the mode it had
                json.dump(enrolment.model_dump(), file, indent=1)
                file.flush()
                os.fsync(file.fileno())
            os.replace(draft, self._device_file)
        except OSError as error:
            raise AgentError(f"The token cannot be kept in {self._device_file}: {error.strerror}.") from error

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Holds the folder for one `run`. Raises AgentError when another holds it; ends with the process."""
        with open(self.root / "lock", "a+", encoding="utf-8") as file:
            if not _try_lock(file.fileno()):
                raise AgentError(f"Another joulebox-agent runs on {self.root}; stop it or use another --state-dir.")
            yield

    def locked(self) -> bool:
        """Whether an agent runs on this folder now."""
        with open(self.root / "lock", "a+", encoding="utf-8") as file:
            return not _try_lock(file.fileno())


def machine_lock_file() -> Path:
    """One place for all users of the machine: two agents would measure each other's work."""
    if sys.platform == "win32":
        return Path(os.environ.get("PROGRAMDATA", "C:\\ProgramData"), "joulebox-agent.lock")
    shared = Path("/tmp")
    return (shared if shared.is_dir() else Path(tempfile.gettempdir())) / "joulebox-agent.lock"


@contextlib.contextmanager
def machine_lock(path: Path) -> Iterator[None]:
    """Holds the machine for one agent that measures. Raises AgentError when another does; ends with the process."""
    try:
        try:
            descriptor = os.open(path, os.O_RDONLY | NO_LINK)
        except FileNotFoundError:
            descriptor = os.open(path, os.O_RDONLY | os.O_CREAT | NO_LINK, 0o644)
    except OSError as error:
        raise AgentError(f"The lock of this machine {path} cannot be opened: {error.strerror}.") from error
    with os.fdopen(descriptor) as file:
        if not _try_lock(file.fileno()):
            raise AgentError(
                "Another joulebox-agent measures this machine, and two would measure each other; "
                "stop it, or let this one use --source none."
            )
        yield


if sys.platform == "win32":
    import msvcrt

    def _try_lock(descriptor: int) -> bool:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _try_lock(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True


def boot_id() -> str:
    """An id that changes with every boot; without /proc one that changes with every start of the agent."""
    try:
        return BOOT_ID.read_text().strip()
    except OSError:
        return str(uuid.uuid4())
