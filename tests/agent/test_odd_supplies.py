"""Power supplies as no driver should show them: a reason in one sentence, never a traceback or odd watts."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from agent_testing import EIO, FaultySysfs
from joulebox_agent.conditions import read_conditions
from joulebox_agent.sources.battery_counter import BatteryCounter
from joulebox_agent.sources.battery_gauge import BatteryGauge
from joulebox_agent.sources.choose import unfit_reason
from joulebox_agent.sources.power_supply import PowerSupplyClass
from joulebox_agent.sources.sysfs import Sysfs

Tree = Callable[[str], Path]
Agent = Callable[..., tuple[int, str, str]]
SUPPLIES = "class/power_supply"
BAT0 = f"{SUPPLIES}/BAT0"


@pytest.mark.parametrize("name", ["type", "scope", "present"])
def test_a_pack_whose_kind_cannot_be_read_is_a_reason(agent: Agent, tree: Tree, name: str) -> None:
    """A folder in place of the file answers EISDIR, like EIO an error that does not say "unknown"."""
    root = tree("thinkpad_power_now")
    (root / BAT0 / name).unlink(missing_ok=True)
    (root / BAT0 / name).mkdir()
    code, out, _ = agent("doctor", "--json", "--sysfs-root", root)
    document = json.loads(out)
    assert code == 0
    assert document["discharge_w"] is None
    assert f"BAT0/{name}" in document["reason"]
    assert document["chosen"] is None
    assert f"BAT0/{name}" in (unfit_reason("auto", root) or "")
    assert read_conditions(root)["battery_charge_share"] is None


def test_a_failed_look_does_not_lose_the_cable(tree: Tree) -> None:
    """The list of supplies is kept whole or not at all: half of it would miss the cable behind the fault."""
    root = tree("chromebook_c300_full_on_ac")
    (root / BAT0 / "status").write_text("Discharging\n")
    (root / SUPPLIES / "AC").rename(root / SUPPLIES / "USBC")
    supplies = PowerSupplyClass(FaultySysfs(root, {f"{BAT0}/type": EIO}, times=2))
    assert supplies.pack_folders() == []
    assert supplies.read().cables_online == ("USBC",)


def test_a_plain_file_among_the_supplies_is_passed_over(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    (root / SUPPLIES / "note").write_text("not a supply")
    assert BatteryGauge(Sysfs(root)).report().power_w == pytest.approx(5.064)


@pytest.mark.parametrize("microwatts", ["9" * 400, "99999999999999", "1", "-5"])
def test_a_power_that_no_machine_draws_is_refused(agent: Agent, tree: Tree, microwatts: str) -> None:
    root = tree("thinkpad_power_now")
    (root / BAT0 / "power_now").write_text(microwatts)
    code, out, _ = agent("doctor", "--json", "--sysfs-root", root)
    document = json.loads(out)
    assert code == 0
    assert document["discharge_w"] is None
    assert not document["sources"][0]["available"]
    reading = BatteryGauge(Sysfs(root)).read()
    assert reading.power_w is None
    assert reading.problem


def test_a_counter_whose_capacity_cannot_be_read_still_counts(tree: Tree) -> None:
    root = tree("thinkpad_power_now")
    report = BatteryCounter(FaultySysfs(root, {f"{BAT0}/energy_full": EIO})).report()
    assert report.available
    assert report.resolution_j is None


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("words", [["doctor", "--json"], ["--version"]])
def test_a_full_standard_output_is_one_sentence(words: list[str]) -> None:
    program = "import sys; from joulebox_agent import cli; cli.main()"
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", program, *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr == "joulebox-agent: standard output cannot be used: No space left on device.\n"
