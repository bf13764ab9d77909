"""A short slice of `make test-fleet` and `make test-load` in every run of the tests."""

import os
import sys
from pathlib import Path

import pytest

if sys.platform == "win32":
    pytest.skip("processes are forked, which Windows cannot", allow_module_level=True)

import crowd
import faults
import load


def rounds(tmp_path: Path, count: int, seed: int) -> None:
    """In a process of its own, which has no threads when it forks."""
    pid = os.fork()
    if not pid:
        code = 1
        try:
            faults.run(count, seed, tmp_path)
            code = 0
        except faults.BrokenError as error:
            (tmp_path / "broken").write_text(str(error))
        finally:
            os._exit(code)
    _, status = os.waitpid(pid, 0)
    why = tmp_path / "broken"
    assert status == 0, why.read_text() if why.exists() else "the rounds ended unexpectedly"


def test_twelve_faults(tmp_path: Path) -> None:
    """Each kind once, in a drawn order."""
    rounds(tmp_path, len(faults.FAULTS), seed=1)


@pytest.mark.long
def test_two_hundred_faults(tmp_path: Path) -> None:
    rounds(tmp_path, 200, seed=2)


def test_fifty_agents_for_three_seconds(tmp_path: Path) -> None:
    """Nothing lost, nothing leased twice, no error; how fast is for `make test-load` to say."""
    found = load.load(3, 1, 100, tmp_path)
    assert (found.errors, found.leased_twice, found.lost, found.integrity) == ([], 0, 0, "ok")
    assert found.rate > 0


def test_a_crowd_is_answered(tmp_path: Path) -> None:
    """Every question of the dashboard, with more than one page of devices; the times are for `make test-load`."""
    devices, sweeps = crowd.fill_crowd(tmp_path, 210, 1000)
    with load.serving(tmp_path) as (port, _):
        assert crowd.answers(port, sweeps[0], times=1).keys() == set(crowd.ASKED)
    assert len(devices) == 210
