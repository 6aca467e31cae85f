from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

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


@pytest.fixture(scope="session")
def emulated_operators() -> None:
    """Builds and loads the library that registers `torch.ops.anynet_cuda_emulated`."""
    ninja = shutil.which("ninja")
    if shutil.which("cmake") is None or ninja is None:
        pytest.skip("needs cmake and ninja")
    root = Path(__file__).parents[1]
    folder = root / "build" / "emulated"
    torch_folder = Path(torch.__file__).parent
    options = ["-GNinja", f"-DCMAKE_MAKE_PROGRAM={ninja}", "-DANYNET_CUDA=OFF", f"-DANYNET_TORCH_DIR={torch_folder}"]
    for command in (
        ["cmake", "-S", root, "-B", folder, *options],
        ["cmake", "--build", folder, "--target", "_C_cuda_emulated"],
    ):
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert done.returncode == 0, done.stdout
    torch.ops.load_library(folder / "tests" / "cuda" / "_C_cuda_emulated.so")
