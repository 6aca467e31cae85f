from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import FrameType
from typing import Any

from processes import completed

from anynet import AnyNet, save_checkpoint, shutdown
from anynet.shutdown import _Gate, computing


def test_predicting_on_daemon_threads_at_exit(tmp_path: Path) -> None:
    """Without the gate: "terminate called without an active exception", status -6, every time."""
    save_checkpoint(tmp_path / "random.safetensors", AnyNet())
    program = f"""
import sys, threading, time, numpy, anynet
predictor = anynet.Predictor({str(tmp_path / "random.safetensors")!r})
image = numpy.zeros((200, 300, 3), numpy.uint8)
begun = threading.Semaphore(0)

def work():
    while True:
        predictor.predict(image, image)
        begun.release()

for _ in range(4):
    threading.Thread(target=work, daemon=True).start()
for _ in range(4):
    begun.acquire()
time.sleep(float(sys.argv[1]))
"""
    for result in completed([[sys.executable, "-c", program, seconds] for seconds in ("0", "0.1")]):
        assert (result.returncode, result.stderr) == (0, "")


def test_loading_on_daemon_threads_at_exit() -> None:
    """What was loaded is kept: PyTorch aborts by itself where such a thread drops tensors."""
    program = """
import sys, threading, anynet
kept, begun = [], threading.Semaphore(0)

def work():
    while True:
        kept.append(getattr(anynet, sys.argv[1])("paper"))
        begun.release()

for _ in range(4):
    threading.Thread(target=work, daemon=True).start()
for _ in range(4):
    begun.acquire()
"""
    for _ in range(3):
        for result in completed([[sys.executable, "-c", program, load] for load in ("load_checkpoint", "Predictor")]):
            assert (result.returncode, result.stderr) == (0, "")


def test_the_main_thread_may_compute_at_exit(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "random.safetensors", AnyNet())
    program = f"""
import atexit, numpy

@atexit.register  # before the package: called after its own
def last():
    print(predictor.predict(image, image).stage)

import anynet
predictor = anynet.Predictor({str(tmp_path / "random.safetensors")!r})
image = numpy.zeros((20, 30, 3), numpy.uint8)
predictor.predict(image, image)
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "4\n", "")


def test_closing_waits_for_those_inside_and_keeps_others_out() -> None:
    gate, steps = _Gate(), []
    gate.enter()

    def leave() -> None:
        time.sleep(0.05)
        steps.append("left")
        gate.leave()

    def enter() -> None:
        gate.enter()
        steps.append("entered")

    threading.Thread(target=leave).start()
    gate.close()
    threading.Thread(target=enter, daemon=True).start()
    time.sleep(0.05)
    assert steps == ["left"]


def test_a_forked_child_does_not_wait_for_its_parents_threads() -> None:
    inside, end = threading.Event(), threading.Event()

    def compute() -> None:
        with computing():
            inside.set()
            end.wait(10)

    thread = threading.Thread(target=compute)
    thread.start()
    inside.wait(10)
    child = os.fork()
    if child == 0:
        import anynet.shutdown

        anynet.shutdown._gate.close()
        os._exit(0)
    deadline = time.monotonic() + 10
    while (waited := os.waitpid(child, os.WNOHANG)) == (0, 0) and time.monotonic() < deadline:
        time.sleep(0.01)
    end.set()
    thread.join()
    assert waited == (child, 0)


def test_a_thread_inside_may_enter_again_while_it_closes() -> None:
    """As a prediction does; the end waits for it, not it for the end."""
    gate, entered, go = _Gate(), threading.Event(), threading.Event()

    def work() -> None:
        gate.enter()
        entered.set()
        go.wait(10)
        gate.enter()
        gate.leave()
        gate.leave()

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    assert entered.wait(10)
    closing = threading.Thread(target=gate.close, daemon=True)
    closing.start()
    time.sleep(0.05)  # closed by now
    go.set()
    closing.join(10)
    assert not closing.is_alive()
    worker.join(10)
    assert not worker.is_alive()


def test_a_signal_that_interrupts_the_main_thread_anywhere_leaves_the_gate_open() -> None:
    """Raised at every line of it, once each, as a handler of SIGALRM or Ctrl-C may."""

    class Interrupted(Exception):
        pass

    def interrupted(after: int) -> bool:
        left = after

        def trace(frame: FrameType, event: str, arg: object) -> Any:
            nonlocal left
            if frame.f_code.co_filename in (shutdown.__file__, threading.__file__):
                left -= 1
                if left < 0:
                    sys.settrace(None)
                    raise Interrupted
            return trace

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            with computing():
                pass
        except Interrupted:
            return True
        finally:
            sys.settrace(before)
        return False

    after = 0
    while interrupted(after):
        after += 1
    assert after > 3

    entered = threading.Event()

    def work() -> None:
        with computing():
            entered.set()

    threading.Thread(target=work, daemon=True).start()
    assert entered.wait(10)
    assert shutdown._gate._inside == 0
