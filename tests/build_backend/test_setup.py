"""What setup.py takes from the environment."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("setuptools")

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(not (ROOT / "setup.py").exists(), reason="the sources are not here")
@pytest.mark.parametrize("value", ["1", "on", ""])
def test_kernels_are_on_or_off(tmp_path: Path, value: str) -> None:
    """CMake would take "1" for ON, and the wheel would be named as one without them."""
    command = [sys.executable, str(ROOT / "setup.py"), "--version"]
    for given, told in ((value, f"ANYNET_KERNELS: expected ON or OFF, got {value}\n"), ("OFF", "")):
        environment = {**os.environ, "ANYNET_KERNELS": given}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode == 0) == (not told)
        assert told in done.stderr
