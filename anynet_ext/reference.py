"""Every operator again in plain PyTorch: the oracle of the tests, and readable documentation of the arithmetic.

Same arguments, results, gradients and dtypes as the operators of the same names, at the speed of plain PyTorch. Half
types are computed in float32 and rounded once.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def _widen(*tensors: Tensor) -> list[Tensor]:
    return [t.float() if t.dtype in (torch.float16, torch.bfloat16) else t for t in tensors]


def _columns(image: Tensor, index: Tensor) -> Tensor:
    """Columns of `image` [N,C,H,W] at whole positions `index`, which broadcasts to [N,1,H,W']; zero outside."""
    n, c, h, w = image.shape
    index = index.expand(n, c, h, index.shape[-1])
    if w == 0:
        return image.new_zeros(index.shape)
    valid = (index >= 0) & (index < w)
    return torch.where(valid, image.gather(3, index.clamp(0, w - 1).nan_to_num(0).long()), 0)


def _sample(image: Tensor, x: Tensor) -> Tensor:
    """`image` [N,C,H,W] at columns `x` [N,1,H,W]: linear between pixels, zero outside, NaN where x is NaN."""
    # Further outside everything is zero as well, so clamp before the conversion to integers can overflow.
    inside = x.clamp(-2, image.shape[-1])
    left = inside.detach().floor()
    fraction = inside - left
    sampled = (1 - fraction) * _columns(image, left) + fraction * _columns(image, left + 1)
    return torch.where(x.isnan(), torch.nan, sampled)  # without gradient


def warp(image: Tensor, disparity: Tensor) -> Tensor:
    """out[n,c,y,x] = image[n,c,y, x - disparity[n,0,y,x]]"""
    wide_image, wide_disparity = _widen(image, disparity)
    columns = torch.arange(image.shape[-1], dtype=wide_image.dtype, device=image.device)
    return _sample(wide_image, columns - wide_disparity).to(image.dtype)


def cost_volume(left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int) -> Tensor:
    """out[n,k,y,x] = sum_c | left[n,c,y,x] - right[n,c,y, x - disparity[n,0,y,x] - (first + k)] |"""
    wide_left, wide_right = _widen(left, right)
    columns = torch.arange(left.shape[-1], dtype=wide_left.dtype, device=left.device)
    costs = []
    for offset in range(first, last + 1):
        if disparity is None:
            sampled = _columns(wide_right, columns - offset)
        else:
            sampled = _sample(wide_right, columns - _widen(disparity)[0] - offset)
        costs.append((wide_left - sampled).abs().sum(1))
    return torch.stack(costs, 1).to(left.dtype)


def soft_argmin(cost: Tensor, first: int) -> Tensor:
    """out[n,0,y,x] = sum_k (first + k) softmax_k(-cost[n,k,y,x])"""
    (wide,) = _widen(cost)
    disparities = torch.arange(first, first + cost.shape[1], dtype=wide.dtype, device=cost.device)
    return (F.softmax(-wide, 1) * disparities[:, None, None]).sum(1, keepdim=True).to(cost.dtype)


def spatial_propagation(input: Tensor, gates: Tensor, direction: int) -> Tensor:
    """h[t] = (1 - sum_j g_j) input[t] + sum_j g_j h[t-1 shifted by j]; see `anynet_ext.spatial_propagation`."""
    if direction in (2, 3):  # scan along rows instead
        scanned = spatial_propagation(input.transpose(-1, -2), gates.transpose(-1, -2), direction - 2)
        return scanned.transpose(-1, -2)
    if direction == 1:
        return spatial_propagation(input.flip(-1), gates.flip(-1), 0).flip(-1)
    x, g = _widen(input, gates)
    if x.shape[-1] == 0:
        return input.clone()
    h = x[..., 0]
    columns = [h]
    for t in range(1, x.shape[-1]):
        gate = g[..., t].clone()  # [N,3,C,H]
        gate[:, 0, :, :1] = 0  # no neighbour above the first row
        gate[:, 2, :, -1:] = 0  # none below the last
        above, below = F.pad(h, (1, 0))[..., :-1], F.pad(h, (0, 1))[..., 1:]
        h = (1 - gate.sum(1)) * x[..., t] + gate[:, 0] * above + gate[:, 1] * h + gate[:, 2] * below
        columns.append(h)
    return torch.stack(columns, -1).to(input.dtype)


def conv3x3(
    input: Tensor,
    weight: Tensor,
    bias: Tensor | None = None,
    *,
    stride: int = 1,
    scale: Tensor | None = None,
    shift: Tensor | None = None,
    relu_in: bool = False,
    relu_out: bool = False,
) -> Tensor:
    """out = relu_out( bias + weight * relu_in( scale input + shift ) ), padding 1 with zeros after the affine"""
    channels = (1, -1, *[1] * (input.dim() - 2))
    if scale is not None and shift is not None:
        input = input * scale.view(channels) + shift.view(channels)
    if relu_in:
        input = input.relu()
    convolution = F.conv2d if input.dim() == 4 else F.conv3d
    out = convolution(input, weight, bias, stride, 1)
    return out.relu() if relu_out else out


conv3x3x3 = conv3x3


def resize(
    input: Tensor,
    size: tuple[int, int],
    *,
    scale: float = 1.0,
    add: Tensor | None = None,
    align_corners: bool = False,
) -> Tensor:
    """add + scale * bilinear(input)"""
    (wide,) = _widen(input)
    out = scale * F.interpolate(wide, size, mode="bilinear", align_corners=align_corners)
    return (out if add is None else out + _widen(add)[0]).to(input.dtype)
