"""What setup.py takes from the environment."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from processes import completed

pytest.importorskip("setuptools", minversion="77")  # as pyproject.toml says

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(not (ROOT / "setup.py").exists(), reason="the sources are not here")
def test_kernels_are_on_or_off() -> None:
    """CMake would take "1" for ON, and the wheel would be named as one without them."""
    told = {value: f"ANYNET_KERNELS: expected ON or OFF, got {value}\n" for value in ("1", "on", "")} | {"OFF": ""}
    commands = [["env", f"ANYNET_KERNELS={value}", sys.executable, "setup.py", "--version"] for value in told]
    for message, done in zip(told.values(), completed(commands, cwd=ROOT), strict=True):
        assert (done.returncode == 0) == (not message)
        assert message in done.stderr
