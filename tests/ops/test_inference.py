"""The operators of the inference graph."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from anynet_ext import _inference as inference
from anynet_ext import reference


def random(*shape: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))


def image(height: int, width: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(height * width + seed)
    return torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=generator)


@pytest.fixture(params=[1, 2, 5], autouse=True)
def threads(request: pytest.FixtureRequest) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield
    torch.set_num_threads(before)


def check(name: str, *args: object, rtol: float | None = 1e-4, atol: float | None = 1e-4, **options: float) -> None:
    expected = getattr(reference, name)(*args, **options)
    assert_close(getattr(inference, name)(*args, **options), expected, rtol=rtol, atol=atol)


@pytest.mark.parametrize("input_scale", [1, 2])
@pytest.mark.parametrize("multiple", [4, 16])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (4, 4), (5, 7), (32, 64), (37, 130), (64, 273)])
def test_stem(height: int, width: int, channels: int, multiple: int, input_scale: int) -> None:
    images = image(height, width), image(height, width, seed=1)
    first = 100 + random(3), random(channels, 3, 3, 3) / 100, random(channels)
    second = random(channels, channels, 3, 3), random(channels), random(channels)
    check("stem", *images, *first, *second, input_scale=input_scale, multiple=multiple)


@pytest.mark.parametrize("crop", [0, 3])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 2), (3, 1), (2, 5), (5, 37)])
def test_upsample_sum(height: int, width: int, crop: int) -> None:
    ratios = [16, 8, 4, 2, 1]
    maps = [random(height * 16 // ratio, width * 16 // ratio) for ratio in ratios]
    check("upsample_sum", maps, ratios, 16 * height - crop, 16 * width - crop, gain=1 / 8, atol=1e-5)


@pytest.mark.parametrize("size", [(1, 1), (2, 2), (7, 19), (10, 64)])
@pytest.mark.parametrize("coarse_size", [(1, 1), (1, 3), (4, 10), (5, 32)])
def test_upsample_concat(size: tuple[int, int], coarse_size: tuple[int, int]) -> None:
    check("upsample_concat", random(2, 3, *size), random(2, 4, *coarse_size), random(7), random(7), atol=1e-5)


@pytest.mark.parametrize("size", [(1, 1, 1), (2, 2, 3), (5, 7, 19), (4, 10, 64)])
@pytest.mark.parametrize("coarse_size", [(1, 1, 1), (3, 1, 2), (2, 5, 32)])
def test_upsample_add(size: tuple[int, int, int], coarse_size: tuple[int, int, int]) -> None:
    check("upsample_add", random(2, 3, *size), random(2, 3, *coarse_size), random(3), random(3), atol=1e-5)


@pytest.mark.parametrize("around", [False, True])
@pytest.mark.parametrize("groups", [1, 2])
@pytest.mark.parametrize("shape", [(2, 3, 5, 70), (4, 1, 1, 1), (0, 2, 3, 4), (2, 2, 3, 0)])
def test_cost_volume_affine_relu(shape: tuple[int, ...], groups: int, around: bool) -> None:
    disparity = 3 * random(1, 1, *shape[2:]).expand(shape[0], -1, -1, -1) if around else None
    affine = random(groups), random(groups + 1)[1:].clone()
    check("cost_volume_affine_relu", random(*shape), random(*shape) + 1, disparity, -1, 6, *affine, atol=1e-5)


@pytest.mark.parametrize("size", [(2, 2), (5, 3), (12, 70)])
def test_max_pool(size: tuple[int, int]) -> None:
    check("max_pool", random(2, 3, *size), random(3), random(3), rtol=None, atol=None)


@pytest.mark.parametrize("direction", [0, 1, 2, 3])
@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (3, 2, 5, 17), (1, 8, 30, 40), (0, 2, 2, 2), (1, 2, 0, 3)])
def test_normalized_propagation(shape: tuple[int, ...], direction: int) -> None:
    gates = random(shape[0], 3, *shape[1:])
    gates[..., -1] = 0  # nothing to normalise
    check("normalized_propagation", random(*shape), gates, direction, rtol=None, atol=None)


@pytest.mark.parametrize("pixel", [1.0, 4.0])
@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (2, 1, 5, 70), (1, 1, 90, 300), (0, 1, 4, 4), (1, 1, 3, 0)])
def test_fill_occlusions(shape: tuple[int, ...], pixel: float) -> None:
    steps = (random(*shape) > 1).float() * 20 * random(*shape[:3], 1).abs()
    check("fill_occlusions", pixel * (10 + random(*shape) + steps), pixel)


@pytest.mark.parametrize("radius", [0, 1, 2, 5])
@pytest.mark.parametrize("groups", [1, 2])
@pytest.mark.parametrize("size", [(1, 1), (5, 70), (3, 4), (12, 33)])
def test_candidate_costs(size: tuple[int, int], groups: int, radius: int) -> None:
    check("candidate_costs", random(2, 4, *size), 5 * random(1, 1, *size), groups, -2, 1, radius, atol=1e-5)


@pytest.mark.parametrize("shape", [(1, 2, 1, 1), (1, 7, 5, 70), (1, 9, 3, 16), (1, 3, 40, 33)])
def test_expected_disparity(shape: tuple[int, ...]) -> None:
    cost, disparity, offsets = 5 * random(*shape), random(1, 1, *shape[2:]), 10 * random(1, 2, *shape[2:])
    cost[..., ::3] *= 100  # one residual alone
    check("expected_disparity", cost, disparity, offsets, -3, atol=1e-5)


@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (2, 1, 5, 70), (1, 1, 3, 16), (1, 1, 40, 33), (0, 1, 4, 4)])
def test_convex_upsampling(shape: tuple[int, ...]) -> None:
    logits = 3 * random(shape[0], 32, *shape[2:])
    logits[..., ::3] *= 100  # one neighbour alone
    check("convex_upsampling", random(*shape), logits, atol=1e-5)


@pytest.mark.parametrize("block", [1, 2])
@pytest.mark.parametrize("factor", [1, 2, 4])
@pytest.mark.parametrize(("height", "width"), [(4, 4), (16, 20), (1, 1), (37, 61)])
def test_read_image(height: int, width: int, factor: int, block: int) -> None:
    size = -(-height // (factor * block)), -(-width // (factor * block))
    check("read_image", image(height, width), random(3), random(3).abs() + 1, factor, *size, block=block)


def test_operators_are_good_citizens() -> None:
    ops = torch.ops.anynet
    for op, args in (
        (
            ops.stem,
            (
                image(8, 8),
                image(8, 8),
                random(3),
                random(2, 3, 3, 3),
                random(2),
                random(2, 2, 3, 3),
                random(2),
                random(2),
                2,
                16,
            ),
        ),
        (ops.upsample_sum, ([random(2, 3), random(4, 6)], [4, 2], 0.5, 8, 11)),
        (ops.upsample_concat, (random(1, 2, 4, 4), random(1, 1, 2, 2), random(3), random(3))),
        (ops.upsample_add, (random(1, 2, 2, 4, 4), random(1, 2, 1, 2, 2), random(2), random(2))),
        (ops.cost_volume_affine_relu, (*random(2, 2, 1, 4, 9), random(2, 1, 4, 9), 0, 3, random(2), random(2))),
        (ops.max_pool, (random(1, 2, 4, 4), random(2), random(2))),
        (ops.normalized_propagation, (random(1, 2, 4, 4), random(1, 3, 2, 4, 4), 2)),
        (ops.fill_occlusions, (10 * random(1, 1, 4, 30), 2.0)),
        (ops.candidate_costs, (random(2, 4, 4, 30), random(1, 1, 4, 30), 2, -2, 2, 2)),
        (ops.expected_disparity, (random(1, 5, 4, 30), random(1, 1, 4, 30), random(1, 2, 4, 30), -1)),
        (ops.convex_upsampling, (random(2, 1, 4, 5), random(2, 32, 4, 5))),
        (ops.read_image, (image(8, 8), random(3), random(3), 4, 1, 2, 2)),
        (ops.read_image, (image(8, 8), random(3), random(3), 1, 2, 4, 4)),
    ):
        torch.library.opcheck(op.default, args)


def test_no_gradients() -> None:
    with pytest.raises(RuntimeError, match="no gradients"):
        inference.normalized_propagation(random(1, 1, 2, 2).requires_grad_(), random(1, 3, 1, 2, 2), 0).sum().backward()


def test_errors() -> None:
    weights = random(3), random(2, 3, 3, 3), random(2), random(2, 2, 3, 3), random(2), random(2)
    with pytest.raises(RuntimeError, match=r"images of one size, got \[8, 8, 3\] and \[8, 9, 3\]"):
        inference.stem(image(8, 8), image(8, 9), *weights)
    with pytest.raises(RuntimeError, match=r"contiguous uint8 image of shape \[H, W, 3\], got \[8, 8\]"):
        inference.stem(image(8, 8)[..., 0], image(8, 8), *weights)
    with pytest.raises(RuntimeError, match="input_scale 1 or 2, got 3"):
        inference.stem(image(8, 8), image(8, 8), *weights, input_scale=3)
    with pytest.raises(RuntimeError, match="multiple of 4, got 6"):
        inference.stem(image(8, 8), image(8, 8), *weights, multiple=6)
    with pytest.raises(RuntimeError, match=r"weight_second of shape \[2, 2, 3, 3\], got \[1, 1, 3, 3\]"):
        inference.stem(image(8, 8), image(8, 8), *weights[:3], random(1, 1, 3, 3), *weights[4:])
    with pytest.raises(RuntimeError, match=r"maps that cover 9 x 8, got \[2, 2\] times 4"):
        inference.upsample_sum([random(2, 2)], [4], 9, 8)
    with pytest.raises(RuntimeError, match="power of two, got 3"):
        inference.upsample_sum([random(2, 2)], [3], 6, 6)
    with pytest.raises(RuntimeError, match="1 to 8 maps and as many ratios, got 9 and 9"):
        inference.upsample_sum([random(2, 2)] * 9, [4] * 9, 8, 8)
    with pytest.raises(RuntimeError, match=r"scale of shape \[3\], got \[2\]"):
        inference.upsample_concat(random(1, 2, 4, 4), random(1, 1, 2, 2), random(2), random(2))
    with pytest.raises(RuntimeError, match=r"coarse of input's batch size and channels.* got \[1, 3, 1, 2, 2\]"):
        inference.upsample_add(random(1, 2, 2, 4, 4), random(1, 3, 1, 2, 2), random(2), random(2))
    with pytest.raises(RuntimeError, match=r"a scale for each of left's groups, got 2 for left \[3, 1, 2, 2\]"):
        inference.cost_volume_affine_relu(*random(2, 3, 1, 2, 2), None, 0, 3, random(2), random(2))
    with pytest.raises(RuntimeError, match="cost_volume_affine_relu: expected first <= last, got first 3 and last 0"):
        inference.cost_volume_affine_relu(*random(2, 2, 1, 2, 2), None, 3, 0, random(2), random(2))
    with pytest.raises(RuntimeError, match="input as contiguous float32 tensor of 4 dimensions"):
        inference.max_pool(random(2, 4, 4), random(2), random(2))
    with pytest.raises(RuntimeError, match=r"gates of shape \[1, 3, 1, 2, 2\], got \[1, 2, 1, 2, 2\]"):
        inference.normalized_propagation(random(1, 1, 2, 2), random(1, 2, 1, 2, 2), 0)
    with pytest.raises(RuntimeError, match="normalized_propagation: expected direction 0, 1, 2 or 3, got 4"):
        inference.normalized_propagation(random(1, 1, 2, 2), random(1, 3, 1, 2, 2), 4)
    with pytest.raises(RuntimeError, match="contiguous float32"):
        inference.normalized_propagation(random(1, 1, 2, 2).double(), random(1, 3, 1, 2, 2).double(), 0)
    with pytest.raises(RuntimeError, match="disparity as contiguous float32 tensor of 4 dimensions"):
        inference.fill_occlusions(random(3, 4), 1.0)
    with pytest.raises(RuntimeError, match="pixel above 0, got 0"):
        inference.fill_occlusions(random(1, 1, 3, 4), 0.0)
    features, disparity = random(2, 4, 3, 5), random(1, 1, 3, 5)
    with pytest.raises(RuntimeError, match=r"features of shape \[2, 4, 3, 5\], got \[1, 4, 3, 5\]"):
        inference.candidate_costs(features[:1], disparity, 2, -2, 2, 1)
    with pytest.raises(RuntimeError, match=r"disparity of shape \[1, 1, 3, 5\], got \[1, 4, 3, 5\]"):
        inference.candidate_costs(features, features[:1], 2, -2, 2, 1)
    with pytest.raises(RuntimeError, match="groups to divide the 4 channels, got 3"):
        inference.candidate_costs(features, disparity, 3, -2, 2, 1)
    with pytest.raises(RuntimeError, match="first <= last, got first 2 and last -2"):
        inference.candidate_costs(features, disparity, 2, 2, -2, 1)
    with pytest.raises(RuntimeError, match="radius of 0 or more, got -1"):
        inference.candidate_costs(features, disparity, 2, -2, 2, -1)
    with pytest.raises(RuntimeError, match=r"cost of shape \[1, 2 or more, H, W\], got \[1, 1, 3, 5\]"):
        inference.expected_disparity(disparity, disparity, disparity, 0)
    with pytest.raises(RuntimeError, match=r"offsets of shape \[1, 2, 3, 5\], got \[1, 1, 3, 5\]"):
        inference.expected_disparity(features[:1], disparity, disparity, 0)
    with pytest.raises(RuntimeError, match="at least one pixel"):
        inference.read_image(image(8, 8), random(3), random(3), 4, 0, 2)
    with pytest.raises(RuntimeError, match="factor 1, 2 or 4, got 3"):
        inference.read_image(image(8, 8), random(3), random(3), 3, 2, 2)
    with pytest.raises(RuntimeError, match="block 1 or 2, got 3"):
        inference.read_image(image(8, 8), random(3), random(3), 1, 2, 2, block=3)
    with pytest.raises(RuntimeError, match=r"input of shape \[1, 1, 2, 2\], got \[1, 2, 2, 2\]"):
        inference.convex_upsampling(random(1, 2, 2, 2), random(1, 32, 2, 2))
    with pytest.raises(RuntimeError, match=r"logits of shape \[1, 32, 2, 2\], got \[1, 36, 2, 2\]"):
        inference.convex_upsampling(random(1, 1, 2, 2), random(1, 36, 2, 2))
