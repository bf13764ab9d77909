"""A server and agents of a study's own on loopback, with everything they keep in the study's folder.

They end with the study. What a killed study left running is found by the ids that it wrote down, and ended first.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from joulebox_server.cli.connection import ADDRESS_FILE, CommandError, Connection, WrongUseError, connect

START_S = 60.0
"""How long a server may take to start."""
GRACE_S = 15.0
"""How long a program may take to end when asked to: an agent gives its job back first."""
LEAST_FREE_BYTES = 128 * 2**20
"""On the folder's disk: with half of it agents take no job, and a study would wait for them for ever."""
AGENT = "joulebox-agent"
SERVE = "from joulebox_server.cli import main; main()"


def agent_program() -> str:
    """The agent's command, beside this Python or on PATH. Raises CommandError."""
    found = shutil.which(AGENT, path=str(Path(sys.executable).parent)) or shutil.which(AGENT)
    if found is None:
        raise CommandError(f"{AGENT} is neither beside {sys.executable} nor on PATH; install it, or give --server")
    return found


def can_meter(source: str) -> bool:
    """Whether this machine can measure with a source now; with `auto`, whether with any.

    Raises WrongUseError for a source that was asked for and is none, or cannot be read.
    """
    if source == "none":
        return False
    command = [agent_program(), "doctor", "--json", "--source", source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 2:
        raise WrongUseError(f"--source {source}: {_last_line(done.stderr).removeprefix(f'{AGENT}: ')}")
    try:
        chosen = json.loads(done.stdout)["chosen"]
    except (ValueError, KeyError) as error:
        raise CommandError(f"`{AGENT} doctor` gave no answer: {_last_line(done.stderr)}") from error
    if chosen is None and source != "auto":
        raise WrongUseError(f"--source {source}: it cannot be read here; `{AGENT} doctor --source ...` says why")
    return chosen not in (None, "none")


class Local:
    """A server with agents. Use as a context manager: nothing outlives the block."""

    def __init__(self, folder: Path, agents: int, source: str) -> None:
        self._folder, self._agents, self._source = folder, agents, source
        self._pids, self._port = folder / "processes.json", folder / "port.txt"
        self._running: list[tuple[str, Path, subprocess.Popen[bytes]]] = []
        self.connection = Connection("", None)

    def __enter__(self) -> "Local":
        try:
            self.check()
            self._end_what_was_left()
            port = self._port.read_text(encoding="ascii") if self._port.is_file() else "0"
            self._start("server", sys.executable, "-c", SERVE, "serve", "--port", port, "--data", str(self.data))
            self.connection = self._connected()
            # Kept for the next start: the agents know their server by its address.
            self._port.write_text(self.connection.url.rpartition(":")[2], encoding="ascii")
            for number in range(1, self._agents + 1):
                self._start_agent(f"agent-{number}")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Ends the agents before their server; a second Ctrl-C must leave nothing running either."""
        held = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            for _, _, process in reversed(self._running):
                _end(process)
            self._pids.unlink(missing_ok=True)
        finally:
            signal.signal(signal.SIGINT, held)

    @property
    def data(self) -> Path:
        """The server's folder."""
        return self._folder / "server"

    def check(self) -> None:
        """Raise CommandError if one of them has ended, or the disk is nearly full."""
        free = shutil.disk_usage(self._folder).free
        if free < LEAST_FREE_BYTES:
            raise CommandError(
                f"{free / 2**20:.0f} MiB are free on the disk of {self._folder}, a study needs "
                f"{LEAST_FREE_BYTES >> 20} or more; make room, and run the same command again to go on"
            )
        for name, log, process in self._running:
            if process.poll() is not None:
                text = log.read_text(encoding="utf-8", errors="replace")
                raise CommandError(
                    f"the {name} ended with exit code {process.returncode}; the last line of its log {log} is: "
                    f"{_last_line(text)}; run the same command again to go on"
                )

    def _start(self, name: str, *command: str) -> None:
        log = self._folder / f"{name}.log"
        # A group of its own: Ctrl-C then reaches the study alone, which ends the others in order.
        group: int = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
        with log.open("ab") as output:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                start_new_session=True, creationflags=group,
            )  # fmt: skip
        self._running.append((name, log, process))
        self._pids.write_text(json.dumps([process.pid for _, _, process in self._running]), encoding="ascii")

    def _start_agent(self, name: str) -> None:
        state = self._folder / name
        if not (state / "device.json").is_file():
            code = self.connection.json("POST", "/enrollments", json={})["code"]
            command = [agent_program(), "enroll", "--server", self.connection.url, "--code", code,
                       "--name", name, "--again", "--state-dir", str(state)]  # fmt: skip
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise CommandError(f"the {name} could not enrol: {_last_line(done.stderr)}")
        self._start(name, agent_program(), "run", "--source", self._source, "--state-dir", str(state))

    def _connected(self) -> Connection:
        deadline_s = time.monotonic() + START_S
        while time.monotonic() < deadline_s:
            self.check()
            if (self.data / ADDRESS_FILE).is_file():
                found = connect(None, None, self.data)
                with contextlib.suppress(CommandError):
                    found.request("GET", "/sweeps", params={"limit": 1})
                    return found
            time.sleep(0.1)
        raise CommandError(f"the server did not start within {START_S:.0f} s; its log is in {self._folder}")

    def _end_what_was_left(self) -> None:
        """Ends what a killed study left: only if its server still answers are the ids surely those of its own."""
        with contextlib.suppress(OSError, ValueError):
            pids = [int(pid) for pid in json.loads(self._pids.read_text(encoding="ascii"))]
            left = connect(None, None, self.data)
            with contextlib.suppress(CommandError):
                left.request("GET", "/sweeps", params={"limit": 1})
                for pid in reversed(pids):
                    with contextlib.suppress(ProcessLookupError, PermissionError):
                        os.kill(pid, signal.SIGTERM)
                self._wait_for_silence(left)
        (self.data / ADDRESS_FILE).unlink(missing_ok=True)

    def _wait_for_silence(self, left: Connection) -> None:
        deadline_s = time.monotonic() + GRACE_S
        while time.monotonic() < deadline_s:
            left.request("GET", "/sweeps", params={"limit": 1})  # raises once it is gone
            time.sleep(0.2)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Ask it to end, and see to it that it and what it started did."""
    if process.poll() is None:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(GRACE_S)
    if sys.platform != "win32":
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def _last_line(text: str) -> str:
    """Of what is no secret: a server that has just been made shows its token in its log."""
    lines = [line for line in text.strip().splitlines() if "token" not in line]
    return lines[-1] if lines else "nothing"
