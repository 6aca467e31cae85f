"""Finds and loads the compiled libraries. Importing this module registers `torch.ops.anynet`."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path
from threading import Lock
from typing import Any

import torch

import anynet_ext


def _find() -> Path:
    """The folder of the compiled libraries: this one, or that of the installed package, which a source tree hides from
    Python when that runs in the tree's own folder."""
    here = Path(__file__).parent
    for folder in (here, *(Path(entry, "anynet_ext").absolute() for entry in sys.path)):
        if (folder / "_C.so").exists():
            if folder != here:
                anynet_ext.__path__.append(str(folder))  # for _kernels
            return folder
    raise ImportError(
        f"{here / '_C.so'} is missing: build it with `pip install .` (or `python setup.py build_ext --inplace`)",
        name="anynet_ext",
    )


_FOLDER = _find()


def _load(name: str) -> ctypes.CDLL:
    path = _FOLDER / name
    torch.ops.load_library(path)  # type: ignore[no-untyped-call]
    return ctypes.CDLL(str(path))


_C = _load("_C.so")
for _function in (_C.anynet_isa, _C.anynet_isa_error, _C.anynet_isa_built, _C.anynet_build_config):
    _function.restype = ctypes.c_char_p
if _error := _C.anynet_isa_error().decode(errors="replace"):
    raise ImportError(_error, name="anynet_ext")


def _load_cuda() -> str:
    """Loads the CUDA operators if they were built, which needs no GPU. Says "yes", or why there are none."""
    if not (_FOLDER / "_C_cuda.so").exists():
        return "not built"
    try:
        _load("_C_cuda.so")
    except OSError as error:
        return f"not loaded: {error}"
    return "yes"


_CUDA = _load_cuda()


def wait_passively(passively: bool = True, *, unless_told: bool = False) -> None:
    """From now on, this process's OpenMP threads sleep soon after they ran out of work, instead of spinning for
    milliseconds: beside other work they would take the cores from it, and then wait for them.

    For GCC's OpenMP, which PyTorch brings along. `OMP_WAIT_POLICY` and `GOMP_SPINCOUNT` come before it. It takes one
    more thread than there are processors, which sleep as long.

    Args:
        passively: False: spin again.
        unless_told: leave it as the last call without this has told, if there was one.
    """
    with _Waiting.lock:
        if unless_told and _Waiting.told:
            return
        _Waiting.told = not unless_told
        if passively and not _Waiting.passive:
            _Waiting.passive = bool(_C.anynet_begin_waiting_passively())
        elif _Waiting.passive and not passively:
            _C.anynet_end_waiting_passively()
            _Waiting.passive = False


class _Waiting:
    """How the threads of this process wait, and whether somebody asked for that."""

    lock, passive, told = Lock(), False, False


def build_info() -> dict[str, Any]:
    """What was built and what is in use: library, compiler, instruction sets, threads, CUDA or why not."""
    config = _C.anynet_build_config().decode()
    return {
        "library": str(_FOLDER / "_C.so"),
        "config": config,
        "instruction_sets": _C.anynet_isa_built().decode().split(),
        "instruction_set": _C.anynet_isa().decode(),
        "cuda_operators": _CUDA,
        "threads": 1 if "no OpenMP" in config else torch.get_num_threads(),
        "torch": torch.__version__,
    }
