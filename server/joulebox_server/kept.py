"""Answers that are kept while what they rest on has not changed."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from typing import Generic, TypeVar

T = TypeVar("T")


class Kept(Generic[T]):
    """The last `most` answers by their questions. A question names everything that its answer depends on."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._answers: OrderedDict[Hashable, Future[T]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, question: Hashable, answer: Callable[[], T]) -> T:
        """The answer kept for the question, or a new one, which others who ask meanwhile wait for.

        What `answer` raises is raised to all of them and not kept.
        """
        with self._lock:
            found = self._answers.get(question)
            mine = found is None
            if found is None:
                found = self._answers[question] = Future()
            self._answers.move_to_end(question)
            while len(self._answers) > self._most:
                self._answers.popitem(last=False)
        if mine:
            try:
                found.set_result(answer())
            except BaseException as error:
                with self._lock:
                    self._answers.pop(question, None)
                found.set_exception(error)
        return found.result()
