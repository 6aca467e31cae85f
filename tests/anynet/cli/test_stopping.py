from __future__ import annotations

import os
import signal
import threading

from anynet.cli.stopping import stopping


def test_a_signal_while_a_lock_is_held_that_the_stop_takes() -> None:
    """As those of `threading.Event` are, for a moment of each `wait`."""
    lock, ended = threading.Lock(), threading.Event()
    taken: list[bool] = []

    def stop() -> None:
        taken.append(lock.acquire(timeout=3))
        ended.set()

    with stopping(stop), lock:
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000):  # the handler runs between two of Python's instructions
            pass
    assert ended.wait(30)
    assert taken == [True]
