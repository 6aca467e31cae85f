"""How the CPU's threads wait for one another: spinning is faster, and beside other work it costs what it takes."""

from __future__ import annotations

import resource
from functools import cache
from threading import Lock

from anynet_ext import wait_passively


class Waiting:
    """Has OpenMP's threads sleep when the system keeps preempting them, and now and then tries whether they still must.

    Who spins beside other work uses up what the system grants, and is not there when there is something to compute. The
    times are the process's own on the processors, in seconds.
    """

    WINDOW = 0.25  # in which preemptions are counted
    BUSY = 80.0  # preemptions per second; an idle virtual machine has 7 to 45, one with a busy core 90 to 220
    SHORTEST, LONGEST = 2.0, 60.0  # to sleep before trying again, longer each time in a row

    def __init__(self) -> None:
        self._lock = Lock()
        self._asleep, self._patience = False, self.SHORTEST
        self._begin, self._preempted = _usage()

    def adapt(self) -> None:
        """To be called between frames, or steps of training, by any thread."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            now, preempted = _usage()
            spent = now - self._begin
            if self._asleep:
                if spent < self._patience:
                    return
                self._asleep = False
                self._patience = min(2 * self._patience, self.LONGEST)
            elif preempted - self._preempted > self.BUSY * max(spent, self.WINDOW):  # maybe before the window ends
                self._asleep = True
            elif spent < self.WINDOW:
                return
            else:
                self._patience = self.SHORTEST
            wait_passively(self._asleep, unless_told=True)
            self._begin, self._preempted = now, preempted
        finally:
            self._lock.release()


@cache
def waiting() -> Waiting:
    """Of this process, all of whose threads wait alike."""
    return Waiting()


def _usage() -> tuple[float, int]:
    """Seconds on the processors, and how often the system took one away, of all threads."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime, usage.ru_nivcsw
