"""Pauses after trouble."""

import random


class Pauses:
    """Each longer than the last, up to `longest_s`; jittered, so that a fleet does not come back as one."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._troubles = 0

    def next_s(self) -> float:
        """Length of the next pause [s]: between a half and the whole of first, 2 first, 4 first ..."""
        whole_s = min(self._longest_s, self._first_s * 2.0**self._troubles)
        self._troubles = min(self._troubles + 1, 16)
        return whole_s * random.uniform(0.5, 1.0)

    def over(self) -> None:
        """The trouble has passed: the next pause is a short one again."""
        self._troubles = 0
