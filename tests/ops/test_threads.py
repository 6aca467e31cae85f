"""Threads of the operators: PyTorch's number of them, and one in a forked process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import anynet_ext

FORK = """
import os, torch, anynet_ext
torch.set_num_threads(2)
left = torch.randn(1, 16, 64, 256)
expected = torch.ops.anynet.cost_volume(left, left, None, 0, 11).numpy().tobytes()
child = os.fork()
if child == 0:
    found = torch.ops.anynet.cost_volume(left, left, None, 0, 11).numpy().tobytes()
    os._exit(0 if found == expected else 1)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
assert torch.ops.anynet.cost_volume(left, left, None, 0, 11).numpy().tobytes() == expected
"""

IDLE = """
import time, torch, anynet_ext
torch.set_num_threads(2)
left = torch.randn(1, 16, 64, 256)

def processor_time_while_idle():
    total = 0.0
    for _ in range(20):
        torch.ops.anynet.cost_volume(left, left, None, 0, 11)
        before = time.process_time()
        time.sleep(0.03)
        total += time.process_time() - before
    return total

def when(passively, **options):
    anynet_ext.wait_passively(passively, **options)
    time.sleep(0.1)
    return processor_time_while_idle()

print(when(False, unless_told=True), when(True, unless_told=True))
print(when(False), when(True, unless_told=True), when(True))
"""


@pytest.mark.skipif("no OpenMP" in anynet_ext.build_info()["config"], reason="has no other threads")
def test_threads_wait_asleep_if_told() -> None:
    if "libgomp" not in Path("/proc/self/maps").read_text() or len(os.sched_getaffinity(0)) < 2:
        pytest.skip("only GCC's OpenMP spins, and only where each of two threads has a processor")
    source = Path(anynet_ext.__file__).parents[1]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("OMP_", "GOMP_"))}
    done = subprocess.run(
        [sys.executable, "-c", IDLE],
        env={**environment, "PYTHONPATH": str(source)},
        check=True,
        capture_output=True,
        text=True,
    )
    spinning, asleep, spinning_again, told_to_spin, told_to_sleep = map(float, done.stdout.split())
    assert max(asleep, told_to_sleep) < min(spinning, spinning_again, told_to_spin) / 3


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_does_not_wait_for_threads_that_it_lacks() -> None:
    source = Path(anynet_ext.__file__).parents[1]
    environment = {**os.environ, "PYTHONPATH": str(source)}
    process = subprocess.Popen([sys.executable, "-W", "ignore", "-c", FORK], env=environment, start_new_session=True)
    try:
        assert process.wait(timeout=120) == 0
    finally:
        if process.poll() is None:
            os.killpg(process.pid, 9)  # the child too
