from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from networks import wild
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from anynet import AnyNet, AnyNetConfig, load_checkpoint
from anynet.checkpoint import PACKAGED
from anynet.model import presets
from anynet.model.anynet import normalize
from anynet.model.config import FeaturesConfig, FirstStageConfig, RefinementConfig, ResidualStagesConfig
from anynet.model.deploy import DeployedAnyNet
from anynet.model.layers import DeployedConvolution
from anynet.model.residual_stage import DeployedCandidateStage, DeployedResidualStage
from anynet_ext import reference


def images(height: int, width: int) -> tuple[Tensor, Tensor]:
    random = torch.Generator().manual_seed(height)
    left, right = (torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=random) for _ in range(2))
    return left, right


def test_a_stage_is_computed_when_it_is_asked_for(wild_model: AnyNet) -> None:
    network = DeployedAnyNet(wild_model)
    called: list[str] = []
    for name, part in network.named_children():
        part.register_forward_hook(lambda *_, name=name: called.append(name))
    for stage in network.residual_stages:
        stage.register_forward_hook(lambda *_: called.append("residual"))
    steps = network.stages(*images(32, 48))
    assert called == []
    for expected in (["first_stage"], ["residual"], ["residual"], ["refinement"]):
        next(steps)
        assert called == expected
        called.clear()


def test_forward_gives_the_first_stages(wild_model: AnyNet) -> None:
    network, pair = DeployedAnyNet(wild_model), images(37, 61)
    every = network(*pair)
    assert [d.shape for d in every] == [(37, 61)] * 4
    for stages in range(1, 5):
        for one, other in zip(network(*pair, stages=stages), every[:stages], strict=True):
            assert torch.equal(one, other)


def test_nothing_of_it_can_be_trained(wild_candidate_model: AnyNet) -> None:
    network = DeployedAnyNet(wild_candidate_model)
    assert not list(network.parameters())
    assert all(not buffer.requires_grad for buffer in network.buffers())


def test_it_does_not_change_with_the_model_it_was_made_of() -> None:
    model = AnyNet(AnyNetConfig()).eval()
    network, pair = DeployedAnyNet(model), images(32, 48)
    before = network(*pair)
    for norm in model.modules():
        if isinstance(norm, (torch.nn.BatchNorm2d, torch.nn.BatchNorm3d)):
            norm.reset_running_stats()
    assert all(torch.equal(one, other) for one, other in zip(network(*pair), before, strict=True))


@pytest.mark.parametrize("convex", [False, True])
@pytest.mark.parametrize("radius", [0, 1])
@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("blocks", [1, 2, 3])
def test_it_gives_what_the_module_does_of_any_shape(blocks: int, dims: int, radius: int, convex: bool) -> None:
    config = AnyNetConfig(
        features=FeaturesConfig(channels=2, blocks=blocks),
        first_stage=FirstStageConfig(dims=dims, channels=8, hourglass=1),
        residual_stages=ResidualStagesConfig(
            ranges=((-2, 2),) * blocks, channels=(4,) * blocks, candidate_radius=radius
        ),
        refinement=RefinementConfig(convex_upsampling=convex),
    )
    model, (left, right) = wild(config), shifted_texture()
    with torch.no_grad():  # in float64: in float32, these networks' rounding is as large on either side
        found = DeployedAnyNet(model)(left, right)
        expected = model.double()(*(normalize(image.permute(2, 0, 1)[None].double()) for image in (left, right)))
    for one, other in zip(found, expected, strict=True):
        assert (one - other[0, 0]).abs().max() < 0.02


@pytest.mark.parametrize(("weights", "kind"), [("paper", DeployedResidualStage), ("large", DeployedCandidateStage)])
def test_packaged_weights_are_deployed_part_by_part(weights: str, kind: type) -> None:
    network = DeployedAnyNet(load_checkpoint(weights))
    assert [type(stage) for stage in network.residual_stages] == [kind, kind]
    assert all(torch.isfinite(disparity).all() for disparity in network(*images(48, 80)))


class Redirected(TorchDispatchMode):
    """Has other implementations stand in for the operators `anynet::*`, and counts what PyTorch's own would launch."""

    def __init__(self, implementation: Callable[[Any], Callable[..., Tensor]]) -> None:
        super().__init__()
        self.implementation, self.launches = implementation, 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func.namespace == "anynet":
            return self.implementation(func)(*args, **(kwargs or {}))
        aliases = [result.alias_info for result in func._schema.returns]
        views = all(alias is not None and not alias.is_write for alias in aliases)
        self.launches += not views and "empty" not in func._opname
        return func(*args, **(kwargs or {}))


def as_cuda_kernels(func: Any) -> Callable[..., Tensor]:
    operator: Callable[..., Tensor] = getattr(torch.ops.anynet_cuda_emulated, func._opname).default
    return operator


def shifted_texture() -> tuple[Tensor, Tensor]:
    """At a disparity of 6 pixels: where networks are sure of what they say."""
    random = torch.Generator().manual_seed(0)
    texture = torch.rand(1, 3, 16, 36, generator=random)
    scene = 255 * F.interpolate(texture, (48, 108), mode="bicubic").clamp(0, 1)[0].permute(1, 2, 0)
    left, right = (scene[:, x : x + 96].to(torch.uint8).contiguous() for x in (0, 6))
    return left, right


def check_redirected(weights: str, mode: Redirected) -> None:
    network, pair = DeployedAnyNet(load_checkpoint(weights)), shifted_texture()
    with torch.inference_mode():
        expected = network(*pair)
        with mode:
            found = network(*pair)
    for one, other in zip(found, expected, strict=True):
        assert (one - other).abs().max() < 1e-4


@pytest.mark.parametrize("weights", [file.stem for file in sorted(PACKAGED.glob("*.safetensors"))])
def test_its_operators_in_plain_pytorch_give_the_same(weights: str) -> None:
    check_redirected(weights, Redirected(reference.of))


class HalfConvolutions(Redirected):
    """Counts PyTorch's convolutions in half precision, and sees that nothing else is given anything but float32."""

    def __init__(self) -> None:
        super().__init__(lambda func: func)
        self.convolutions = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        dtypes = {leaf.dtype for leaf in torch.utils._pytree.tree_leaves([args, kwargs]) if isinstance(leaf, Tensor)}
        if func.namespace == "anynet":
            assert dtypes <= {torch.float32, torch.uint8}, func
        elif func._opname in ("conv2d", "conv3d"):
            assert dtypes in ({torch.bfloat16}, {torch.float16})
            self.convolutions += 1
        return super().__torch_dispatch__(func, types, args, kwargs)


@pytest.mark.parametrize("precision", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize(("weights", "convolutions"), [("paper", 8), ("default", 35)])
def test_half_precision_moves_disparities_by_hundredths_of_pixels(
    weights: str, convolutions: int, precision: torch.dtype
) -> None:
    model, pair = load_checkpoint(weights), shifted_texture()
    with torch.inference_mode():
        expected = DeployedAnyNet(model)(*pair)
        with HalfConvolutions() as mode:
            found = DeployedAnyNet(model, precision)(*pair)
    assert mode.convolutions == convolutions
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == torch.float32
        assert 0 < (one - other).abs().mean() < (0.1 if precision == torch.bfloat16 else 0.02)


@pytest.mark.parametrize("weights", ["paper", "default"])
def test_wide_convolutions_by_pytorch_give_the_same(weights: str) -> None:
    model, pair = load_checkpoint(weights), shifted_texture()
    own, mixed = DeployedAnyNet(model), DeployedAnyNet(model, torch.float32)
    parts = [part for part in mixed.modules() if isinstance(part, DeployedConvolution)]
    assert {part._ours for part in parts} == {True, False}
    for one, other in zip(mixed(*pair), own(*pair), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("weights", ["default", "large"])
def test_its_cuda_kernels_emulated_give_the_same(emulated_operators: None, weights: str) -> None:
    check_redirected(weights, Redirected(as_cuda_kernels))


@pytest.mark.slow
def test_four_stages_of_the_papers_network_are_forty_launches(emulated_operators: None) -> None:
    network, pair = DeployedAnyNet(AnyNet(presets.filled()).eval()), images(32, 64)
    before = torch.ops.anynet_cuda_emulated.launches()
    with torch.inference_mode(), Redirected(as_cuda_kernels) as mode:
        *_, result = network.stages(*pair)
        result()
    launches = mode.launches + torch.ops.anynet_cuda_emulated.launches() - before
    assert 20 < launches <= 40
