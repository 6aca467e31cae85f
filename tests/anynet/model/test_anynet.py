from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from networks import pair

from anynet import AnyNet, AnyNetConfig
from anynet.errors import AnyNetError
from anynet.model.anynet import resized
from anynet.model.config import FeaturesConfig, FirstStageConfig, RefinementConfig, ResidualStagesConfig
from anynet.model.layers import Convolution


@pytest.fixture
def model() -> AnyNet:
    torch.manual_seed(0)
    return AnyNet().eval()


def test_the_standard_network_has_the_papers_size(model: AnyNet) -> None:
    assert sum(p.numel() for p in model.parameters()) == 43_269
    assert model.config.stages == 4
    assert model.config.stride == 16


def test_each_stage_computes_only_its_own_part(model: AnyNet) -> None:
    """Counts the multiply-adds of convolutions between one estimate and the next."""
    height, width = 64, 128
    work = 0

    def count(module: Convolution, inputs: tuple[torch.Tensor], output: torch.Tensor) -> None:
        nonlocal work
        work += output.numel() * module.weight[0].numel()

    for module in model.modules():
        if isinstance(module, Convolution):
            module.register_forward_hook(count)
    pixels = height * width
    at = {scale: pixels // scale**2 for scale in (1, 2, 4, 8, 16)}
    unet_down = 27 * at[1] + 9 * at[2] + 9 * (2 + 4) * at[4] + 9 * (8 + 16) * at[8] + 9 * (32 + 64) * at[16]
    expected = [
        2 * unet_down + 12 * 27 * (16 + 4 * 256 + 16) * at[16],
        2 * 9 * (48 + 16) * at[8] + 5 * 27 * (4 + 4 * 16 + 4) * at[8],
        2 * 9 * (12 + 4) * at[4] + 5 * 27 * (4 + 4 * 16 + 4) * at[4],
        9 * (48 + 256 + 256 + 384 + 8 + 8) * at[4],
    ]
    estimates = model.stages(*pair(height, width))
    assert work == 0
    for stage in range(4):
        next(estimates)
        assert work == expected[stage], f"stage {stage + 1}"
        work = 0


@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 7), (16, 16), (33, 70), (47, 95)])
def test_any_size_gives_estimates_of_that_size(model: AnyNet, height: int, width: int) -> None:
    with torch.no_grad():
        estimates = model(*pair(height, width, batch=2))
    assert [e.shape for e in estimates] == [(2, 1, height, width)] * 4
    assert all(e.isfinite().all() for e in estimates)


def test_batch_entries_are_independent(model: AnyNet) -> None:
    left, right = pair(32, 64, batch=3)
    with torch.no_grad():
        together = model(left, right)
        alone = model(left[1:2], right[1:2])
    for a, b in zip(together, alone, strict=True):
        torch.testing.assert_close(a[1:2], b, rtol=1e-4, atol=1e-3)


def test_padding_reaches_no_further_than_the_receptive_field(model: AnyNet) -> None:
    """What lies beyond the right and bottom border does not change the estimates far from it."""
    left, right = pair(370, 500)
    beyond = [torch.nn.functional.pad(image, (0, 12, 0, 14), value=3.0) for image in (left, right)]  # to 384 x 512
    with torch.no_grad():
        for stage, (a, b) in enumerate(zip(model(left, right), model(*beyond), strict=True), start=1):
            height = 150 if stage < 4 else 50  # the left-to-right scan also carries values up, a row per column
            torch.testing.assert_close(a[..., :height, :50], b[..., :height, :50], rtol=1e-4, atol=1e-3)
            assert not torch.equal(a[..., -1, :], b[..., 369, :500])


def test_training_reaches_every_parameter() -> None:
    torch.manual_seed(0)
    model = AnyNet()
    estimates = model(*pair(64, 128, batch=2))
    torch.stack([e.square().mean() for e in estimates]).sum().backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        assert parameter.grad.abs().max() > 0, name


def test_input_scale_is_enlarging_the_images(wild_model: AnyNet) -> None:
    """Reducing the enlarged result is exact but where a kink of the last enlargement lies between the two pixels."""
    config = wild_model.config.with_input_scale(2)
    fine = AnyNet(replace(config, first_stage=wild_model.config.first_stage)).eval()
    fine.load_state_dict(wild_model.state_dict())
    images = pair(40, 72)
    with torch.no_grad():
        expected = wild_model(*(F.interpolate(image, scale_factor=2, mode="bilinear") for image in images), stages=2)
        for estimate, large in zip(fine(*images), expected, strict=False):
            torch.testing.assert_close(estimate, F.avg_pool2d(large, 2) / 2, rtol=1e-4, atol=1e-3)


def test_groups_of_equal_weight_are_one(wild_model: AnyNet) -> None:
    """The sum over groups of what each group's channels cost is what all channels cost."""
    groups = AnyNet(replace(wild_model.config, groups=2)).eval()
    state = groups.state_dict()
    for name, value in wild_model.state_dict().items():
        state[name] = value.expand(state[name].shape)  # the first layers of the disparity networks have two inputs
    groups.load_state_dict(state)
    images = pair(48, 80, batch=2)
    with torch.no_grad():
        for one, two in zip(wild_model(*images), groups(*images), strict=True):
            torch.testing.assert_close(two, one, rtol=1e-4, atol=1e-3)


def test_other_shapes_of_network() -> None:
    config = AnyNetConfig(
        features=FeaturesConfig(channels=2, blocks=1, layers=1),
        first_stage=FirstStageConfig(range=(0, 7), channels=3, layers=0),
        residual_stages=ResidualStagesConfig(ranges=((-1, 1),), channels=(2,), layers=0),
        refinement=RefinementConfig(channels=4, directions=(0, 1, 2, 3)),
    )
    with torch.no_grad():
        estimates = AnyNet(config).eval()(*pair(20, 30))
    assert [e.shape for e in estimates] == [(1, 1, 20, 30)] * 3


@pytest.mark.parametrize("input_scale", [0.5, 1.5, 3])
def test_any_input_scale_gives_estimates_of_the_images_size(model: AnyNet, input_scale: float) -> None:
    scaled = AnyNet(model.config.with_input_scale(input_scale)).eval()
    scaled.load_state_dict(model.state_dict())
    with torch.no_grad():
        estimates = scaled(*pair(37, 61))
    assert [e.shape for e in estimates] == [(1, 1, 37, 61)] * 4


@pytest.mark.parametrize(
    ("size", "scale"), [((96, 208), 0.5), ((97, 211), 0.7), ((375, 1242), 0.25), ((50, 33), 1 / 16)]
)
def test_images_shrink_as_opencv_shrinks_them(size: tuple[int, int], scale: float) -> None:
    image = np.random.default_rng(0).uniform(0, 255, (*size, 3)).astype(np.float32)
    small = resized(torch.from_numpy(image).permute(2, 0, 1)[None], scale)[0].permute(1, 2, 0).numpy()
    height, width = small.shape[:2]
    np.testing.assert_allclose(small, cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), atol=0.01)


@pytest.mark.parametrize("size", [(2, 20_000), (20_000, 2)])
def test_shrinking_takes_memory_in_proportion_to_the_image(size: tuple[int, int]) -> None:
    """A matrix of all pixels' shares would have 2e8 entries."""
    small = resized(torch.full((1, 1, *size), 3.0), 0.5)
    torch.testing.assert_close(small, torch.full((1, 1, size[0] // 2, size[1] // 2), 3.0))
    with torch.profiler.profile(profile_memory=True) as seen:
        resized(torch.zeros(1, 1, *size), 0.5)
    assert sum(max(0, event.self_cpu_memory_usage) for event in seen.events()) < 20e6  # bytes


def test_errors_name_what_came(model: AnyNet) -> None:
    left, right = pair(16, 16)
    with pytest.raises(AnyNetError, match=r"stages from 1 to 4, got 5"):
        model(left, right, stages=5)
    with pytest.raises(AnyNetError, match=r"\[1, 3, 16, 16\] and \[1, 3, 16, 15\]"):
        model(left, right[..., :15])
    with pytest.raises(AnyNetError, match=r"one shape \[N, 3, H, W\]"):
        model(left[0], right[0])
    for stages in (2.5, "2", True):
        with pytest.raises(AnyNetError, match=f"stages from 1 to 4, got {stages!r}"):
            model(left, right, stages=stages)


def test_an_empty_batch_and_the_meta_device(model: AnyNet) -> None:
    left, right = pair(32, 48)
    assert [d.shape for d in model(left[:0], right[:0])] == [(0, 1, 32, 48)] * 4
    with torch.device("meta"):
        assert [d.shape for d in AnyNet()(left.to("meta"), right.to("meta"))] == [(1, 1, 32, 48)] * 4


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_weights_are_refused(dtype: torch.dtype) -> None:
    images = torch.zeros(2, 1, 3, 32, 48, dtype=dtype)
    expected = rf"^AnyNet: expected weights of float32 or float64, got {str(dtype)[6:]}: .* torch.autocast$"
    with pytest.raises(AnyNetError, match=expected):
        AnyNet().to(dtype)(*images)
    with torch.autocast("cpu"):
        assert all(estimate.isfinite().all() for estimate in AnyNet()(*images.float()))
