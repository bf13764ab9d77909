"""The spool: whole entries or none, one bad file blocks nobody, a full disk loses nothing."""

import errno
import hashlib
import json
import os
from pathlib import Path

import pytest
from fake_fleet import TOKEN, FakeFleet
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from joulebox_agent.errors import ServerUnreachableError, SpoolFullError, TokenRejectedError
from joulebox_agent.fleet.delivery import Delivery
from joulebox_agent.fleet.journal import Journal
from joulebox_agent.fleet.server import Server
from joulebox_agent.fleet.spool import BadEntryError, Entry, Spool

PICTURE, SAMPLES = b"picture", b'{"time_s": 0}\n'
BLOBS = {hashlib.sha256(content).hexdigest(): content for content in (PICTURE, SAMPLES)}


def entry(number: int) -> Entry:
    picture, samples = BLOBS
    document = {"scene": "cornell", "number": number, "image_blob": picture, "power_samples": samples}
    return Entry(attempt_id=f"attempt-{number}", document=document, blobs=tuple(BLOBS))


@pytest.fixture
def spool(tmp_path: Path) -> Spool:
    return Spool(tmp_path / "spool")


@pytest.fixture
def fleet() -> FakeFleet:
    return FakeFleet()


def kept_in(said: list[str]) -> Journal:
    """A journal whose sentences are kept."""
    return Journal(lambda record: said.append(record["message"]))


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def delivery(spool: Spool, fleet: FakeFleet, said: list[str]) -> Delivery:
    server = Server("http://fleet", TOKEN, transport=fleet.transport, quick_wait_s=0.001)
    return Delivery(spool, server, kept_in(said))


def test_an_entry_survives_and_is_forgotten_once_delivered(spool: Spool, delivery: Delivery, fleet: FakeFleet) -> None:
    delivery.keep(entry(1), BLOBS)
    assert Spool(spool.folder).read(spool.waiting()[0]) == (entry(1), BLOBS)
    delivery.send_all()
    assert fleet.results.keys() == {"attempt-1"}
    assert set(BLOBS) <= set(fleet.blobs)
    assert fleet.calls[-1] == "PUT /attempts/attempt-1/result"  # the result comes after what it names
    assert spool.waiting() == []
    assert list((spool.folder / "blobs").iterdir()) == []


def test_blobs_the_server_has_are_not_sent(delivery: Delivery, fleet: FakeFleet) -> None:
    fleet.blobs |= BLOBS
    delivery.keep(entry(1), BLOBS)
    delivery.send_all()
    assert not [call for call in fleet.calls if call.startswith("PUT /blobs")]


def test_sending_again_after_a_lost_answer_is_accepted(spool: Spool, delivery: Delivery, fleet: FakeFleet) -> None:
    delivery.keep(entry(1), BLOBS)
    delivery.send_all()
    delivery.keep(entry(1), BLOBS)
    delivery.send_all()
    assert spool.waiting() == []
    assert list(spool.bad.iterdir()) == []


def test_an_unreachable_server_keeps_everything(spool: Spool, delivery: Delivery, fleet: FakeFleet) -> None:
    delivery.keep(entry(1), BLOBS)
    fleet.down = 100
    with pytest.raises(ServerUnreachableError, match="cannot be reached: Connection refused"):
        delivery.send_all()
    assert len(spool.waiting()) == 1
    fleet.down = 2  # fewer than the quick tries
    delivery.send_all()
    assert spool.waiting() == []


@pytest.mark.parametrize("status", [500, 503, 429])
def test_a_server_in_trouble_keeps_everything(spool: Spool, delivery: Delivery, fleet: FakeFleet, status: int) -> None:
    delivery.keep(entry(1), BLOBS)
    fleet.answers["PUT /attempts"] = (status, {"title": "later"})
    with pytest.raises(ServerUnreachableError, match=str(status)):
        delivery.send_all()
    assert len(spool.waiting()) == 1


def test_a_conflict_is_set_aside_and_blocks_nobody(
    spool: Spool, delivery: Delivery, fleet: FakeFleet, said: list[str]
) -> None:
    fleet.results["attempt-1"] = b"{}"
    for number in (1, 2):
        delivery.keep(entry(number), BLOBS)
    delivery.send_all()
    assert "attempt-2" in fleet.results
    assert [path.name for path in spool.bad.glob("*.json")] == ["attempt-1.json"]
    assert "409 another result was sent" in (spool.bad / "attempt-1.why.txt").read_text()
    assert any("attempt-1.json" in line for line in said)
    spool.sweep()
    assert set(BLOBS) == {path.name for path in (spool.folder / "blobs").iterdir()}  # its blobs stay with it


@pytest.mark.parametrize(
    "content", [b"", b"{", b"\xff\xfe", b"[]", b'{"attempt_id": "../../x", "document": {}, "blobs": []}']
)
def test_an_unreadable_file_is_set_aside_and_blocks_nobody(
    spool: Spool, delivery: Delivery, fleet: FakeFleet, content: bytes
) -> None:
    (spool.folder / "aaa.json").write_bytes(content)
    delivery.keep(entry(2), BLOBS)
    delivery.send_all()
    assert fleet.results.keys() == {"attempt-2"}
    assert (spool.bad / "aaa.json").read_bytes() == content
    assert "aaa.json is not a spooled result" in (spool.bad / "aaa.why.txt").read_text()


def test_a_damaged_blob_is_noticed(spool: Spool, delivery: Delivery) -> None:
    delivery.keep(entry(1), BLOBS)
    (spool.folder / "blobs" / next(iter(BLOBS))).write_bytes(b"rot")
    with pytest.raises(BadEntryError, match="damaged"):
        spool.read(spool.waiting()[0])


def test_a_blob_the_server_lost_in_between_is_sent_again(delivery: Delivery, fleet: FakeFleet) -> None:
    """HEAD says yes, then the server's clean-up runs, then the result names what is gone."""
    fleet.answers["HEAD /blobs"] = (200, {})
    delivery.keep(entry(1), BLOBS)
    delivery.send_all()
    assert "attempt-1" in fleet.results
    assert set(BLOBS) <= set(fleet.blobs)


def test_a_kill_between_the_steps_leaves_no_half_entry(spool: Spool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A crash at every single rename: afterwards the entry is there in full or not at all."""

    class KillError(BaseException):
        pass

    real, left = os.replace, 0

    def replace(source: Path, target: Path) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise KillError
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    for survived in (0, 1, 2, 3):
        left = survived
        try:
            spool.put(entry(1), BLOBS)
        except KillError:
            assert spool.waiting() == []
            again = Spool(spool.folder)
            again.sweep()
            assert list((spool.folder / "blobs").iterdir()) == []
            assert list(spool.folder.glob("*.draft")) == []
    assert Spool(spool.folder).read(spool.waiting()[0]) == (entry(1), BLOBS)


def full(*arguments: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_one_sentence_and_leaves_nothing_half(spool: Spool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SpoolFullError, match=r"The disk of the spool .* is full; free some space"):
        spool.put(entry(1), BLOBS)
    assert [path for path in spool.folder.rglob("*") if path.is_file()] == []


def test_a_result_waits_in_memory_until_there_is_room(
    spool: Spool, delivery: Delivery, fleet: FakeFleet, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        delivery.keep(entry(1), BLOBS)
        assert len(delivery.in_memory) == 1
        assert "is full" in said[0]
        fleet.down = 100
        with pytest.raises(ServerUnreachableError):
            delivery.send_all()
        assert len(delivery.in_memory) == 1
    fleet.down = 100
    with pytest.raises(ServerUnreachableError):
        delivery.send_all()  # there is room again: it is safe on disk
    assert delivery.in_memory == []
    assert len(spool.waiting()) == 1


def test_a_result_goes_straight_to_the_server_when_the_disk_stays_full(
    delivery: Delivery, fleet: FakeFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", full)
    delivery.keep(entry(1), BLOBS)
    delivery.send_all()
    assert "attempt-1" in fleet.results
    assert delivery.in_memory == []


def test_a_revoked_token_keeps_everything(spool: Spool, fleet: FakeFleet, said: list[str]) -> None:
    server = Server("http://fleet", "revoked", transport=fleet.transport, quick_wait_s=0.001)
    delivery = Delivery(spool, server, kept_in(said))
    delivery.keep(entry(1), BLOBS)
    with pytest.raises(TokenRejectedError, match="unknown token"):
        delivery.send_all()
    assert len(spool.waiting()) == 1


def test_a_damaged_blob_does_not_spoil_the_next_result(spool: Spool, delivery: Delivery, fleet: FakeFleet) -> None:
    """Two results may name one picture; the second brings it whole."""
    delivery.keep(entry(1), BLOBS)
    victim = spool.folder / "blobs" / next(iter(BLOBS))
    victim.write_bytes(b"damaged")
    delivery.send_all()
    assert fleet.results == {}
    delivery.keep(entry(2), BLOBS)
    delivery.send_all()
    assert fleet.results.keys() == {"attempt-2"}


def test_bytes_hurt_on_the_way_are_sent_again(spool: Spool, delivery: Delivery, fleet: FakeFleet) -> None:
    """The spool's copy is good: the server's complaint is about the way, and the entry waits."""
    delivery.keep(entry(1), BLOBS)
    wrong = {"title": "wrong digest", "code": "wrong_digest"}
    fleet.answers["PUT /blobs/"] = (422, wrong)
    with pytest.raises(ServerUnreachableError):
        delivery.send_all()
    assert len(spool.waiting()) == 1
    del fleet.answers["PUT /blobs/"]
    delivery.send_all()
    assert fleet.results.keys() == {"attempt-1"}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
)
ENTRIES = st.fixed_dictionaries(
    {}, optional={"attempt_id": JSON, "document": JSON, "blobs": st.lists(st.sampled_from([*BLOBS, "0" * 64])) | JSON}
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.binary(max_size=200) | st.one_of(JSON, ENTRIES).map(lambda document: json.dumps(document).encode()))
def test_whatever_stands_in_a_file_blocks_nobody(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    """Any bytes under the name of an entry: set aside or sent, and the good result behind it arrives."""
    fleet, said = FakeFleet(), list[str]()
    spool = Spool(tmp_path_factory.mktemp("any") / "spool")
    delivery = Delivery(
        spool, Server("http://fleet", TOKEN, transport=fleet.transport, quick_wait_s=0.001), kept_in(said)
    )
    (spool.folder / "a.json").write_bytes(content)
    os.utime(spool.folder / "a.json", (1, 1))  # the oldest: its turn comes first
    delivery.keep(entry(7), BLOBS)
    delivery.send_all()
    assert "attempt-7" in fleet.results
    assert spool.waiting() == []
    spool.sweep()
