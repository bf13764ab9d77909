"""`make demo`: what a user would type, from an empty server to recommended settings.

Prints every command that it runs. The server and the agent run in the background, write their logs below
.demo/ and end with the demo: the dashboard stays up until Ctrl-C, or not at all with --once. Any other
argument is refused. Exit code 0, or 1 with one sentence.
"""

import argparse
import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SWEEP = "docs/demo-sweep.toml"
SCENES = ("cornell-boxes", "cornell-spheres")
SHARE = 0.75
"""The budget that the demo asks about, as a share of what the reference costs."""
REPLAY = "replay@0.1"
"""The scripted trace, played as a gauge that refreshes every 0.1 s, so that short windows resolve it."""
PROGRAMS = Path(sys.executable).parent
START_S = 60.0
"""How long the server may take to start."""
GRACE_S = 10.0
"""How long a program in the background may take to end when asked to."""


class DemoError(Exception):
    """The demo cannot go on; the message is the sentence that the user sees."""


# --- running commands --------------------------------------------------------------------------------------


def located(command: tuple[str, ...]) -> list[str]:
    """The command with the full path of its program."""
    return [str(PROGRAMS / command[0]), *command[1:]]


def show(command: tuple[str, ...], background: bool = False) -> None:
    """Print a command as it would be typed at the top of the checkout."""
    program = os.path.relpath(PROGRAMS / command[0], ROOT)
    print(f"\n$ {shlex.join([program, *command[1:]])}{' &' if background else ''}", flush=True)


class Background:
    """A command that runs beside the demo, with its output in a log."""

    def __init__(self, command: tuple[str, ...], log: Path) -> None:
        show(command, background=True)
        self.name = " ".join(command[:2])
        self.log = log
        # A group of its own: Ctrl-C then reaches the demo alone, which ends the others in order.
        group: int = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)  # Windows; elsewhere a session does it
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                located(command), cwd=ROOT, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                start_new_session=True, creationflags=group,
            )  # fmt: skip

    def check(self) -> None:
        """Raise DemoError if the command has ended."""
        if self.process.poll() is None:
            return
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        last = lines[-1] if lines else "nothing"
        raise DemoError(
            f"`{self.name}` ended with exit code {self.process.returncode}; the last line of its log "
            f"{self.log.relative_to(ROOT)} is: {last}"
        )

    def end(self) -> None:
        """Ask it to end, and see to it that it and what it started did."""
        if self.process.poll() is None:
            self.process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(GRACE_S)
        if sys.platform != "win32":
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.wait()


class Demo:
    """The commands of one run, and what runs in the background."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.running: list[Background] = []

    def start(self, *command: str) -> None:
        """Run a command in the background, with its log in the folder."""
        self.running.append(Background(command, self.folder / f"{command[0]}.log"))

    def run(self, *command: str) -> None:
        """Run a command to its end, for the user to see."""
        self._finish(command, None)

    def ask(self, *command: str) -> Any:
        """The JSON document that a command prints."""
        return json.loads(self._finish(command, subprocess.PIPE))

    def _finish(self, command: tuple[str, ...], output: int | None) -> str:
        """Raises DemoError when the command fails or something in the background ends meanwhile."""
        show(command)
        with subprocess.Popen(located(command), cwd=ROOT, stdout=output, text=True, encoding="utf-8") as process:
            try:
                text = self._waited(process)
            except BaseException:
                process.terminate()
                raise
        if process.returncode:
            self.check()
            raise DemoError(f"`{shlex.join(command)}` failed with exit code {process.returncode}.")
        return text

    def _waited(self, process: "subprocess.Popen[str]") -> str:
        while True:
            try:
                return process.communicate(timeout=0.5)[0] or ""
            except subprocess.TimeoutExpired:
                self.check()

    def check(self) -> None:
        """Raise DemoError if something in the background has ended."""
        for background in self.running:
            background.check()

    def end(self) -> None:
        """End what runs in the background, the latest first: an agent before its server."""
        for background in reversed(self.running):
            background.end()


# --- what the demo does ------------------------------------------------------------------------------------


def show_the_whole(demo: Demo) -> None:
    """From an empty server to recommended settings."""
    data = os.path.relpath(demo.folder / "server", ROOT)
    state = os.path.relpath(demo.folder / "agent", ROOT)
    at = ("--data", data)

    say("A server with an empty database, on this machine only.")
    demo.start("joulebox", "serve", "--port", "0", *at)
    url = address(demo, demo.folder / "server" / "server.json")

    say("This machine becomes its first device.")
    code = demo.ask("joulebox", "device", "enroll", *at, "--json")["code"]
    demo.run("joulebox-agent", "enroll", "--server", url, "--code", code, "--state-dir", state)
    source = energy_source(demo)
    demo.start("joulebox-agent", "run", "--source", source, "--state-dir", state)

    say(f"A small sweep over two scenes, with short windows. Watch it at {url} too.")
    sweep = demo.ask("joulebox", "sweep", "submit", SWEEP, *at, "--json")["id"]
    demo.run("joulebox", "sweep", "watch", sweep, *at)
    for scene in SCENES:
        demo.run("joulebox", "tradeoff", sweep, "--scene", scene, *at)

    say(f"The dashboard, while the demo runs: {url}")
    say("The best settings for three quarters of what the reference costs:")
    for scene in SCENES:
        budget = share_of_the_reference(demo, sweep, scene, at)
        demo.run("joulebox", "recommend", sweep, "--scene", scene, *budget, *at)


def say(text: str) -> None:
    """A line of the demo's own."""
    print(f"\n{text}", flush=True)


def address(demo: Demo, file: Path) -> str:
    """The server's address, once it has written it."""
    deadline_s = time.monotonic() + START_S
    while time.monotonic() < deadline_s:
        demo.check()
        with contextlib.suppress(OSError, ValueError):
            return str(json.loads(file.read_text(encoding="utf-8"))["url"])
        time.sleep(0.1)
    raise DemoError(f"The server did not start within {START_S:.0f} s; its log is in {demo.folder}.")


def energy_source(demo: Demo) -> str:
    """The source that the agent shall use: the machine's own, or the replay where it has none."""
    chosen = demo.ask("joulebox-agent", "doctor", "--json")["chosen"]
    if chosen and chosen != "none":
        say(
            f"This machine can measure energy: {chosen}. The demo's windows are short; where they are too short\n"
            "for a battery's slow gauge, joules stay unknown and times take their place."
        )
        return str(chosen)
    say(
        "This machine has no energy source that can be used now (no discharging battery, no RAPL). Times and CPU\n"
        "seconds are real; joules come from a scripted trace and are labelled 'replayed' wherever they appear."
    )
    return REPLAY


def share_of_the_reference(demo: Demo, sweep: str, scene: str, at: tuple[str, ...]) -> tuple[str, str]:
    """A budget option worth SHARE of the reference's cost: in joules, or in seconds where none are known."""
    reference = demo.ask("joulebox", "tradeoff", sweep, "--scene", scene, *at, "--json")["reference"]
    if reference is None:
        raise DemoError(f"The sweep has no reference for {scene}, so there is nothing to save on.")
    energy_j = reference["energy_j"]
    if energy_j is None:
        return "--budget-s", amount(reference["time_s"]["value"] * SHARE)
    return "--budget-j", amount(energy_j["value"] * SHARE)


def amount(value: float) -> str:
    """A number as a person would type it: two digits, or whole."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def stay(demo: Demo) -> None:
    """Keep the dashboard up until Ctrl-C."""
    say("The dashboard stays up; Ctrl-C ends it.")
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(0.5)
            demo.check()


def main() -> int:
    """Run the demo; whatever happens, nothing is left running."""
    parser = argparse.ArgumentParser(prog="make demo", description="From an empty server to recommended settings.")
    parser.add_argument("--once", action="store_true", help="end by itself instead of keeping the dashboard up")
    arguments = parser.parse_args()
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda number, _: sys.exit(128 + number))
    folder = ROOT / ".demo" / time.strftime("%Y%m%d-%H%M%S")
    folder.mkdir(parents=True)
    demo = Demo(folder)
    try:
        show_the_whole(demo)
        if not arguments.once:
            stay(demo)
    except DemoError as error:
        print(f"\nThe demo stopped: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nThe demo was interrupted.", file=sys.stderr)
        return 130
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # an impatient second Ctrl-C must leave nothing running either
        demo.end()
    return 0


if __name__ == "__main__":
    sys.exit(main())
