"""Bring docker-compose.yml up with podman and let its two agents complete a sweep: `make test-compose`.

    python compose.py [--without-containers]

The base image is made here from Debian's packages by debootstrap, the image of the Dockerfile is built on it, and
podman-compose starts the file as it stands. As root, with podman and debootstrap. Where that cannot be, it says why,
and starts the very commands of the file as plain processes on loopback. Ends with exit code 1 when the sweep does
not end well, an agent had no part in it, or a process does not end by itself when told to.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import venv
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import yaml

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "docker-compose.yml"
SECRET = ROOT / "secrets" / "enrollment.txt"
BASE, PROJECT = "localhost/joulebox-python", "joulebox-test"
PODMAN_COMPOSE = "podman-compose==1.6.0"
PACKAGES = "python3,python3-pip,python3-venv,python-is-python3,ca-certificates"
AUTHORITIES = Path("/etc/ssl/certs/ca-certificates.crt")
AGENTS = ["agent-1", "agent-2"]
PATIENCE_S = 900
ENDED_WELL = (0, -signal.SIGTERM, 128 + signal.SIGTERM)
"""A server that has closed everything ends by the signal that it was sent."""


class CannotError(Exception):
    """Containers cannot be run here; the message says why."""


class Place(Protocol):
    """Where the services of the file run."""

    scenes: str

    def ask(self, service: str, script: str, given: str = "") -> str:
        """What a shell script prints that is run beside a service, `given` being its standard input."""

    def stop(self) -> dict[str, int]:
        """End every service as `docker compose stop` does; the exit code of each."""


def say(text: str) -> None:
    print(f"[{time.strftime('%H:%M:%S')}] {text}", flush=True)


def run(
    *command: str, given: str | None = None, check: bool = True, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a command and keep what it prints. Raises CannotError with its last words when it fails and must not."""
    done = subprocess.run(command, input=given, capture_output=True, text=True, check=False, **options)
    if check and done.returncode:
        last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-3:]
        raise CannotError(f"{' '.join(command[:3])} ... ended with {done.returncode}: {' / '.join(last)}")
    return done


# --- with containers ---------------------------------------------------------------------------------------


class Containers:
    """The file, brought up by podman-compose."""

    scenes = "/demo/scenes"

    def __init__(self, work: Path) -> None:
        self._environment = podman_environment(work)
        try_podman(self._environment)
        if run("podman", "image", "exists", BASE, check=False, env=self._environment).returncode:
            make_base_image(work, self._environment)
        venv.create(work / "venv", with_pip=True)
        say(f"podman-compose: {PODMAN_COMPOSE}")
        run(str(work / "venv/bin/pip"), "install", "-q", PODMAN_COMPOSE)
        program = str(work / "venv/bin/podman-compose")
        self._program = [program, "-p", PROJECT, "--in-pod", "false", "-f", str(FILE)]

    def up(self) -> None:
        say("podman-compose build")
        self._compose(
            "--podman-build-args",
            "--network host --format docker",
            "build",
            "--build-arg",
            f"PYTHON_IMAGE={BASE}",
            "server",
        )
        say("podman-compose up")
        self._compose("up", "-d", "--no-build")

    def ask(self, service: str, script: str, given: str = "") -> str:
        return self._compose("exec", "-T", service, "sh", "-c", script, given=given)

    def stop(self) -> dict[str, int]:
        self._compose("stop")
        containers = json.loads(run("podman", "ps", "-a", "--filter", f"label=io.podman.compose.project={PROJECT}",
                                    "--format", "json", env=self._environment).stdout)  # fmt: skip
        return {found["Labels"]["com.docker.compose.service"]: found["ExitCode"] for found in containers}

    def healthy(self) -> dict[str, bool]:
        """What the health check of each container says; without systemd nothing but this asks it."""
        checks = {name: ("podman", "healthcheck", "run", f"{PROJECT}_{name}_1") for name in ("server", *AGENTS)}
        return {name: run(*check, check=False, env=self._environment).returncode == 0 for name, check in checks.items()}

    def down(self) -> None:
        self._compose("down", "--volumes")

    def _compose(self, *arguments: str, given: str | None = None) -> str:
        return run(*self._program, *arguments, given=given, env=self._environment, cwd=ROOT).stdout


def podman_environment(work: Path) -> dict[str, str]:
    """Settings under which podman also runs where it may raise no limit and where there is no systemd."""
    settings = work / "containers.conf"
    settings.write_text('[containers]\ndefault_ulimits = ["nofile=8192:8192", "nproc=4096:4096"]\n')
    changes = {"CONTAINERS_CONF": str(settings)}
    if not Path("/run/systemd/system").is_dir():
        changes["DISABLE_HC_SYSTEMD"] = "true"
    return os.environ | changes


def try_podman(environment: dict[str, str]) -> None:
    """Raises CannotError unless a container could be run here."""
    missing = [name for name in ("podman", "debootstrap") if not shutil.which(name)]
    if missing or not hasattr(os, "geteuid"):
        raise CannotError(f"not installed: {', '.join(missing) or 'a POSIX system'}")
    if os.geteuid():
        raise CannotError("debootstrap wants root")
    run("podman", "info", env=environment)


def make_base_image(work: Path, environment: dict[str, str]) -> None:
    """A small Debian with its Python, in place of the image that a registry would give.

    It trusts whom this machine trusts, and its pip reads what this machine's reads.
    """
    say(f"debootstrap: {PACKAGES}")
    root = work / "base"
    sources = "".join(path.read_text() for path in Path("/etc/apt").rglob("*.sources"))
    sources += "".join(path.read_text() for path in Path("/etc/apt").rglob("*.list"))
    mirror = re.search(r"^(?:URIs:|deb) (?:\[.*\] )?(https?://\S+)", sources, re.MULTILINE)
    suite = re.search(r"^VERSION_CODENAME=(\w+)", Path("/etc/os-release").read_text(), re.MULTILINE)
    where = [suite[1] if suite else "stable", str(root), *([mirror[1]] if mirror else [])]
    run("debootstrap", "--variant=minbase", f"--include={PACKAGES}", *where)
    for refusal in root.glob("usr/lib/python3*/EXTERNALLY-MANAGED"):
        refusal.unlink()  # an image of Python has no other keeper of its packages than pip
    for known in (AUTHORITIES, Path("/etc/pip.conf")):
        if known.is_file():
            shutil.copy(known, root / known.relative_to("/"))
    shutil.rmtree(root / "var/cache/apt", ignore_errors=True)
    shutil.rmtree(root / "var/lib/apt/lists", ignore_errors=True)
    archive = str(work / "base.tar")
    run("tar", "-C", str(root), "-cf", archive, ".")
    run("podman", "import", archive, BASE, env=environment)
    shutil.rmtree(root)


# --- without -----------------------------------------------------------------------------------------------


class Processes:
    """The commands of the file as processes on loopback, each with a folder for its volume."""

    scenes = str(ROOT / "scenes")

    def __init__(self, work: Path, port: int) -> None:
        self._work, self._port = work, port
        self._services = yaml.safe_load(FILE.read_text(encoding="utf-8"))["services"]
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def up(self) -> None:
        for name, service in self._services.items():
            command = service["command"]
            say(f"start {name}")
            (self._work / name).mkdir()
            self._running[name] = subprocess.Popen(
                ["sh", "-c", "exec " * (command[0] != "sh") + self._here(name, _shell(command))],
                env=self._environment(name), cwd=self._work / name, start_new_session=True,
                stderr=(self._work / f"{name}.log").open("wb"),
            )  # fmt: skip
            if name == "server":
                waited(60, lambda: (self._work / "server/server/server.json").is_file(), "the server's start")

    def ask(self, service: str, script: str, given: str = "") -> str:
        command = ("sh", "-c", self._here(service, script))
        return run(*command, given=given, env=self._environment(service), cwd=self._work / service).stdout

    def stop(self) -> dict[str, int]:
        for process in self._running.values():
            process.send_signal(signal.SIGTERM)
        try:
            return {name: process.wait(15) for name, process in self._running.items()}
        except subprocess.TimeoutExpired as error:
            raise CannotError(f"a process did not end by itself: {error}") from None

    def healthy(self) -> dict[str, bool]:
        return {name: process.poll() is None for name, process in self._running.items()}

    def down(self) -> None:
        for process in self._running.values():
            process.kill()
            process.wait()

    def _environment(self, name: str) -> dict[str, str]:
        programs = str(Path(sys.executable).parent)
        return os.environ | self._services[name].get("environment", {}) | {
            "JOULEBOX_DATA": str(self._work / name / "server"),
            "PATH": programs + os.pathsep + os.environ["PATH"],
        }  # fmt: skip

    def _here(self, name: str, text: str) -> str:
        """The paths and addresses of a container, as they are here."""
        places = {
            "/run/secrets/enrollment": str(SECRET),
            "/var/lib/joulebox": str(self._work / name),
            "http://server:8473": f"http://127.0.0.1:{self._port}",
            "--port 8473": f"--port {self._port}",
            "0.0.0.0": "127.0.0.1",
            "$$": "$",
        }
        for there, here in places.items():
            text = text.replace(there, here)
        return text


def _shell(command: list[str]) -> str:
    return command[2] if command[:2] == ["sh", "-c"] else shlex.join(command)


# --- the same for both -------------------------------------------------------------------------------------


def two_device_sweep(scenes: str) -> str:
    """The demo's sweep, each of the two agents to do all of it."""
    text = (ROOT / "docs" / "demo-sweep.toml").read_text(encoding="utf-8").replace("../scenes", scenes)
    head, table, tail = text.partition("[settings]")
    tomllib.loads(text)
    return f"{head}devices = {json.dumps(AGENTS)}\n{table}{tail}"


def waited(seconds: float, done: Callable[[], bool], what: str) -> None:
    """Look every half second. Raises CannotError after `seconds`."""
    ends_s = time.monotonic() + seconds
    while not done():
        if time.monotonic() > ends_s:
            raise CannotError(f"{what} took more than {seconds:.0f} s")
        time.sleep(0.5)


def complete_a_sweep(place: Containers | Processes) -> list[str]:
    """Wait for both agents, submit, watch, count; returns what is not as it should be."""

    def joined() -> bool:
        devices = json.loads(place.ask("server", "joulebox device list --json"))["items"]
        return sorted(device["name"] for device in devices if device["capabilities"]) == AGENTS

    def answering() -> bool:
        try:
            return joined()
        except CannotError:  # the server is starting
            return False

    waited(120, answering, "the agents' enrolment")
    say("both agents are enrolled")
    submit = "cat > sweep.toml && joulebox sweep submit sweep.toml --json"
    sweep = json.loads(place.ask("server", submit, two_device_sweep(place.scenes)))
    say(f"sweep {sweep['name']} with {sweep['jobs']['total']} jobs for {' and '.join(AGENTS)}")
    watched = place.ask("server", f"joulebox sweep watch {sweep['id']} --timeout {PATIENCE_S} --json || true")
    state = json.loads(watched)
    say(f"sweep is {state['state']}: {state['jobs']}")
    results = [json.loads(line) for line in place.ask("server", "joulebox export --format ndjson").splitlines()]
    by_device = Counter(result["device"] for result in results)
    say(f"results of each device: {dict(by_device)}; kinds: {dict(Counter(r['quality'] for r in results))}")
    healthy = place.healthy()
    say(f"healthy: {healthy}")
    codes = place.stop()
    say(f"stopped, exit codes {codes}")
    wrong = [f"the sweep is {state['state']}"] if state["state"] != "done" else []
    wrong += [f"{agent} did nothing" for agent in AGENTS if not by_device[agent]]
    wrong += [f"{name} is not healthy" for name, well in healthy.items() if not well]
    return wrong + [f"{name} ended with {code}" for name, code in codes.items() if code not in ENDED_WELL]


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--without-containers", action="store_true")
    given = parser.parse_args(arguments)
    subprocess.run([sys.executable, str(ROOT / "run.py"), "secret"], check=True)
    with tempfile.TemporaryDirectory() as folder:
        place: Containers | Processes
        try:
            if given.without_containers:
                raise CannotError("not wanted")
            place = Containers(Path(folder))
        except CannotError as error:
            say(f"no containers: {error}")
            place = Processes(Path(folder), 8473)
        try:
            place.up()
            wrong = complete_a_sweep(place)
        except CannotError as error:
            wrong = [str(error)]
        finally:
            place.down()
    for line in wrong:
        say(f"WRONG: {line}")
    say("the sweep is complete" if not wrong else "failed")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
