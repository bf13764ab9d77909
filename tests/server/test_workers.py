"""Work in processes of their own: it holds nobody up, and a process that ends is replaced."""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path

import pytest
from joulebox_server.routes import findings
from joulebox_server.workers import Workers
from server_testing import listening, serving
from test_errors import told


@pytest.fixture
def workers() -> Iterator[Workers]:
    made = Workers(1)
    yield made
    made.close()


def test_a_process_that_ends_is_replaced(workers: Workers) -> None:
    first = workers.submit(os.getpid).result(60)
    assert first != os.getpid()
    with pytest.raises(BrokenExecutor):
        workers.submit(os._exit, 3).result(60)
    second = workers.submit(os.getpid).result(60)
    assert second not in (first, os.getpid())


def test_work_given_to_a_pool_that_broke_meanwhile_is_done(workers: Workers) -> None:
    """Whoever comes between the end of the process and its being noticed is not told of it."""
    broken = workers.submit(os._exit, 3)
    with pytest.raises(BrokenExecutor):
        broken.result(60)
    workers._own = workers._pool()
    broken_pool = workers._own
    broken_pool.submit(os._exit, 3).exception(60)
    assert workers.submit(os.getpid).result(60) != os.getpid()
    assert workers._own is not broken_pool


def test_the_given_executor_does_the_work_and_is_not_ended() -> None:
    with ThreadPoolExecutor(1) as pool:
        workers = Workers(1, pool)
        assert workers.submit(os.getpid).result(10) == os.getpid()
        workers.close()
        assert pool.submit(os.getpid).result(10) == os.getpid()


def test_charts_are_drawn_in_another_process(tmp_path: Path) -> None:
    """A server of its own processes draws a chart; afterwards none of them is left."""
    with listening(tmp_path, None) as server:
        sweep = server.add_sweep(axes={}, repeats=1)
        device = server.device()
        device.work()
        answer = server.client.get(f"/v1/sweeps/{sweep['id']}/charts/stages.svg")
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/svg+xml")
        own = server.app.state.services.drawing._own
        processes = list(own._processes.values())
        assert [process.is_alive() for process in processes] == [True]
        assert processes[0].pid != os.getpid()
    assert not any(process.is_alive() for process in processes)


def test_a_chart_that_waits_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """503 with a time to ask again, and what is asked for again is drawn."""
    go_on = threading.Event()
    with ThreadPoolExecutor(1) as busy, serving(tmp_path, busy) as server:
        server.add_scene()
        sweep = server.add_sweep(axes={}, repeats=1)
        path = f"/v1/sweeps/{sweep['id']}/charts/stages.svg"
        waiting = busy.submit(go_on.wait, 60)
        try:
            with monkeypatch.context() as hurried:
                hurried.setattr(findings, "LONGEST_DRAWING_S", 0.05)
                told(server.client.get(path), 503, "unavailable", "too many charts")
        finally:
            go_on.set()
        waiting.result(10)
        assert server.client.get(path).status_code == 200
