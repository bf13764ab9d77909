"""`joulebox-agent enroll`, `run` and `status`: the commands that know a server."""

import json
import platform
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Annotated

import platformdirs
import stamina.instrumentation
import typer

from joulebox_agent.errors import UsageError
from joulebox_agent.fleet.daemon import Daemon, RunOptions
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.spool import Spool
from joulebox_agent.fleet.state import Enrolment, StateDir, boot_id
from joulebox_agent.loop import renderer_command
from joulebox_agent.measuring.charging import Band
from joulebox_agent.measuring.progress import shown_progress
from joulebox_agent.sources.choose import choose

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
    state_dir: StateOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Log as JSON lines.")] = False,
) -> None:
    """Measure what the server asks for until told to stop (SIGTERM or Ctrl-C)."""
    state = StateDir.at(state_dir)
    enrolment = state.enrolment()
    if enrolment is None:
        raise UsageError(f"This device is not enrolled ({state.root}); run joulebox-agent enroll first.")
    command = renderer_command(renderer)
    if source not in ("auto", "battery_gauge", "battery_counter"):  # a battery may come off its cable later
        choose(source, sysfs_root)
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
    server, log = Server(enrolment.server, enrolment.token), _json_log if as_json else _log
    with state.lock():
        Daemon(state, enrolment.device_id, server, command, options, _stop_on_signals(), log, shown_progress).run()


def _stop_on_signals() -> threading.Event:
    """An event that SIGTERM and Ctrl-C set."""
    stop = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        stop.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, on_signal)
    return stop


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _json_log(text: str) -> None:
    print(json.dumps({"event": "log", "message": text}), flush=True)


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
        "spooled": 0,
        "set_aside": 0,
    }
    if root.is_dir():
        state = StateDir(root)
        enrolment, spool = state.enrolment(), Spool(state.spool)
        if enrolment is not None:
            answer |= {"enrolled": True, **enrolment.model_dump(exclude={"token"})}
        answer |= {"running": state.locked(), "spooled": len(spool.waiting())}
        answer["set_aside"] = len(list(spool.bad.glob("*.json")))
    choice = choose(source, sysfs_root)
    answer |= {"energy_method": choice.source.method, "energy_reason": choice.report.reason}
    if as_json:
        print(json.dumps(answer))
        return
    for key, value in answer.items():
        print(f"{key:14} {value}")
