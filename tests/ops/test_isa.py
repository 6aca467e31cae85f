"""Which instruction set a process uses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from operator_cases import ISAS
from processes import completed

import anynet_ext
from anynet_ext import _kernels

pytestmark = pytest.mark.skipif(not ISAS, reason="the package has no _kernels")


def chosen(isa: str) -> subprocess.CompletedProcess[str]:
    """What a fresh process chooses when the environment asks for `isa`."""
    code = "import _kernels; print(_kernels.chosen_isa().name)"
    environment = {**os.environ, "ANYNET_ISA": isa, "PYTHONPATH": str(Path(_kernels.__file__).parent)}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("isa", [isa.name for isa in ISAS])
def test_environment_chooses(isa):
    assert chosen(isa).stdout.strip() == isa


def test_environment_names_an_unknown_set():
    message = chosen("mmx").stderr
    assert "ANYNET_ISA=mmx: expected one of" in message
    assert all(isa.name in message for isa in ISAS)


def test_best_is_the_default():
    assert chosen("").stdout.strip() == ISAS[-1].name
    assert anynet_ext.build_info()["instruction_set"] == _kernels.chosen_isa().name


def test_the_package_tells_the_sets_that_can_be_used():
    sets = "mmx", "AVX2", "\udcff\n"
    names = ", ".join(reversed([isa.name for isa in ISAS]))
    for result in completed([["env", f"ANYNET_ISA={isa}", sys.executable, "-c", "import anynet_ext"] for isa in sets]):
        assert result.returncode == 1
        assert f": expected one of {names} (" in result.stderr
        assert "ImportError: ANYNET_ISA=" in result.stderr
