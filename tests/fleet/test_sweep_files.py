"""Whatever stands in a sweep file: a definition that can be sent, or one sentence about the file."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from joulebox_server.cli.connection import WrongUseError
from joulebox_server.cli.sweep_file import read_sweep

QUICK = settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=10,
)


def read(path: Path) -> dict[str, Any] | None:
    try:
        found = read_sweep(path)
    except WrongUseError as error:
        sentence = str(error)
    else:
        json.dumps(found, allow_nan=False).encode()
        return found
    assert sentence.startswith("the sweep file ") and str(path) in sentence
    return None


@QUICK
@given(content=st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_any_bytes(tmp_path: Path, content: bytes) -> None:
    for name in ("sweep.toml", "sweep.json"):
        (tmp_path / name).write_bytes(content)
        read(tmp_path / name)


@QUICK
@given(document=VALUES)
def test_any_json(tmp_path: Path, document: Any) -> None:
    (tmp_path / "sweep.json").write_text(json.dumps(document))
    found = read(tmp_path / "sweep.json")
    assert found is None or found == document


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.json", b"[" * 100_000, "nested too deeply"),
        ("a.toml", b"a = " + b"[" * 100_000, "nested too deeply"),
        ("a.json", b'{"a": ' + b"9" * 5000 + b"}", "not valid JSON"),
        ("a.toml", b"a = " + b"9" * 5000, "not valid TOML"),
        ("a.toml", b"a = nan", "finite numbers"),
        ("a.json", b'{"a": Infinity}', "finite numbers"),
        ("a.toml", b"a = 2026-11-22", "finite numbers"),
        ("a.json", b'{"a": "\\ud800"}', None),
        ("a.json", b"[1]", "must hold an object"),
        ("a.json", b'{"name": "a", "name": "b"}', "'name' stands twice"),
        ("a.toml", b"#" * (17 << 20), "larger than 16 MiB"),
    ],
)
def test_what_cannot_be_sent(tmp_path: Path, name: str, content: bytes, sentence: str | None) -> None:
    (tmp_path / name).write_bytes(content)
    if sentence is None:  # sent as it is written; the server says that half a character cannot be stored
        assert read(tmp_path / name) is not None
        return
    with pytest.raises(WrongUseError, match=sentence):
        read_sweep(tmp_path / name)


def test_a_file_without_end() -> None:
    if not Path("/dev/zero").exists():
        pytest.skip("there is no /dev/zero")
    with pytest.raises(WrongUseError, match="larger than 16 MiB"):
        read_sweep(Path("/dev/zero"))
