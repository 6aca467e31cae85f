"""The CUDA operators' library, where it was built: it loads without a GPU and registers what it should."""

from __future__ import annotations

import ctypes
from pathlib import Path

import pytest
import torch

import anynet_ext

OPERATORS = ["cost_volume", "soft_argmin", "spatial_propagation", "warp"]
INFERENCE = [
    "candidate_costs",
    "conv3x3",
    "conv3x3x3",
    "conv_chain",
    "convex_upsampling",
    "cost_volume_affine_relu",
    "expected_disparity",
    "fill_occlusions",
    "max_pool",
    "normalized_propagation",
    "read_image",
    "refinement_guide",
    "stem",
    "upsample_add",
    "upsample_concat",
    "upsample_sum",
]


def test_build_info_tells_about_cuda():
    cuda = anynet_ext.build_info()["cuda_operators"]
    assert cuda in ("yes", "not built")


@pytest.mark.parametrize("name", [*INFERENCE, *(name + suffix for name in OPERATORS for suffix in ("", "_backward"))])
def test_registered_for_cuda(name):
    if anynet_ext.build_info()["cuda_operators"] != "yes":
        pytest.skip("built without CUDA")
    assert torch._C._dispatch_has_kernel_for_dispatch_key(f"anynet::{name}", "CUDA")


def test_torch_exports_its_current_stream():
    """In C, which the operators look up by name: the stable ABI has it since torch 2.13 only."""
    library = Path(torch.__file__).parent / "lib" / "libtorch_cuda.so"
    if not library.exists():
        pytest.skip("the CPU build of torch")
    assert ctypes.CDLL(str(library)).aoti_torch_get_current_cuda_stream
