"""The agent as a systemd user unit: its text, and putting it in place."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from joulebox_agent.errors import AgentError, UsageError
from joulebox_agent.files import write_whole

UNIT = "joulebox-agent.service"
GRACE_S = 75
"""For the window under way when the machine goes down; systemd itself gives STOP_S."""
STOP_S = 90
TEMPLATE = """\
[Unit]
Description=joulebox agent: measures what pictures cost on this machine
Documentation=man:systemd.service(5)
After=network.target

[Service]
Type=exec
ExecStart={command}
# Its results are on disk and an unfinished job goes back to the server, so it may be started again at any time.
# 2 is wrong use: starting again would not help.
Restart=always
RestartSec=30
RestartPreventExitStatus=2
KillMode=mixed
TimeoutStopSec={stop_s}
{environment}
[Install]
WantedBy=default.target
"""
CARRIED = ("SSL_CERT_FILE", "XDG_STATE_HOME")
"""Variables that the agent would miss if it were not given them."""


def unit_folder() -> Path:
    """Where systemd looks for the units of this user."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "systemd" / "user"


def unit_text(command: Sequence[str], environment: dict[str, str]) -> str:
    """The unit that runs a command. Raises UsageError for a word that no unit can hold."""
    told = "".join(f"Environment={_quoted(f'{name}={value}')}\n" for name, value in environment.items())
    first, *rest = command
    words = " ".join([_quoted(first), *(_quoted(word.replace("$", "$$")) for word in rest)])
    return TEMPLATE.format(command=words, stop_s=STOP_S, environment=told)


def _quoted(word: str) -> str:
    """A word as systemd.syntax(7) and systemd.unit(5) want it."""
    if any(ord(letter) < 32 or ord(letter) == 127 for letter in word):
        raise UsageError(f"{word!r} holds a control character, which no systemd unit can.")
    return '"' + word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%") + '"'


def install(text: str) -> Path:
    """Writes the unit and starts it now and at every login. Returns its file; raises AgentError with what to do."""
    systemctl = _systemctl()
    file = unit_folder() / UNIT
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, text.encode())
    except OSError as error:
        raise AgentError(f"The unit {file} cannot be written: {error.strerror}.") from error
    _run(systemctl, "daemon-reload")
    _run(systemctl, "enable", UNIT)
    _run(systemctl, "restart", UNIT)  # one that runs has other options perhaps
    return file


def remove() -> Path:
    """Stops the unit and removes it. Raises UsageError when it is not there."""
    file = unit_folder() / UNIT
    if not file.exists():
        raise UsageError(f"There is no unit {file}; nothing is installed.")
    systemctl = _systemctl()
    _run(systemctl, "disable", "--now", UNIT)
    file.unlink()
    _run(systemctl, "daemon-reload")
    return file


def _systemctl() -> str:
    found = shutil.which("systemctl")
    if found is None:
        raise AgentError(
            "This machine has no systemd; docs/fleet.md says how launchd and Windows start the agent, "
            "and --print shows the unit for another machine."
        )
    return found


def _run(systemctl: str, *words: str) -> None:
    done = subprocess.run([systemctl, "--user", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise AgentError(
            f"systemctl --user {' '.join(words)} failed: {lines[-1].rstrip('.')}; "
            "it needs a session of this user (log in, or loginctl enable-linger first)."
        )
