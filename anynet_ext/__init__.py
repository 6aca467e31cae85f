"""Stereo operators for PyTorch: import this, then use the functions here or `torch.ops.anynet.*`.

`anynet_ext.reference` has every operator again in plain PyTorch.
"""

from anynet_ext import reference
from anynet_ext._library import build_info
from anynet_ext._soft_argmin import soft_argmin

__all__ = ["build_info", "reference", "soft_argmin"]
