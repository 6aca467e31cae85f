from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

import anynet_ext

try:
    from anynet_ext import _kernels  # noqa: F401
except ImportError:  # a wheel for all versions of Python: no instruction set can be tested apart from the operators
    sys.modules["anynet_ext._kernels"] = anynet_ext._kernels = SimpleNamespace(Isa=SimpleNamespace(__members__={}))


@pytest.fixture(scope="session", autouse=True)
def another_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Processes that tests start import what is installed, not what lies in the folder in which pytest was started."""
    before = os.getcwd()
    os.chdir(tmp_path_factory.mktemp("elsewhere"))
    yield
    os.chdir(before)
