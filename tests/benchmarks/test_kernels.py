"""Every operator has its row."""

from __future__ import annotations

import gpu
import kernels
import torch

import anynet_ext  # noqa: F401  (registers the operators)

OWN_SCRIPT = {"conv3x3", "conv3x3x3"}  # conv.py
PYTORCHS_ON_CUDA = {"batch_norm_relu", "resize"}


def operators() -> set[str]:
    names = [schema.name.partition("::") for schema in torch._C._jit_get_all_schemas()]
    return {name for namespace, _, name in names if namespace == "anynet" and "_backward" not in name}


def test_on_the_cpu() -> None:
    assert {workload.name.partition(" ")[0] for workload in kernels.workloads()} == operators() - OWN_SCRIPT


def test_on_a_gpu() -> None:
    rows = [workload.name.partition(" ")[0].rstrip(",") for workload in [*gpu.workloads(), *gpu.deployed_workloads()]]
    assert set(rows) == operators() - PYTORCHS_ON_CUDA
