"""Every task of the joulebox checkout: `python run.py TASK [arguments]`, or `make TASK [ARGS=...]`.

Standard library alone. It keeps an environment in .venv beside this file, installed from constraints.txt,
and runs the task in it. Exit code: the task's own; 1 when the environment cannot be made, 2 for wrong use.
"""

import sys

if sys.version_info < (3, 11):  # noqa: UP036 - whoever has an older one needs a sentence, not a traceback
    sys.exit(
        "joulebox needs Python 3.11 or newer and this is Python {}.{}; name a newer one, "
        "as in `python3.12 run.py demo` or `make demo PYTHON=python3.12`.".format(*sys.version_info[:2])
    )

import hashlib
import os
import re
import secrets
import shutil
import signal
import subprocess
import time
import venv
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, NoReturn

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
SCRIPTS = VENV / ("Scripts" if os.name == "nt" else "bin")
SUFFIX = ".exe" if os.name == "nt" else ""
STAMP = VENV / "joulebox-setup"
LOG = VENV / "joulebox-setup.log"
DISTRIBUTIONS = ("renderer", "agent", "server")
EXTRAS = {"agent": "[plot]"}
PACKAGES = ("renderer/joulebox_render", "agent/joulebox_agent", "server/joulebox_server")
GENERATED = ("dist", ".demo", ".mypy_cache", ".ruff_cache", ".pytest_cache", ".hypothesis", "tests/failures",
             ".import_linter_cache")  # fmt: skip


class SetupError(Exception):
    """The environment cannot be made; the message is the sentence the user sees."""


# --- the environment ---------------------------------------------------------------------------------------


def program(name: str) -> str:
    """Path of a program in the environment."""
    return str(SCRIPTS / (name + SUFFIX))


def setup() -> None:
    """Make .venv and install everything into it; nothing happens when the inputs have not changed."""
    identity, inputs = f"{sys.version} {ROOT}", inputs_digest()
    stamp = STAMP.read_text(encoding="utf-8").splitlines() if STAMP.is_file() else []
    if stamp == [identity, inputs]:
        return
    started = time.monotonic()
    if stamp[:1] != [identity]:  # another Python, a moved checkout, or a setup that was cut short
        say(f"making {VENV.name} with Python {sys.version.split()[0]}")
        make_environment()
    STAMP.unlink(missing_ok=True)
    say(f"installing what constraints.txt pins (the log is {LOG.relative_to(ROOT)})")
    install("pip", "hatchling", "editables")
    editables = [part for folder in DISTRIBUTIONS for part in ("-e", f"./{folder}{EXTRAS.get(folder, '')}")]
    install("--no-build-isolation", *editables, "--group", "dev")
    warm_up()
    STAMP.write_text(f"{identity}\n{inputs}\n", encoding="utf-8")
    say(f"ready after {time.monotonic() - started:.0f} s")


def inputs_digest() -> str:
    """SHA-256 over the files that decide what is installed."""
    projects = [f"{folder}/pyproject.toml" for folder in DISTRIBUTIONS]
    digest = hashlib.sha256()
    for name in ("constraints.txt", "pyproject.toml", *projects):
        digest.update((ROOT / name).read_bytes())
    return digest.hexdigest()


def make_environment() -> None:
    """Replace .venv by an empty environment with pip."""
    try:
        venv.EnvBuilder(clear=True, with_pip=True, symlinks=os.name != "nt").create(VENV)
    except (OSError, subprocess.CalledProcessError) as error:
        raise SetupError(
            f"Python {sys.version.split()[0]} could not make an environment in {VENV}: {error}; "
            "check the folder's permissions and that Python's venv module is complete "
            "(Debian and Ubuntu: apt install python3-venv)."
        ) from error


def install(*requirements: str) -> None:
    """Run pip, held to constraints.txt, with a progress bar; everything that it says goes to the log."""
    pinned = sum(bool(re.match(r"\w", line)) for line in (ROOT / "constraints.txt").read_text().splitlines())
    command = [program("python"), "-m", "pip", "install", "--no-input", "--disable-pip-version-check",
               "--upgrade", "-c", "constraints.txt", *requirements]  # fmt: skip
    seen: set[str] = set()
    last = ""
    pip = subprocess.Popen(
        command, cwd=ROOT, text=True, encoding="utf-8", errors="replace",
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    with LOG.open("a", encoding="utf-8") as log, pip:
        for line in pip.stdout or ():
            log.write(line)
            last = line.strip() or last
            found = re.match(r"(?:Collecting|Requirement already satisfied:) ([\w.-]+)", line)
            if found:
                seen.add(found[1].lower())
                show_progress(len(seen), pinned, found[1])
            elif line.startswith("Installing collected packages"):
                show_progress(len(seen), len(seen), "unpacking")
    end_progress()
    if pip.returncode:
        raise SetupError(f"pip could not install joulebox ({last}); the whole story is in {LOG}.")


def warm_up() -> None:
    """Compile the renderer's kernels now rather than in the first picture."""
    if subprocess.call([program("joulebox-render"), "warm-up"], cwd=ROOT):
        raise SetupError("The renderer's kernels could not be compiled; its message stands above.")


# --- what the user sees ------------------------------------------------------------------------------------


def say(text: str) -> None:
    """One line about the task at hand."""
    print(f"joulebox: {text}", flush=True)


def show_progress(done: int, total: int, what: str) -> None:
    """A bar on a terminal, nothing elsewhere: a log has no use for it."""
    if sys.stdout.isatty():
        filled = 30 * done // max(done, total)
        print(f"\r  [{'#' * filled:<30}] {done}/{max(done, total)} {what:<30.30}", end="", flush=True)


def end_progress() -> None:
    """Leave the bar's line."""
    if sys.stdout.isatty():
        print("\r" + " " * 79 + "\r", end="", flush=True)


def call(*command: str) -> int:
    """Run a command to its end and return its exit code; it, not we, decides what Ctrl-C and SIGTERM do."""
    with subprocess.Popen(command, cwd=ROOT) as child:
        signal.signal(signal.SIGTERM, lambda *_: child.terminate())
        while True:
            try:
                return child.wait()
            except KeyboardInterrupt:
                continue  # a terminal sends it to the child as well


# --- the tasks ---------------------------------------------------------------------------------------------


def pytest(*arguments: str) -> int:
    return call(program("python"), "-m", "pytest", *arguments)


def types(*arguments: str) -> int:
    return call(program("mypy"), *(arguments or (*PACKAGES, "run.py", "docs/demo.py", "docs/contact_sheet.py")))


def wheels(*arguments: str) -> int:
    for old in (ROOT / "dist").glob("joulebox_*.whl"):
        old.unlink()
    folders = [f"./{folder}" for folder in DISTRIBUTIONS]
    return call(program("python"), "-m", "pip", "--disable-pip-version-check", "wheel", "--no-deps",
                "--no-build-isolation", "--wheel-dir", "dist", *arguments, *folders)  # fmt: skip


def secret(*_: str) -> int:
    """Write the secret that docker-compose.yml hands to its containers; one already there is kept."""
    path = ROOT / "secrets" / "enrollment.txt"
    path.parent.mkdir(mode=0o700, exist_ok=True)  # the folder keeps others out; a container's user may read the file
    if not path.exists():
        path.write_text(secrets.token_urlsafe(32) + "\n", encoding="ascii")
    say(f"{path.relative_to(ROOT)} is in place")
    return 0


def clean(*arguments: str) -> int:
    """Remove what running and building left; `--all` takes the environment too."""
    doomed = [ROOT / name for name in GENERATED]
    for name in (*DISTRIBUTIONS, "tests", "docs"):
        doomed += (ROOT / name).rglob("__pycache__")
    if "--all" in arguments:
        doomed.append(VENV)
    for path in doomed:
        shutil.rmtree(path, ignore_errors=True)
    return 0


class Task(NamedTuple):
    """A task: what `help` says of it, what it runs, and whether it needs the environment."""

    summary: str
    run: Callable[..., int]
    in_environment: bool = True


TASKS = {
    "help": Task("this list", lambda *_: usage(), in_environment=False),
    "setup": Task("make .venv, install everything, compile the renderer's kernels", lambda *_: 0),
    "demo": Task("server, agent and a small sweep, up to the recommended settings (--once: end by itself)",
                 lambda *arguments: call(program("python"), "docs/demo.py", *arguments)),
    "test": Task("the quick tests (arguments after -- go to pytest: python run.py test -- -k NAME)", pytest),
    "test-long": Task("the long tests", lambda *arguments: pytest("-m", "long", *arguments)),
    "test-energy": Task("how often energy intervals hold a known truth, into docs/energy.md (--runs N, --only WORDS)",
                        lambda *arguments: call(program("python"), "-m", "tests.energy", *arguments)),
    "test-web": Task("the tests of the pages in a browser, how soon 2,000 points are drawn among them",
                     lambda *arguments: pytest("tests/web", "-m", "long or not long", *arguments)),
    "test-fleet": Task("the fleet's proofs: 200 rounds of random faults, any request, who may what (long)",
                       lambda *arguments: call(program("python"), "tests/fleet/faults.py", *arguments)
                       or pytest("tests/fleet", "-m", "long or not long", "--deselect",
                                 "tests/fleet/test_faults.py::test_two_hundred_faults")),
    "test-load": Task("what the server bears: 50 agents for a minute, beside a bare writer; the dashboard's queries",
                      lambda *arguments: call(program("python"), "tests/fleet/load.py", *arguments)),
    "test-compose": Task("docker-compose.yml brought up with podman, its two agents completing a sweep (root, Linux)",
                         lambda *arguments: call(program("python"), "tests/fleet/compose.py", *arguments)),
    "lint": Task("ruff", lambda *arguments: call(program("ruff"), "check", *(arguments or (".",)))),
    "types": Task("mypy --strict on our packages", types),
    "walls": Task("import-linter: who may import whom", lambda *_: call(program("lint-imports"))),
    "bench": Task("the renderer's goals and what is measured, beside Mitsuba, into docs/bench.md (--full: everything)",
                  lambda *arguments: call(program("python"), "-m", "tests.bench", *arguments)),
    "references": Task("converged pictures of the scenes by Mitsuba, kept in the user's cache (SCENE ... [--passes N])",
                       lambda *arguments: call(program("python"), "-m", "tests.bench.references", *arguments)),
    "contact-sheet": Task("every scene rendered into docs/scenes.png",
                          lambda *arguments: call(program("python"), "docs/contact_sheet.py", *arguments)),
    "study": Task("the grids that recommendations are scored on, rendered into tests/recommend/data (SCENE ...)",
                  lambda *arguments: call(program("python"), "-m", "tests.recommend.study", *arguments)),
    "test-recommend": Task("how often recommendations hold, on seeds and a scene that nothing was tuned on",
                           lambda *arguments: call(program("python"), "-m", "tests.recommend", *arguments)),
    "convergence": Task("error against every setting and against CPU time, drawn into docs/convergence.png",
                        lambda *arguments: call(program("python"), "-m", "tests.bench.convergence", *arguments)),
    "screenshots": Task("pictures of the dashboard over recorded sweeps, in .demo/screenshots (or FOLDER [--url URL])",
                        lambda *arguments: call(program("python"), "tests/web/screenshots.py",
                                                *(arguments or (".demo/screenshots",)))),
    "wheels": Task("the three wheels, in dist/", wheels),
    "secret": Task("the enrolment secret that docker-compose.yml asks for, in secrets/", secret, in_environment=False),
    "clean": Task("remove builds, caches, demo data (--all: .venv too)", clean, in_environment=False),
}  # fmt: skip


def usage() -> int:
    """Print the tasks."""
    print("python run.py TASK [arguments]      make TASK [ARGS=arguments]\n")
    for name, task in TASKS.items():
        print(f"  {name:<14} {task.summary}")
    return 0


def main(arguments: list[str]) -> int:
    """Run the task that the arguments name."""
    name, *rest = arguments or ["help"]
    name = {"-h": "help", "--help": "help"}.get(name, name)
    if name not in TASKS:
        print(f"There is no task {name!r}; the tasks are {', '.join(TASKS)}.", file=sys.stderr)
        return 2
    task = TASKS[name]
    if task.in_environment:
        setup()
    return task.run(*(rest[1:] if rest[:1] == ["--"] else rest))


def start() -> NoReturn:
    """Entry point: a failure of the setup is one sentence, an interrupted setup is told as such."""
    try:
        sys.exit(main(sys.argv[1:]))
    except SetupError as error:
        end_progress()
        sys.exit(str(error))
    except KeyboardInterrupt:
        end_progress()
        print("Interrupted; the next run takes up the setup again.", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    start()
