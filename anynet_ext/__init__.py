"""Stereo operators for PyTorch: import this, then use the functions here or `torch.ops.anynet.*`.

`anynet_ext.reference` has every operator again in plain PyTorch.
"""

from anynet_ext import reference
from anynet_ext._batch_norm import batch_norm_relu
from anynet_ext._conv import conv3x3, conv3x3x3
from anynet_ext._cost_volume import cost_volume
from anynet_ext._library import build_info
from anynet_ext._resize import resize
from anynet_ext._soft_argmin import soft_argmin
from anynet_ext._spatial_propagation import spatial_propagation
from anynet_ext._warp import warp

__all__ = [
    "batch_norm_relu",
    "build_info",
    "conv3x3",
    "conv3x3x3",
    "cost_volume",
    "reference",
    "resize",
    "soft_argmin",
    "spatial_propagation",
    "warp",
]
