"""The networks that AnyNet is compared with: size, protocol, reach, and equality with themselves in plain PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from unittest import mock

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from anynet.baselines import MODELS, Baseline, PSMNet, StereoNet, dispnet, layers, psmnet, stereodnn, stereonet
from anynet.errors import AnyNetError
from anynet.model import layers as model_layers
from anynet_ext import reference

OPERATORS = ("batch_norm_relu", "conv3x3", "conv3x3x3", "resize", "soft_argmin", "warp")

# What each network uses of the operators.
USED = {
    "psmnet": set(OPERATORS),
    "psmnet-basic": set(OPERATORS),
    "stereonet-8x": set(OPERATORS) - {"batch_norm_relu"},
    "stereonet-16x": set(OPERATORS) - {"batch_norm_relu"},
    "dispnetc": {"conv3x3", "resize", "warp"},
    "resnet18-2d": {"conv3x3", "soft_argmin", "warp"},
    "nvtiny": {"conv3x3", "conv3x3x3", "soft_argmin", "warp"},
}
SMALL = {name: partial(builder, 16) for name, builder in MODELS.items()}


def build(name: str, max_disparity: int = 192) -> Baseline:
    return MODELS[name](max_disparity)


def _parameters(builder: Callable[[], Baseline]) -> int:
    with torch.device("meta"):  # no memory, no random numbers
        return sum(parameter.numel() for parameter in builder().parameters())


def test_the_registry_is_tested_whole():
    assert set(USED) == set(MODELS)


@pytest.mark.parametrize(
    ("builder", "published", "tolerance"),
    [
        # What the authors' program prints (JiaRenChang/PSMNet).
        (lambda: build("psmnet"), 5_224_768, 0),
        # DenseMatchingBenchmark's tables give these for networks with one refinement and with three.
        (lambda: StereoNet(single=True), 399_066, 100),
        (lambda: build("stereonet-8x"), 624_860, 100),
        # FADNet's paper (arXiv 2003.10758), Table II, says 42 million.
        (lambda: build("dispnetc", 160), 42_000_000, 500_000),
    ],
)
def test_parameters_as_published(builder, published, tolerance):
    assert abs(_parameters(builder) - published) <= tolerance


def _weights(*layers: tuple[int, int, int], bias: bool = True) -> int:
    """Parameters of convolutions (inputs, outputs, taps)."""
    return sum(inputs * outputs * taps + bias * outputs for inputs, outputs, taps in layers)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (
            "resnet18-2d",
            _weights((3, 32, 25), *[(32, 32, 9)] * 17)
            + _weights((33, 32, 9), (32, 32, 9), (32, 64, 9), *[(64, 64, 9)] * 2, (64, 128, 9), *[(128, 128, 9)] * 2)
            + _weights((128, 64, 9), (64, 32, 9), (32, 1, 9)),
        ),
        (
            "nvtiny",
            _weights((3, 32, 25), *[(32, 32, 9)] * 3, (32, 8, 9))
            + _weights(*[(16, 16, 27)] * 2, (16, 32, 27), *[(32, 32, 27)] * 2, (32, 64, 27), *[(64, 64, 27)] * 2)
            + _weights((64, 32, 27), (32, 16, 27), (16, 1, 27)),
        ),
        # One more halving and one more refinement than 8x has.
        (
            "stereonet-16x",
            624_836
            + _weights((32, 32, 25))
            + _weights((4, 32, 9))
            + 64
            + 12 * (32 * 32 * 9 + 64)
            + _weights((32, 1, 9)),
        ),
        # The stacked network without hourglasses and two of its heads, but with three more residual pairs.
        (
            "psmnet-basic",
            5_224_768
            - 3 * (27 * (32 * 64 + 64 * 64 * 4 + 64 * 32) + 5 * 128 + 64)
            - 2 * (27 * (32 * 32 + 32) + 64)
            + 6 * (27 * 32 * 32 + 64),
        ),
    ],
)
def test_parameters_by_the_table_of_layers(name, expected):
    assert _parameters(partial(build, name)) == expected


def test_the_same_parameters_whatever_the_range_but_in_the_correlation():
    for name, small in SMALL.items():
        difference = _parameters(partial(build, name)) - _parameters(small)
        assert difference == ((192 - 16) // 4 * 256 * 25 if name == "dispnetc" else 0), name


@pytest.mark.parametrize("name", MODELS)
def test_any_size_goes_in_and_comes_out(name):
    model = SMALL[name]()
    left, right = torch.randn(2, 2, 3, 19, 37).unbind()
    estimates = model(left, right)
    assert len(estimates) == len(model.loss_weights)
    assert all(estimate.shape == (2, 1, 19, 37) and estimate.isfinite().all() for estimate in estimates)
    model.eval()
    with torch.inference_mode():
        (estimate,) = model(left, right)
        (alone,) = model(left[1:], right[1:])
    assert estimate.shape == (2, 1, 19, 37)
    torch.testing.assert_close(estimate[1:], alone, rtol=1e-3, atol=1e-3)
    with pytest.raises(AnyNetError, match=r"expected two images of one shape \[N, 3, H, W\], got"):
        model(left, right[..., :-1])
    with pytest.raises(AnyNetError, match="expected max_disparity >= 1, got 0"):
        build(name, 0)


@pytest.mark.parametrize("name", ["psmnet", "psmnet-basic", "resnet18-2d", "nvtiny"])
def test_estimates_stay_in_the_range(name):
    model = SMALL[name]().eval()
    with torch.inference_mode():
        (estimate,) = model(*torch.randn(2, 1, 3, 32, 64).mul(5).unbind())
    assert estimate.min() >= 0
    assert estimate.max() <= 16
    assert estimate.std() > 0


class Recorder(TorchDispatchMode):
    """Names of this package's operators that are called."""

    def __init__(self) -> None:
        super().__init__()
        self.called: set[str] = set()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        namespace, _, name = function.name().partition("::")
        if namespace == "anynet" and "backward" not in name:
            self.called.add(name.partition(".")[0])
        return function(*args, **(kwargs or {}))


@contextmanager
def plain_pytorch() -> Iterator[None]:
    """The networks compute on PyTorch's own operators."""
    with ExitStack() as stack:
        for module in (layers, psmnet, stereonet, dispnet, stereodnn, model_layers):
            own = {name: getattr(reference, name) for name in OPERATORS if hasattr(module, name)}
            if module is not model_layers:
                own = {name: _like(name) for name in own}
            stack.enter_context(mock.patch.multiple(module, **own))
        yield


def _like(name: str):
    function = getattr(reference, name)
    return partial(function, first=0) if name == "soft_argmin" else function


def _results(model: Baseline, left: Tensor, right: Tensor) -> tuple[set[str], list[Tensor]]:
    """Operators called; estimates, gradients of both images and of every parameter."""
    left, right = left.clone().requires_grad_(), right.clone().requires_grad_()
    recorder = Recorder()
    with recorder:
        estimates = model(left, right)
    weights = torch.Generator().manual_seed(1)
    total = sum((e * torch.randn(e.shape, generator=weights, dtype=e.dtype)).sum() for e in estimates)
    assert isinstance(total, Tensor)
    parameters = list(model.parameters())
    gradients = torch.autograd.grad(total, [left, right, *parameters], allow_unused=not model.training)
    return recorder.called, [*estimates, *(g for g in gradients if g is not None)]


# In eval mode those with batch norms are others than in training.
@pytest.mark.parametrize(
    ("name", "training"), [*((name, True) for name in MODELS), ("psmnet", False), ("stereonet-8x", False)]
)
def test_equals_itself_in_plain_pytorch(name, training):
    torch.manual_seed(0)
    model = SMALL[name]().double().train(training)
    # Two pairs, so that no batch norm, whose result is only a sign then, has two values alone.
    left, right = torch.randn(2, 2, 3, 16, 32, dtype=torch.float64).unbind()
    state = {key: value.clone() for key, value in model.state_dict().items()}
    used, own = _results(model, left, right)
    assert used == (USED[name] if training else USED[name] - {"batch_norm_relu"})
    tracked = {key: value.clone() for key, value in model.state_dict().items()}
    model.load_state_dict(state)
    with plain_pytorch():
        used, plain = _results(model, left, right)
    assert used == set()
    assert len(own) == len(plain) > 2
    largest = max(float(theirs.detach().abs().max()) for theirs in plain)
    for mine, theirs in zip(own, plain, strict=True):  # a bias added to all costs alike has no gradient but rounding
        torch.testing.assert_close(mine, theirs, rtol=1e-6, atol=1e-10 * largest)
    for key, value in model.state_dict().items():
        torch.testing.assert_close(tracked[key], value)


def test_gradients_are_derivatives():
    """By differences, of the networks' own parts: the layer, each volume, the enlargement."""
    torch.manual_seed(0)
    left, right = torch.randn(2, 1, 2, 2, 4, dtype=torch.float64, requires_grad=True)
    for volume in (layers.concatenation_volume, layers.difference_volume, layers.correlation_volume):
        assert torch.autograd.gradcheck(lambda *views, v=volume: v(*views, 3), (left, right))
    cost = torch.randn(1, 2, 2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda c: layers.trilinear(c, (4, 4, 6)), cost)
    for dims, transposed, training in [(2, False, True), (3, False, False), (2, True, False), (3, True, True)]:
        layer = layers.Layer(
            2, 3, dims=dims, stride=2, norm=True, bias=True, activation=layers.elu, transposed=transposed
        ).double()
        # Enlarged to twice the size: the derivatives of 8 x 8 x 8 values take seconds.
        x = torch.randn(2, 2, *[2 if transposed else 4] * dims, dtype=torch.float64, requires_grad=True)
        layer(x)  # moves the statistics
        layer.train(training)
        parameters = [p.detach().clone().requires_grad_() for p in layer.parameters()]
        names = [name for name, _ in layer.named_parameters()]

        def run(x, *values, layer=layer, names=names):
            return torch.func.functional_call(layer, dict(zip(names, values, strict=True)), x)

        assert torch.autograd.gradcheck(run, (x, *parameters), atol=1e-4)


def test_volumes_by_hand():
    left = torch.tensor([[[[1.0, 2, 3]], [[0, 1, 0]]]])
    right = torch.tensor([[[[5.0, 7, 9]], [[1, 1, 1]]]])
    assert layers.concatenation_volume(left, right, 2)[0, :, :, 0].tolist() == [
        [[1, 2, 3], [1, 2, 3]],
        [[0, 1, 0], [0, 1, 0]],
        [[5, 7, 9], [0, 5, 7]],
        [[1, 1, 1], [0, 1, 1]],
    ]
    assert layers.difference_volume(left, right, 2)[0, 0, :, 0].tolist() == [[-4, -5, -6], [1, -3, -4]]
    assert layers.correlation_volume(left, right, 2)[0, :, 0].tolist() == [[5, 15, 27], [0, 11, 21]]


def test_trilinear_is_pytorchs():
    volume = torch.randn(2, 3, 4, 5)
    expected = torch.nn.functional.interpolate(volume[:, None], (12, 16, 20), mode="trilinear")[:, 0]
    torch.testing.assert_close(layers.trilinear(volume, (12, 16, 20)), expected)


@dataclass(frozen=True)
class Reach:
    """What the layers say: `of` columns to either side, `more` for enlargements and strides, and the disparities."""

    of: int
    more: int
    range: int
    stride: int


def _refinement(scale: int) -> int:
    return scale * (1 + 2 * (1 + 2 + 4 + 8 + 1 + 1) + 1)


REACHES = {
    # Features; filter; refinements at 1/4, 1/2 and 1.
    "stereonet-8x": Reach(
        2 * (1 + 2 + 4) + 8 * 13 + 8 * 5 + sum(map(_refinement, (4, 2, 1))), 8 * 2 + 4 * 2 + 2, (2 - 1) * 8, 8
    ),
    "stereonet-16x": Reach(
        2 * (1 + 2 + 4 + 8) + 16 * 13 + 16 * 5 + sum(map(_refinement, (8, 4, 2, 1))), 16 * 2 + 8 * 2 + 8, 16, 16
    ),
    # Features (a 5x5 of stride 2, three and one 3x3); bottleneck, in whose middle is 1/8.
    "nvtiny": Reach(2 + 2 * 4 + 2 * 2 + 2 + 4 * 2 + 4 + 8 * 2, 8 + 4 + 2, (8 - 1) * 2, 8),
    # The same with eight blocks, each twice 3x3, for three layers.
    "resnet18-2d": Reach(2 + 2 * 17 + 2 * 2 + 2 + 4 * 2 + 4 + 8 * 2, 8 + 4 + 2, (8 - 1) * 2, 8),
    # conv1, conv2; conv3a, 3b; 4, 5, 6; then up: a predicting and a joining 3x3 and an enlargement each.
    "dispnetc": Reach(
        3 + 2 * 2 + 4 * 2 + 8 + sum(s + 2 * s for s in (8, 16, 32)) + sum((64, 32, 16, 8, 4, 2)), 64 + 4 * 64, 16, 64
    ),
}


def _columns(model: Baseline, width: int) -> tuple[range, range]:
    """Columns of the left and right image that the estimate in the middle of a row depends on."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for name, parameter in model.named_parameters():  # positive: nothing cancels, and no unit is off
            draws = torch.rand(parameter.shape, generator=generator, dtype=parameter.dtype) + 0.5
            if parameter.dim() > 1:
                draws /= 2 * parameter[0].numel()  # halved: what residual blocks add must not saturate a softmax
            elif "norm" not in name:
                draws *= 0.01
            parameter.copy_(draws)
    images = [
        torch.rand(1, 3, model.stride, width, generator=generator, dtype=torch.float64).requires_grad_()
        for _ in range(2)
    ]
    (estimate,) = model(*images)
    gradients = torch.autograd.grad(estimate[0, 0, 0, width // 2], images)
    left, right = (gradient.abs().sum((0, 1, 2)).nonzero()[:, 0].tolist() for gradient in gradients)
    return range(left[0], left[-1] + 1), range(right[0], right[-1] + 1)


@pytest.mark.parametrize("name", REACHES)
def test_reach(name):
    expected = REACHES[name]
    width = 64 * -(-2 * (expected.of + expected.more + expected.range) // 64) + 64
    left, right = _columns(build(name, 32 if name == "stereonet-16x" else 16).double().eval(), width)
    # As far as the layers on the longest path say, to both sides; and, in the right image, further left by the range.
    for side in (width // 2 - left.start, left.stop - 1 - width // 2):
        assert expected.of - expected.stride <= side <= expected.of + expected.more
    assert left.start - right.start == expected.range
    assert left.stop == right.stop


def test_psmnet_sees_the_pooled_surroundings():
    # Features: three 3x3 at 1/2 (the first on the image), three blocks, then 16 at 1/4, and six dilated ones.
    features = 1 + 2 * 2 + 2 * 6 + 2 + 4 * 31 + 4 * 6 * (2 + 4) + 4
    widest = 4 * 64
    left, right = _columns(build("psmnet-basic", 16).double().eval(), 2304)
    volume = 4 * (4 + 6 + 2)
    for side in (1152 - left.start, left.stop - 1 - 1152):
        assert features + volume + widest / 2 <= side <= features + volume + 2 * widest
    assert right.start <= left.start


def test_psmnet_judges_three_hourglasses_and_gives_the_last():
    torch.manual_seed(0)
    model = PSMNet(16)
    left, right = torch.randn(2, 2, 3, 16, 32).unbind()
    assert len(model(left, right)) == 3
    # The heads add up: without the later ones' weights, the later estimates are the first.
    for head in model.heads[1:]:
        torch.nn.init.zeros_(head.layers[1].weight)
    first, second, third = model(left, right)
    torch.testing.assert_close(second, first)
    torch.testing.assert_close(third, first)
