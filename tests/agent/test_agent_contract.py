"""The sample documents of tests/contract, which agent and server must both accept."""

import json
from pathlib import Path

from agent_testing import FAKE_COMMAND
from joulebox_agent.fleet.capabilities import describe_device
from joulebox_agent.fleet.server import Lease
from joulebox_agent.measuring.document import MeasureDocument
from joulebox_agent.measuring.rule import make_rule

CONTRACT = Path(__file__).parents[1] / "contract"


def sample(name: str) -> object:
    return json.loads((CONTRACT / name).read_text(encoding="utf-8"))


def test_measure_document_goes_through_unchanged() -> None:
    document = sample("measure.json")
    assert MeasureDocument.model_validate(document).to_json() == document


def test_lease_is_understood() -> None:
    document = sample("lease.json")
    assert isinstance(document, dict)
    lease = Lease.model_validate(document)
    assert make_rule(**lease.measure.model_dump()).window_s == document["measure"]["window_s"]
    assert lease.settings == document["settings"]


def test_capabilities_have_the_fields_of_the_sample(tmp_path: Path) -> None:
    document = sample("capabilities.json")
    assert isinstance(document, dict)
    told = describe_device(FAKE_COMMAND, "auto", tmp_path)
    assert told.keys() == document.keys()
    assert told["renderer"].keys() == document["renderer"].keys()
    assert all(method.keys() == document["energy_methods"][0].keys() for method in told["energy_methods"])
