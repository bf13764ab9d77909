"""The demo: it ends what it started, whatever happens, and from end to end it recommends settings."""

import contextlib
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="fake commands are shell scripts, signals those of POSIX")


@pytest.fixture
def demo(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """docs/demo.py as a module that finds its programs in `tmp_path`."""
    spec = importlib.util.spec_from_file_location("demo", root / "docs/demo.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "PROGRAMS", tmp_path)
    return module


def script(folder: Path, name: str, text: str) -> None:
    """A fake program."""
    (folder / name).write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    (folder / name).chmod(0o755)


def alive(pid: int) -> bool:
    """Whether a process runs; one that ended and awaits its parent does not."""
    result = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return result.returncode == 0 and not result.stdout.strip().startswith("Z")


def gone(pid: int) -> bool:
    """Whether a process ends within ten seconds."""
    deadline_s = time.monotonic() + 10
    while alive(pid) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    return not alive(pid)


def test_a_dead_server_ends_the_wait_with_the_end_of_its_log(demo: ModuleType, tmp_path: Path) -> None:
    script(tmp_path, "joulebox", "sleep 0.3; echo starting; echo 'the port is taken' >&2; exit 4")
    script(tmp_path, "watch", "exec sleep 60")
    run = demo.Demo(tmp_path)
    run.start("joulebox", "serve")
    started_s = time.monotonic()
    with pytest.raises(demo.DemoError) as failure:
        run.run("watch")
    assert time.monotonic() - started_s < 20
    assert str(failure.value) == (
        "`joulebox serve` ended with exit code 4; the last line of its log joulebox.log is: the port is taken"
    )
    run.end()


def test_a_failed_command_is_named_with_its_exit_code(demo: ModuleType, tmp_path: Path) -> None:
    script(tmp_path, "joulebox", "exit 3")
    with pytest.raises(demo.DemoError, match=re.escape("`joulebox sweep watch` failed with exit code 3.")):
        demo.Demo(tmp_path).run("joulebox", "sweep", "watch")


def test_the_end_takes_along_what_ignores_it_and_what_it_started(
    demo: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "GRACE_S", 0.5)
    script(tmp_path, "joulebox-agent", f"trap '' TERM; sleep 60 & echo $! > {tmp_path}/pid; while :; do sleep 1; done")
    run = demo.Demo(tmp_path)
    run.start("joulebox-agent", "run")
    while not (tmp_path / "pid").is_file() or not (tmp_path / "pid").read_text():
        run.check()
        time.sleep(0.05)
    run.end()
    assert gone(run.running[0].process.pid)
    assert gone(int((tmp_path / "pid").read_text()))


def test_a_budget_is_a_share_of_the_reference_in_joules_or_else_in_seconds(
    demo: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = {"energy_j": {"value": 30.0}, "time_s": {"value": 2.0}}
    monkeypatch.setattr(demo.Demo, "ask", lambda *_: {"reference": reference})
    assert demo.share_of_the_reference(demo.Demo(tmp_path), "id", "box", ()) == ("--budget-j", "22")
    reference["energy_j"] = None  # type: ignore[assignment]
    assert demo.share_of_the_reference(demo.Demo(tmp_path), "id", "box", ()) == ("--budget-s", "1.5")


@pytest.fixture
def checkout(root: Path, tmp_path: Path) -> Iterator[Path]:
    """A folder that the real demo takes for the checkout, so that a test leaves nothing in the real one."""
    shutil.copytree(root / "docs", tmp_path / "docs")
    shutil.copytree(root / "scenes", tmp_path / "scenes")
    yield tmp_path
    for log in tmp_path.glob(".demo/*/*.log"):
        print(f"--- {log.name}\n{log.read_text(encoding='utf-8', errors='replace')[-3000:]}")


def test_asked_to_end_it_leaves_no_server_running(checkout: Path) -> None:
    with subprocess.Popen([sys.executable, "docs/demo.py"], cwd=checkout, stdout=subprocess.DEVNULL) as process:
        server = 0
        while not server:
            assert process.poll() is None
            for file in checkout.glob(".demo/*/server/server.json"):
                with contextlib.suppress(OSError, ValueError):  # it is just being written
                    server = int(json.loads(file.read_text(encoding="utf-8"))["pid"])
            time.sleep(0.05)
        assert alive(server)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 128 + signal.SIGTERM
    assert gone(server)


@pytest.mark.long
def test_from_an_empty_server_to_recommended_settings(checkout: Path) -> None:
    result = subprocess.run(
        [sys.executable, "docs/demo.py", "--once"], cwd=checkout, capture_output=True, text=True, timeout=1200
    )
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    head, *advice = re.split(r"^\$ \S*joulebox recommend .+\n", result.stdout, flags=re.MULTILINE)
    assert "jobs done" in head
    assert len(advice) == 2
    for text, scene in zip(advice, ("cornell-boxes", "cornell-spheres"), strict=True):
        assert re.match(rf"(for|no setting meets this for) {scene} on ", text)
    assert re.search("replayed|This machine can measure energy", result.stdout)
