"""`install-service`: a unit that systemd accepts, put in place by one command."""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from agent_testing import RENDERER
from joulebox_agent.errors import UsageError
from joulebox_agent.fleet import service
from joulebox_agent.fleet.state import Enrolment, StateDir

Agent = Callable[..., tuple[int, str, str]]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="systemd is Linux")


@pytest.fixture
def state(tmp_path: Path) -> StateDir:
    """An enrolled device in a folder whose name tries the unit's quoting."""
    state = StateDir.at(tmp_path / 'my "state" 100%i $HOME')
    state.save(Enrolment(server="http://fleet", device_id="device-1", token="a-secret", name="me"))
    return state


@pytest.fixture
def systemctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A systemctl that writes down how it was called, and fails at the word in the file `fails`."""
    place = tmp_path / "bin"
    place.mkdir()
    log, fails = tmp_path / "calls", tmp_path / "fails"
    fails.write_text("nothing")
    program = place / "systemctl"
    program.write_text(
        f'#!/bin/sh\necho "$@" >> {shlex.quote(str(log))}\n'
        f'if echo "$@" | grep -q "$(cat {shlex.quote(str(fails))})"; then echo "Failed to connect to bus." >&2; '
        "exit 1; fi\n"
    )
    program.chmod(0o755)
    log.touch()
    monkeypatch.setenv("PATH", f"{place}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path


def install(agent: Agent, state: StateDir, *words: str) -> tuple[int, str, str]:
    return agent("install-service", "--state-dir", state.root, "--renderer", RENDERER, *words)


def words_of(unit: str) -> list[str]:
    """The command of a unit as systemd would split it."""
    line = next(line for line in unit.splitlines() if line.startswith("ExecStart="))
    return [word.replace("%%", "%").replace("$$", "$") for word in shlex.split(line.removeprefix("ExecStart="))]


def test_one_command_installs_and_one_removes(agent: Agent, state: StateDir, systemctl: Path) -> None:
    code, out, err = install(agent, state, "--source", "replay@0.1", "--charge-hook", "echo $1")
    assert (code, err) == (0, "")
    file = systemctl / "config/systemd/user/joulebox-agent.service"
    assert str(file) in out
    unit = file.read_text()
    words = words_of(unit)
    assert words[:4] == [sys.executable, "-m", "joulebox_agent", "run"]
    told = dict(zip(words[4::2], words[5::2], strict=True))
    assert told["--source"] == "replay@0.1"
    assert told["--state-dir"] == str(state.root)
    assert told["--charge-hook"] == "echo $1"
    assert shlex.split(told["--renderer"]) == shlex.split(RENDERER)
    assert "a-secret" not in unit
    enabled = "--user daemon-reload\n--user enable joulebox-agent.service\n--user restart joulebox-agent.service\n"
    assert (systemctl / "calls").read_text() == enabled
    assert install(agent, state, "--source", "none")[0] == 0  # again, with another source
    assert (
        dict(zip(words_of(file.read_text())[4::2], words_of(file.read_text())[5::2], strict=True))["--source"] == "none"
    )
    assert agent("install-service", "--remove")[0] == 0
    assert not file.exists()
    assert "--user disable --now joulebox-agent.service" in (systemctl / "calls").read_text()
    code, _, err = agent("install-service", "--remove")
    assert (code, "nothing is installed" in err) == (2, True)


def test_the_command_of_the_unit_runs(agent: Agent, state: StateDir) -> None:
    """The words of the unit are understood by the agent as it is: only the server is missing."""
    code, out, _ = install(agent, state, "--print", "--source", "none")
    assert code == 0
    done = subprocess.run([*words_of(out), "--help"], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_systemd_finds_no_fault(agent: Agent, state: StateDir, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    code, out, _ = install(agent, state, "--print")
    assert code == 0
    unit = tmp_path / service.UNIT
    unit.write_text(out)
    environment = os.environ | {"XDG_RUNTIME_DIR": str(tmp_path)}
    done = subprocess.run(
        ["systemd-analyze", "--user", "verify", str(unit)],
        capture_output=True, text=True, timeout=60, check=False, env=environment,
    )  # fmt: skip
    about_ours = [line for line in done.stderr.splitlines() if service.UNIT in line]
    assert about_ours == []
    assert done.returncode == 0, done.stderr
    unit.write_text(out.replace("Type=exec", "Type=nonsense"))
    done = subprocess.run(
        ["systemd-analyze", "--user", "verify", str(unit)],
        capture_output=True, text=True, timeout=60, check=False, env=environment,
    )  # fmt: skip
    assert service.UNIT in done.stderr  # it would have said so


def test_what_is_carried_along(agent: Agent, state: StateDir, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", "/etc/our own.pem")
    _, out, _ = install(agent, state, "--print")
    assert 'Environment="SSL_CERT_FILE=/etc/our own.pem"\n' in out
    assert "TimeoutStopSec=90" in out and '"--stop-grace-s" "75"' in out  # the agent's patience ends before systemd's


def test_what_no_unit_can_hold() -> None:
    with pytest.raises(UsageError, match="control character"):
        service.unit_text(["/bin/a", "two\nlines"], {})


@pytest.mark.parametrize("step", ["daemon-reload", "enable", "restart"])
def test_a_systemctl_that_fails_is_one_sentence(agent: Agent, state: StateDir, systemctl: Path, step: str) -> None:
    (systemctl / "fails").write_text(step)
    code, _, err = install(agent, state)
    assert code == 1
    assert f"{step}" in err and "Failed to connect to bus" in err and "loginctl enable-linger" in err
    assert len(err.splitlines()) == 1


def test_refusals(agent: Agent, state: StateDir, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    code, _, err = agent("install-service", "--state-dir", tmp_path / "other", "--renderer", RENDERER)
    assert (code, "is not enrolled" in err) == (2, True)
    code, _, err = install(agent, state, "--charge-band", "10-90")
    assert code == 2
    code, _, err = install(agent, state, "--source", "sunlight")
    assert (code, "sunlight" in err) == (2, True)
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, err = install(agent, state)
    assert (code, "no systemd" in err and "docs/fleet.md" in err) == (1, True)
    assert not (tmp_path / "config").exists()
