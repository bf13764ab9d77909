"""docs/energy.md names every source, every field of doctor and the numbers that the code goes by."""

from pathlib import Path

import pytest
from joulebox_agent.sources import packs
from joulebox_agent.sources.choose import KNOWN
from joulebox_agent.sources.one_cell import SAME_CURRENT, SAME_VOLTAGE
from joulebox_agent.sources.reading import SourceReport

TEXT = (Path(__file__).parents[2] / "docs" / "energy.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [name for name in KNOWN if name != "battery_gauge"])
def test_every_source_is_described(name: str) -> None:
    assert f"`{name}`" in TEXT


@pytest.mark.parametrize("field", SourceReport.model_fields)
def test_every_field_of_doctor_is_described(field: str) -> None:
    assert f"`{field}`" in TEXT


def test_the_limits_are_those_of_the_code() -> None:
    assert f"more than {packs.HIGHEST_W:g} W, a voltage outside {packs.LOWEST_V:g} to {packs.HIGHEST_V:g} V" in TEXT
    assert f"a sum under {packs.LOWEST_W:g} W" in TEXT
    assert f"voltages within {SAME_VOLTAGE:.0%}".replace("%", " %") in TEXT
    assert f"currents within {SAME_CURRENT:.0%}".replace("%", " %") in TEXT
