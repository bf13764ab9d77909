"""run.py: when it installs, how it fails, and that a task's own end is what the user gets."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest


def place(module: ModuleType, checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make run.py take `checkout` for its own folder."""
    environment = checkout / ".venv"
    monkeypatch.setattr(module, "ROOT", checkout)
    monkeypatch.setattr(module, "VENV", environment)
    monkeypatch.setattr(module, "STAMP", environment / "joulebox-setup")
    monkeypatch.setattr(module, "LOG", environment / "joulebox-setup.log")


@pytest.fixture
def run(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """run.py as a module, in a checkout that holds only what decides about the setup."""
    spec = importlib.util.spec_from_file_location("run", root / "run.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    checkout = tmp_path / "checkout"
    inputs = ["constraints.txt", "pyproject.toml"]
    for name in inputs + [f"{folder}/pyproject.toml" for folder in module.DISTRIBUTIONS]:
        (checkout / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(root / name, checkout / name)
    (checkout / ".venv").mkdir()
    place(module, checkout, monkeypatch)
    monkeypatch.setattr(module, "program", lambda name: str(Path(sys.executable).with_name(name)))
    return module


@pytest.fixture
def steps(run: ModuleType, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The steps that setup takes, recorded instead of taken."""
    taken: list[str] = []
    monkeypatch.setattr(run, "make_environment", lambda: taken.append("environment"))
    monkeypatch.setattr(run, "install", lambda *requirements: taken.append("install " + requirements[0]))
    monkeypatch.setattr(run, "warm_up", lambda: taken.append("compile"))
    return taken


EVERY_STEP = ["environment", "install pip", "install --no-build-isolation", "compile"]


def test_setup_installs_once(run: ModuleType, steps: list[str]) -> None:
    run.setup()
    assert steps == EVERY_STEP
    run.setup()
    assert steps == EVERY_STEP


@pytest.mark.parametrize("changed", ["constraints.txt", "agent/pyproject.toml"])
def test_setup_installs_again_into_the_same_environment_when_an_input_changed(
    run: ModuleType, steps: list[str], changed: str
) -> None:
    run.setup()
    steps.clear()
    with (run.ROOT / changed).open("a", encoding="utf-8") as file:
        file.write("\n")
    run.setup()
    assert steps == EVERY_STEP[1:]


def test_setup_starts_over_in_a_moved_checkout(
    run: ModuleType, steps: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run.setup()
    steps.clear()
    moved = tmp_path / "moved"
    shutil.copytree(run.ROOT, moved)
    place(run, moved, monkeypatch)
    run.setup()
    assert steps == EVERY_STEP


def test_setup_that_was_cut_short_starts_over(
    run: ModuleType, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(run, "warm_up", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run.setup()
    steps.clear()
    run.setup()
    assert steps == EVERY_STEP


def test_a_failed_install_is_one_sentence_with_the_reason(run: ModuleType) -> None:
    with pytest.raises(run.SetupError) as failure:
        run.install("--no-index", "joulebox-nothing-of-that-name")
    assert "No matching distribution found for joulebox-nothing-of-that-name" in str(failure.value)
    assert "\n" not in str(failure.value)
    assert "joulebox-nothing-of-that-name" in run.LOG.read_text(encoding="utf-8")


def test_a_task_passes_on_its_exit_code_and_its_arguments(
    run: ModuleType, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[str, ...]] = []
    monkeypatch.setitem(run.TASKS, "test", run.Task("", lambda *arguments: seen.append(arguments) or 5))
    assert run.main(["test", "--", "-k", "name"]) == 5
    assert run.main(["test", "-x"]) == 5
    assert seen == [("-k", "name"), ("-x",)]
    assert run.call(sys.executable, "-c", "raise SystemExit(7)") == 7


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_task_ends_itself_when_asked_to(root: Path, name: str) -> None:
    """The task gets the time it needs to tidy up, and its exit code counts."""
    task = (
        "import signal, sys, time\n"
        "def end(*_):\n    time.sleep(0.6); print('tidied', flush=True); sys.exit(3)\n"
        f"signal.signal(signal.{name}, end); print('up', flush=True); time.sleep(60)"
    )
    outer = f"import run, sys; sys.exit(run.call(sys.executable, '-c', {task!r}))"
    with subprocess.Popen(
        [sys.executable, "-c", outer], cwd=root, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout
        assert process.stdout.readline() == "up\n"
        started = time.monotonic()
        if name == "SIGINT":
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to everything in the foreground
        else:
            process.send_signal(signal.SIGTERM)
        assert process.stdout.read() == "tidied\n"
        assert process.wait(10) == 3
        assert time.monotonic() - started < 10
