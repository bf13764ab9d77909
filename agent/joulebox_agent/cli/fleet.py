"""`joulebox-agent enroll`, `run`, `status` and `install-service`: the commands that know a server."""

import contextlib
import json
import os
import platform
import shlex
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Annotated

import platformdirs
import stamina.instrumentation
import typer

from joulebox_agent.errors import UsageError
from joulebox_agent.fleet import service
from joulebox_agent.fleet.daemon import Daemon
from joulebox_agent.fleet.journal import Journal, Told, as_json_line, as_text, doing_now
from joulebox_agent.fleet.options import RunOptions
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.spool import Spool
from joulebox_agent.fleet.state import Enrolment, StateDir, boot_id, machine_lock, machine_lock_file
from joulebox_agent.fleet.stopping import Stop
from joulebox_agent.fleet.work import ShownListener
from joulebox_agent.loop import renderer_command
from joulebox_agent.measuring.charging import Band, hook_words
from joulebox_agent.measuring.progress import shown_progress
from joulebox_agent.sources.choose import choose
from joulebox_agent.sources.sysfs import SYSTEM_ROOT

StateOption = Annotated[Path | None, typer.Option(help="Folder for token, spool and scenes.")]


def enroll(
    server: Annotated[str, typer.Option(help="URL of the joulebox server.")],
    code: Annotated[str | None, typer.Option(help="One-time code, or the shared secret.")] = None,
    code_file: Annotated[Path | None, typer.Option(help="File that holds the code.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of this device; default: its host name.")] = None,
    again: Annotated[bool, typer.Option("--again", help="Enrol anew and forget the old token.")] = False,
    state_dir: StateOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print a document.")] = False,
) -> None:
    """Make this machine known to a server; the token stays in the state folder."""
    state = StateDir.at(state_dir)
    known = None if again else state.enrolment()
    if known is None:
        known = _enrolled(state, Server(server), _code(code, code_file), name)
    elif known.server != server.rstrip("/"):
        raise UsageError(f"This state folder belongs to {known.server}; use --again or another --state-dir.")
    answer = {
        "server": known.server,
        "device_id": known.device_id,
        "name": known.name,
        "state_dir": str(state.root),
    }
    print(json.dumps(answer) if as_json else f"Enrolled at {known.server} as {known.name} ({known.device_id}).")


def _enrolled(state: StateDir, server: Server, code: str, name: str | None) -> Enrolment:
    chosen = name or platform.node() or "device"
    device_id, token = server.enroll(code, chosen, boot_id())
    enrolment = Enrolment(server=server.url, device_id=device_id, token=token, name=chosen)
    state.save(enrolment)
    return enrolment


def _code(code: str | None, file: Path | None) -> str:
    if (code is None) == (file is None):
        raise UsageError("Give either --code or --code-file.")
    if file is not None:
        try:
            code = file.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "not text"
            raise UsageError(f"The code file {file} cannot be read: {reason}.") from error
    if not code:
        raise UsageError("The enrolment code is empty.")
    return code


def run(
    once: Annotated[bool, typer.Option("--once", help="Ask for one job, do it, end.")] = False,
    max_jobs: Annotated[int | None, typer.Option(min=1, help="End after N jobs.")] = None,
    idle_exit_s: Annotated[float | None, typer.Option(min=0, help="End after S seconds without a job.")] = None,
    source: Annotated[str, typer.Option(help="Energy source, as for measure.")] = "auto",
    renderer: Annotated[str | None, typer.Option(help="Command that speaks the loop protocol.")] = None,
    wait_s: Annotated[float, typer.Option(min=0, max=30, help="How long the server may hold a request.")] = 5.0,
    charge_band: Annotated[
        str, typer.Option(metavar="HIGH-LOW", help="Measure between these charges (percent).")
    ] = "90-30",
    charge_hook: Annotated[
        str | None, typer.Option(metavar="COMMAND", help="Called with on or off to charge (a smart plug).")
    ] = None,
    sysfs_root: Annotated[Path, typer.Option(help="Folder that plays /sys.")] = Path("/sys"),
    stop_grace_s: Annotated[
        float, typer.Option(min=0, help="How long a stop waits for the window that makes a result whole.")
    ] = 10.0,
    state_dir: StateOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Log as JSON lines.")] = False,
) -> None:
    """Measure what the server asks for until told to stop (SIGTERM or Ctrl-C; twice: at once)."""
    state = StateDir.at(state_dir)
    enrolment = _own(state)
    command = renderer_command(renderer)
    _check(source, sysfs_root)
    options = RunOptions(
        source=source,
        sysfs_root=sysfs_root,
        once=once,
        max_jobs=max_jobs,
        idle_exit_s=idle_exit_s,
        wait_s=wait_s,
        charge_band=Band.parse(charge_band),
        charge_hook=charge_hook,
    )
    stamina.instrumentation.set_on_retry_hooks([])  # the daemon has its own words for trouble
    journal = Journal(as_json_line if as_json else as_text, state.doing)
    listener: Callable[[], ShownListener] = (lambda: Told(journal)) if as_json else shown_progress
    server, stop = Server(enrolment.server, enrolment.token), _stop_on_signals(stop_grace_s)
    # Who reads no energy of this machine may share it: a study times pictures on every core.
    measures = source != "none" and not source.startswith("replay") and sysfs_root == SYSTEM_ROOT
    with state.lock(), machine_lock(machine_lock_file()) if measures else contextlib.nullcontext():
        Daemon(state, enrolment.device_id, server, command, options, stop, journal, listener).run()


def _own(state: StateDir) -> Enrolment:
    enrolment = state.enrolment()
    if enrolment is None:
        raise UsageError(f"This device is not enrolled ({state.root}); run joulebox-agent enroll first.")
    return enrolment


def _check(source: str, sysfs_root: Path) -> None:
    if source not in ("auto", "battery_gauge", "battery_counter"):  # a battery may come off its cable later
        choose(source, sysfs_root)


def _stop_on_signals(grace_s: float) -> Stop:
    """What SIGTERM and Ctrl-C set."""
    stop = Stop(grace_s)

    def on_signal(number: int, frame: FrameType | None) -> None:
        stop.ask()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, on_signal)
    return stop


def install_service(
    source: Annotated[str, typer.Option(help="Energy source, as for measure.")] = "auto",
    renderer: Annotated[str | None, typer.Option(help="Command that speaks the loop protocol.")] = None,
    charge_band: Annotated[
        str, typer.Option(metavar="HIGH-LOW", help="Measure between these charges (percent).")
    ] = "90-30",
    charge_hook: Annotated[
        str | None, typer.Option(metavar="COMMAND", help="Called with on or off to charge (a smart plug).")
    ] = None,
    state_dir: StateOption = None,
    show: Annotated[bool, typer.Option("--print", help="Print the unit and install nothing.")] = False,
    remove: Annotated[bool, typer.Option("--remove", help="Stop the agent and remove its unit.")] = False,
) -> None:
    """Start the agent now and at every login of this user, as a systemd user unit."""
    if remove:
        print(f"Removed {service.remove()}.")
        return
    state = StateDir.at(state_dir)
    _own(state)
    _check(source, SYSTEM_ROOT)
    Band.parse(charge_band)
    if charge_hook is not None and not show:
        hook_words(charge_hook)
    program = shlex.join(_found(renderer))
    command = [sys.executable, "-m", "joulebox_agent", "run", "--source", source, "--renderer", program,
               "--charge-band", charge_band, "--stop-grace-s", str(service.GRACE_S),
               "--state-dir", str(state.root.resolve())]  # fmt: skip
    if charge_hook is not None:
        command += ["--charge-hook", charge_hook]
    text = service.unit_text(command, {name: os.environ[name] for name in service.CARRIED if name in os.environ})
    if show:
        print(text, end="")
        return
    print(f"Installed {service.install(text)} and started it; journalctl --user -u {service.UNIT} shows what it says.")
    print("It ends with this user's last session unless loginctl enable-linger was called once.")


def _found(renderer: str | None) -> list[str]:
    """The renderer with its full path: a service has another PATH."""
    program, *rest = renderer_command(renderer)
    return [os.path.abspath(shutil.which(program) or program), *rest]


def status(
    state_dir: StateOption = None,
    source: Annotated[str, typer.Option(help="Energy source to report on.")] = "auto",
    sysfs_root: Annotated[Path, typer.Option(help="Folder that plays /sys.")] = Path("/sys"),
    as_json: Annotated[bool, typer.Option("--json", help="Print a document.")] = False,
) -> None:
    """Tell who this device is, what waits in its spool, and which energy source it would use."""
    root = state_dir or Path(platformdirs.user_state_dir("joulebox-agent"))
    answer: dict[str, object] = {
        "state_dir": str(root),
        "enrolled": False,
        "server": None,
        "device_id": None,
        "name": None,
        "running": False,
        "doing": None,
        "since": None,
        "leased": 0,
        "spooled": 0,
        "set_aside": 0,
    }
    if root.is_dir():
        state = StateDir(root)
        enrolment, spool = state.enrolment(), Spool(state.spool)
        if enrolment is not None:
            answer |= {"enrolled": True, **enrolment.model_dump(exclude={"token"})}
        answer |= {"running": state.locked(), "leased": len(state.leased()), "spooled": len(spool.waiting())}
        answer["set_aside"] = len(list(spool.bad.glob("*.json")))
        doing = doing_now(state.doing)
        if doing is not None and answer["running"]:
            answer |= {"doing": doing.get("message"), "since": doing.get("since")}
    choice = choose(source, sysfs_root)
    answer |= {"energy_method": choice.source.method, "energy_reason": choice.report.reason}
    if as_json:
        print(json.dumps(answer))
        return
    for key, value in answer.items():
        print(f"{key:14} {value}")
