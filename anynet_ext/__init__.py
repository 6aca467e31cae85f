"""Stereo operators for PyTorch: import this, then use the functions here or `torch.ops.anynet.*`.

Those of the deployed network are for inference: float32, without gradients. All others have first derivatives; second
ones raise RuntimeError. Under `torch.autocast`, these compute half types and float32, also mixed, in float32 and return
float32; float64 stays float64. On the CPU, all raise MemoryError (RuntimeError from PyTorch 2.15 on) if there is not
enough for their scratch, and run on one thread in a forked process. (What they have to make contiguous first, PyTorch
copies, whose own threads hang there: call `torch.set_num_threads(1)` in it.)

A saved program that holds them, a .pt2 file, can only be loaded after `import anynet_ext`.

`anynet_ext.reference` has every operator again in plain PyTorch.
"""

from anynet_ext import _flops, reference  # noqa: F401  (registers the formulas)
from anynet_ext._batch_norm import batch_norm_relu
from anynet_ext._candidates import candidate_costs, expected_disparity
from anynet_ext._conv import conv3x3, conv3x3x3, conv_chain
from anynet_ext._convex_upsampling import convex_upsampling
from anynet_ext._cost_volume import cost_volume, cost_volume_affine_relu
from anynet_ext._library import build_info, wait_passively
from anynet_ext._max_pool import max_pool
from anynet_ext._occlusion import fill_occlusions
from anynet_ext._read_image import read_image
from anynet_ext._refinement_guide import refinement_guide
from anynet_ext._resize import resize
from anynet_ext._soft_argmin import soft_argmin
from anynet_ext._spatial_propagation import normalized_propagation, spatial_propagation
from anynet_ext._stem import stem
from anynet_ext._upsample import upsample_add, upsample_concat, upsample_sum
from anynet_ext._warp import warp

__all__ = [
    "batch_norm_relu",
    "build_info",
    "candidate_costs",
    "conv3x3",
    "conv3x3x3",
    "conv_chain",
    "convex_upsampling",
    "cost_volume",
    "cost_volume_affine_relu",
    "expected_disparity",
    "fill_occlusions",
    "max_pool",
    "normalized_propagation",
    "read_image",
    "reference",
    "refinement_guide",
    "resize",
    "soft_argmin",
    "spatial_propagation",
    "stem",
    "upsample_add",
    "upsample_concat",
    "upsample_sum",
    "wait_passively",
    "warp",
]
