"""The CUDA operators' library, where it was built: it loads without a GPU and registers what it should."""

from __future__ import annotations

import pytest
import torch

import anynet_ext

OPERATORS = ["cost_volume", "soft_argmin", "spatial_propagation", "warp"]


def test_build_info_tells_about_cuda():
    cuda = anynet_ext.build_info()["cuda_operators"]
    assert cuda in ("yes", "not built")


@pytest.mark.parametrize("name", [name + suffix for name in OPERATORS for suffix in ("", "_backward")])
def test_registered_for_cuda(name):
    if anynet_ext.build_info()["cuda_operators"] != "yes":
        pytest.skip("built without CUDA")
    assert torch._C._dispatch_has_kernel_for_dispatch_key(f"anynet::{name}", "CUDA")
