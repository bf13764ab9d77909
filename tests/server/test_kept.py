"""Answers that are kept."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from joulebox_server.kept import Kept


def test_an_answer_is_made_once_for_all_who_ask() -> None:
    kept: Kept[int] = Kept(4)
    made: list[int] = []
    start = threading.Barrier(8)

    def slow() -> int:
        made.append(1)
        time.sleep(0.05)
        return 7

    def ask(_: int) -> int:
        start.wait()
        return kept.get("question", slow)

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, range(8))) == [7] * 8
    assert made == [1]


def test_the_oldest_goes_when_there_are_too_many() -> None:
    kept: Kept[int] = Kept(2)
    made: list[str] = []

    def ask(question: str) -> None:
        kept.get(question, lambda: made.append(question) or len(made))

    for question in ("a", "b", "a", "c", "a", "b"):
        ask(question)
    assert made == ["a", "b", "c", "b"]


def test_a_failure_is_told_and_not_kept() -> None:
    kept: Kept[int] = Kept(2)

    def fails() -> int:
        raise ValueError("not yet")

    with pytest.raises(ValueError, match="not yet"):
        kept.get("question", fails)
    assert kept.get("question", lambda: 3) == 3
