"""How `run` ends: after the window under way where that makes a result, at once when asked twice."""

import threading


class Stop:
    """A wish to end, made by a signal or a test.

    asked    set as soon as the agent should end; a measurement that has enough windows ends with them
    at_once  set when a measurement should not be waited for any longer: asked twice, or `grace_s` [s] are over
    """

    def __init__(self, grace_s: float = 10.0) -> None:
        self.asked, self.at_once = threading.Event(), threading.Event()
        self._grace_s = grace_s

    def ask(self) -> None:
        """Ask to end; may be called from a handler of signals."""
        if self.asked.is_set():
            self.at_once.set()
            return
        self.asked.set()
        patience = threading.Timer(self._grace_s, self.at_once.set)
        patience.daemon = True
        patience.start()
