"""Keeps the interpreter from ending under a thread that computes.

A daemon thread that comes back from PyTorch after the interpreter has ended is unwound through C++ frames that must not
throw: the process aborts. So the end of the interpreter waits for computations that run, and none begins after it.

The main thread, which ends the interpreter, need not wait for itself. And only there may the handler of a signal raise,
anywhere, so that what it counted would stay counted.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

TIMEOUT = 60.0  # seconds that computations under way may take


class _Gate:
    def __init__(self) -> None:
        self._changed = threading.Condition(threading.Lock())
        self._inside = 0
        self._own = threading.local()  # its `depth`: times that this thread is inside
        self._closed = False

    def enter(self) -> None:
        depth = getattr(self._own, "depth", 0)
        with self._changed:
            while self._closed and depth == 0:  # one that is inside must get out: the end waits for it
                self._changed.wait()  # forever: the interpreter ends, and this daemon thread with it
            self._inside += 1
        self._own.depth = depth + 1

    def leave(self) -> None:
        with self._changed:
            self._inside -= 1
            self._changed.notify_all()
        self._own.depth = max(getattr(self._own, "depth", 0) - 1, 0)

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.wait_for(lambda: self._inside == 0, TIMEOUT)


_gate = _Gate()


@contextmanager
def computing() -> Iterator[None]:
    """Surrounds a computation that the interpreter must not end under."""
    if threading.current_thread() is threading.main_thread():
        yield
        return
    gate = _gate
    gate.enter()
    try:
        yield
    finally:
        gate.leave()


@atexit.register
def _at_exit() -> None:
    _gate.close()


def _after_fork() -> None:
    """The parent's other threads, which may be inside, are not in the child."""
    global _gate
    _gate = _Gate()


os.register_at_fork(after_in_child=_after_fork)
