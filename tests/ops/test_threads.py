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
