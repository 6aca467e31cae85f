"""Every operator again in plain PyTorch: the oracle of the tests, and readable documentation of the arithmetic.

Same arguments, results, gradients and dtypes as the operators of the same names, at the speed of plain PyTorch. Half
types are computed in float32 and rounded once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor


def of(operator: torch._ops.OpOverload) -> Callable[..., Any]:
    """The function here that stands for an operator `anynet::*`; it takes the operator's arguments."""
    name = operator._schema.name.split("::")[1]
    parameters = [argument.name for argument in operator._schema.arguments]
    function: Callable[..., Any] = globals()[name]

    def call(*args: Any, **kwargs: Any) -> Any:
        values = dict(zip(parameters, args, strict=False)) | kwargs
        if name == "resize":
            values["size"] = values.pop("height"), values.pop("width")
        return function(**values)

    return call


def _widen(*tensors: Tensor) -> list[Tensor]:
    return [t.float() if t.dtype in (torch.float16, torch.bfloat16) else t for t in tensors]


def _columns(image: Tensor, index: Tensor) -> Tensor:
    """Columns of `image` [N,C,H,W] at whole positions `index`, which broadcasts to [N,1,H,W']; zero outside."""
    n, c, h, w = image.shape
    index = index.expand(n, c, h, index.shape[-1])
    if w == 0:
        return image.new_zeros(index.shape)
    valid = (index >= 0) & (index < w)
    return torch.where(valid, image.gather(3, torch.where(valid, index, 0).long()), 0)


def _shifted(image: Tensor, columns: int) -> Tensor:
    """`image` [N,C,H,W] moved to the right, with zeros from outside."""
    if columns < 0:
        return F.pad(image, (0, -columns))[..., -columns:]
    return F.pad(image, (columns, 0))[..., : image.shape[-1]]


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
            sampled = _shifted(wide_right, offset)
        else:
            sampled = _sample(wide_right, columns - _widen(disparity)[0] - offset)
        costs.append((wide_left - sampled).abs().sum(1))
    return torch.stack(costs, 1).to(left.dtype)


def soft_argmin(cost: Tensor, first: int = 0) -> Tensor:
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
        gate[:, 0, :, :1] = 0  # no neighbor above the first row
        gate[:, 2, :, -1:] = 0  # none below the last
        above, below = F.pad(h, (1, 0))[..., :-1], F.pad(h, (0, 1))[..., 1:]
        h = (1 - gate.sum(1)) * x[..., t] + gate[:, 0] * above + gate[:, 1] * h + gate[:, 2] * below
        columns.append(h)
    return torch.stack(columns, -1).to(input.dtype)


def batch_norm_relu(input: Tensor, weight: Tensor, bias: Tensor, *, eps: float = 1e-5) -> tuple[Tensor, Tensor, Tensor]:
    """relu(batch_norm(input)) by the batch's statistics, and its channels' means and variances"""
    axes = [0, *range(2, input.dim())]
    variance, mean = torch.var_mean(input.detach(), axes, correction=0)
    return F.relu(F.batch_norm(input, None, None, weight, bias, True, 0.0, eps)), mean, variance


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


def conv_chain(
    input: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor | None], *, relu_out: bool = False
) -> Tensor:
    """relu_out( last( ... relu( second( relu( first(input) ) ) ) ) )"""
    *layers, last = zip(weights, biases, strict=True)
    for weight, bias in layers:
        input = conv3x3(input, weight, bias, relu_out=True)
    return conv3x3(input, *last, relu_out=relu_out)


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


# Operators of the deployed network, which have gradients here; images are uint8 [H,W,3].


def _affine_relu(x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    channels = (-1, *[1] * (x.dim() - 2))
    return F.relu(scale.view(channels) * x + shift.view(channels))


def stem(
    left: Tensor,
    right: Tensor,
    mean: Tensor,
    weight_first: Tensor,
    bias_first: Tensor,
    weight_second: Tensor,
    scale: Tensor,
    shift: Tensor,
    *,
    input_scale: int = 1,
    multiple: int = 4,
) -> Tensor:
    """relu(scale * max_pool(conv(relu(conv(upsampled images - mean)))) + shift)"""
    x = torch.stack([left, right]).permute(0, 3, 1, 2).float() - mean[:, None, None]
    if input_scale > 1:
        x = F.interpolate(x, scale_factor=input_scale, mode="bilinear")
    x = F.pad(x, (0, -x.shape[3] % multiple, 0, -x.shape[2] % multiple), mode="replicate")
    x = F.relu(F.conv2d(x, weight_first, bias_first, padding=1))
    return max_pool(F.conv2d(x, weight_second, padding=1, stride=2), scale, shift)


def upsample_sum(
    maps: Sequence[Tensor],
    ratios: Sequence[int],
    height: int,
    width: int,
    *,
    gains: Sequence[float] = (),
    side: float = 0.0,
    out: Tensor | None = None,
) -> Tensor:
    """sum_i gains[i] * bilinear(maps[i]), cropped to height x width; the last map is smoothed first"""
    padded = F.pad(maps[-1][None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    rows = side * (padded[:-2] + padded[2:]) + (1 - 2 * side) * padded[1:-1]
    smooth = side * (rows[:, :-2] + rows[:, 2:]) + (1 - 2 * side) * rows[:, 1:-1]
    upsampled = [
        gain * F.interpolate(m[None, None], scale_factor=ratio, mode="bilinear")[0, 0, :height, :width]
        for m, ratio, gain in zip([*maps[:-1], smooth], ratios, gains or [1.0] * len(maps), strict=True)
    ]
    return torch.sum(torch.stack(upsampled), 0, out=out)


def upsample_concat(skip: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """relu(scale * cat([skip, upsampled coarse]) + shift)"""
    upsampled = F.interpolate(coarse, skip.shape[2:], mode="bilinear", align_corners=True)
    return _affine_relu(torch.cat([skip, upsampled], 1), scale, shift)


def upsample_add(input: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """relu(scale * (input + upsampled coarse) + shift)"""
    return _affine_relu(input + F.interpolate(coarse, input.shape[2:], mode="trilinear"), scale, shift)


def cost_volume_affine_relu(
    left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int, scale: Tensor, shift: Tensor
) -> Tensor:
    """relu(scale * cost_volume + shift), sample n with those at n % len(scale)"""
    volume = cost_volume(left, right, disparity, first, last)
    pairs = volume.view(len(volume) // len(scale), len(scale), *volume.shape[1:])
    return _affine_relu(pairs, scale, shift).flatten(0, 1)


def max_pool(input: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """relu(scale * max_pool2x2(input) + shift)"""
    return _affine_relu(F.max_pool2d(input, 2), scale, shift)


def normalized_propagation(
    input: Tensor,
    gates: Tensor,
    direction: int,
    *,
    propagation: Callable[[Tensor, Tensor, int], Tensor] = spatial_propagation,
) -> Tensor:
    """spatial_propagation with gates / (sum of the absolute values of each pixel's three + 1e-8)

    `propagation` may be the compiled operator.
    """
    return propagation(input, gates / (gates.abs().sum(1, keepdim=True) + 1e-8), direction)


def occlusion_distances(disparity: Tensor) -> tuple[Tensor, Tensor]:
    """By how many pixels each of [N,1,H,W], in pixels, lands left of the right image, and right of a nearer surface"""
    position = torch.arange(disparity.shape[-1], dtype=disparity.dtype, device=disparity.device) - disparity
    return -position, position - position.flip(-1).cummin(-1).values.flip(-1)


def occlusion_masks(disparity: Tensor) -> tuple[Tensor, Tensor]:
    """How much each pixel of [N,1,H,W], in pixels, is out of the right image's view, and how much occluded: 0 to 1"""
    outside, behind = occlusion_distances(disparity)
    # Over two pixels, so that rounding cannot make a pixel jump from one surface to another.
    return (outside / 2).clamp(0, 1), ((behind - 0.5) / 2).clamp(0, 1)


def fill_occlusions(
    disparity: Tensor, pixel: float, *, propagation: Callable[[Tensor, Tensor, int], Tensor] = spatial_propagation
) -> Tensor:
    """Pixels out of view take their right neighbor's disparity, then occluded ones their left neighbor's.

    Differentiable in the disparities that fill, not in the masks. `propagation` may be the compiled operator.
    """
    with torch.no_grad():
        out_of_view, occluded = occlusion_masks(disparity / pixel)
    for mask, direction in ((out_of_view, 1), (occluded * (1 - out_of_view), 0)):
        gates = F.pad(mask[:, None], (0, 0, 0, 0, 0, 0, 1, 1))  # only the neighbor in the same row
        disparity = propagation(disparity, gates, direction)
    return disparity


def window_extremes(disparity: Tensor, radius: int) -> tuple[Tensor, Tensor]:
    """The largest and the smallest of [N,1,H,W] within `radius` rows and columns of each pixel"""
    window = 2 * radius + 1
    return F.max_pool2d(disparity, window, 1, radius), -F.max_pool2d(-disparity, window, 1, radius)


def candidate_costs(
    features: Tensor,
    disparity: Tensor,
    groups: int,
    first: int,
    last: int,
    radius: int,
    *,
    volume: Callable[[Tensor, Tensor, Tensor, int, int], Tensor] = cost_volume,
) -> Tensor:
    """[groups' costs of the residuals, of the largest and of the smallest within the radius; left; their offsets]

    For any batch: features [2N,C,H,W], all left and then all right ones, disparity [N,1,H,W]; differentiable in both.
    `volume` may be the compiled cost volume.
    """
    n, c = len(disparity), features.shape[1]
    left, right = features.reshape(2, n * groups, c // groups, *features.shape[2:])
    extremes = window_extremes(disparity, radius)
    costs = [
        volume(left, right, around.repeat_interleave(groups, 0), *span).reshape(n, -1, *features.shape[2:])
        for around, span in zip((disparity, *extremes), ((first, last), (0, 0), (0, 0)), strict=True)
    ]
    return torch.cat([*costs, features[:n], *(extreme - disparity for extreme in extremes)], 1)


def expected_disparity(cost: Tensor, disparity: Tensor, offsets: Tensor, first: int) -> Tensor:
    """disparity + sum of softmax(-cost) * [first, first + 1, ..., offsets]; for any batch, differentiable in all"""
    probability = (-cost).softmax(1)
    steps = torch.arange(first, first + cost.shape[1] - 2, dtype=cost.dtype, device=cost.device)
    residual = (probability[:, :-2] * steps.view(-1, 1, 1)).sum(1, keepdim=True)
    residual = residual + probability[:, -2:-1] * offsets[:, :1] + probability[:, -1:] * offsets[:, 1:]
    return disparity + residual


def convex_upsampling(input: Tensor, logits: Tensor) -> Tensor:
    """pixel_shuffle(softmax of the logits and, for the pixel itself, 0; times the 3x3 around it); differentiable"""
    n, _, h, w = input.shape
    padded = F.pad(input, (1, 1, 1, 1), mode="replicate")
    around = torch.stack([padded[:, 0, i : i + h, j : j + w] for i in range(3) for j in range(3)], 1)
    logits = logits.view(n, 4, 8, h, w)
    own = torch.zeros_like(logits[:, :, :1])
    weights = torch.cat([logits[:, :, :4], own, logits[:, :, 4:]], 2).softmax(2)
    return F.pixel_shuffle((weights * around[:, None]).sum(2), 2)


def read_image(
    image: Tensor, mean: Tensor, std: Tensor, factor: int, height: int, width: int, *, block: int = 1
) -> Tensor:
    """pixel_unshuffle((bilinear(image / factor) - mean) / std, block), cropped to height x width"""
    images = image.permute(2, 0, 1)[None].float()
    h, w = factor * block * height, factor * block * width
    rows, columns = max(0, h - image.shape[0]), max(0, w - image.shape[1])
    images = F.pad(images, (0, columns, 0, rows), mode="replicate")[..., :h, :w]
    small = F.interpolate(images, scale_factor=1 / factor, mode="bilinear")
    return F.pixel_unshuffle((small - mean[:, None, None]) / std[:, None, None], block)


def refinement_guide(
    left: Tensor, right: Tensor, disparity: Tensor, mean: Tensor, std: Tensor, factor: int, *, block: int = 1
) -> Tensor:
    """[ read(left, factor / block), warp(read(right, factor), d) - read(left, factor), d ], d = disparity / factor"""
    size = disparity.shape[2:]
    small = disparity / factor
    seen = read_image(left, mean, std, factor // block, *size, block=block)
    near, far = (read_image(image, mean, std, factor, *size) for image in (left, right))
    return torch.cat([seen, warp(far, small) - near, small], 1)
