"""The event stream: what happened, in order, from where a client left off."""

import json
import threading
from collections.abc import Iterator
from typing import Any

import httpx2
from server_testing import Server


def lines_of(server: Server, ready: threading.Event | None = None, **options: Any) -> Iterator[dict[str, Any]]:
    """Events as they come; `ready` is set once the stream is open."""
    event: dict[str, Any] = {}
    with (
        httpx2.Client(base_url=server.client.base_url, timeout=10) as client,
        client.stream("GET", "/v1/events", **options) as answer,
    ):
        assert answer.headers["content-type"].startswith("text/event-stream")
        for line in answer.iter_lines():
            if ready is not None:
                ready.set()
            if line == "" and event:
                yield event
                event = {}
            elif line and not line.startswith(":"):
                field, _, value = line.partition(": ")
                event[field] = json.loads(value) if field == "data" else value


def test_a_sweep_as_events(live: Server) -> None:
    """A watcher sees the sweep begin, every job, every difference and the end, and nothing of other sweeps."""
    live.add_sweep(name="other")
    sweep = live.add_sweep(axes={}, repeats=1)
    seen: list[dict[str, Any]] = []
    ready = threading.Event()

    def follow() -> None:
        for event in lines_of(live, ready, params={"sweep": sweep["id"]}):
            seen.append(event)
            if event["event"] == "sweep" and event["data"]["state"] == "done":
                return

    watcher = threading.Thread(target=follow)
    watcher.start()
    assert ready.wait(5)
    live.client.patch(
        f"/v1/sweeps/{live.get('/sweeps')['items'][1]['id']}", headers=live.operator, json={"action": "pause"}
    )
    live.device().work()
    watcher.join(10)
    assert not watcher.is_alive()
    kinds = [(event["event"], event["data"].get("state")) for event in seen]
    assert kinds.count(("job", "leased")) == kinds.count(("job", "done")) == 3
    assert kinds.count(("difference", "done")) == 2
    assert kinds[-1] == ("sweep", "done")
    assert {event["data"]["sweep_id"] for event in seen if event["event"] != "device"} == {sweep["id"]}
    ids = [int(event["id"]) for event in seen]
    assert ids == sorted(set(ids))


def test_last_event_id(live: Server) -> None:
    """A client that was away gets what it missed, once."""
    live.device()
    live.add_sweep()
    everything = take(lines_of(live, headers={"Last-Event-ID": "0"}), 3)
    kinds = [(event["event"], event["data"].get("state")) for event in everything]
    assert kinds == [("device", "enrolled"), ("device", "ready"), ("sweep", "running")]
    missed = take(lines_of(live, headers={"Last-Event-ID": everything[1]["id"]}), 1)
    assert missed == everything[2:]


def take(events: Iterator[dict[str, Any]], count: int) -> list[dict[str, Any]]:
    found = [next(events) for _ in range(count)]
    events.close()  # type: ignore[attr-defined]
    return found
