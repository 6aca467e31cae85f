"""conv3x3, conv3x3x3 and conv_chain against PyTorch's convolutions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise, product
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from inference_operator import InferenceOperator, call
from inference_operator import random as normal
from torch import Tensor

import anynet_ext
from anynet_ext import _kernels, reference

ISAS = [isa for isa in _kernels.Isa.__members__.values() if _kernels.isa_available(isa)]
OPERATORS = {2: anynet_ext.conv3x3, 3: anynet_ext.conv3x3x3}


def make(
    sizes: tuple[int, ...],
    channels: tuple[int, int],
    *,
    bias: bool = True,
    affine: bool = True,
    dtype: torch.dtype = torch.float64,
    batch: int = 2,
) -> dict[str, Tensor]:
    """Arguments of one call; weights are scaled so that results are about 1."""
    generator = torch.Generator().manual_seed(sum(sizes) + 100 * channels[0] + channels[1])

    def random(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator, dtype=dtype)

    c, o = channels
    tensors = {"input": random(batch, c, *sizes), "weight": random(o, c, *[3] * len(sizes)) / (c * 9) ** 0.5}
    if bias:
        tensors["bias"] = random(o)
    if affine:
        tensors |= {"scale": random(c), "shift": random(c)}
    return tensors


def check(tensors: dict[str, Tensor], **options: Any) -> None:
    """Results and gradients of the operator and of the reference agree."""
    outs, grads = [], []
    for module in (anynet_ext, reference):
        inputs = {name: t.clone().requires_grad_() for name, t in tensors.items()}
        function = module.conv3x3 if tensors["weight"].dim() == 4 else module.conv3x3x3
        out = function(**inputs, **options)
        grad = torch.linspace(-1, 1, out.numel(), dtype=out.dtype).reshape(out.shape)
        outs.append(out.detach())
        grads.append(torch.autograd.grad(out, list(inputs.values()), grad))
    tolerance = {"rtol": 1e-9, "atol": 1e-9} if outs[0].dtype == torch.float64 else {"rtol": 1e-4, "atol": 1e-5}
    torch.testing.assert_close(*outs, **tolerance)
    size = outs[0].numel() ** 0.5  # gradients of weights are sums over all pixels
    for name, ours, theirs in zip(tensors, *grads, strict=True):
        torch.testing.assert_close(
            ours, theirs, rtol=tolerance["rtol"], atol=size * tolerance["atol"], msg=lambda m, n=name: f"{n}: {m}"
        )


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("channels", range(1, 33))
@pytest.mark.parametrize("dimensions", [2, 3])
def test_every_channel_count(dimensions: int, channels: int, stride: int) -> None:
    sizes = (2, 6, 21)[-dimensions:]
    check(make(sizes, (channels, 33 - channels), dtype=torch.float32), stride=stride, relu_in=True)
    check(make(sizes, (33 - channels, channels), dtype=torch.float32, affine=False), stride=stride)


@pytest.mark.parametrize("channels", [(33, 9), (54, 24), (64, 64), (7, 61)])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_more_channels(dimensions: int, channels: tuple[int, int]) -> None:
    check(make((2, 6, 21)[-dimensions:], channels, dtype=torch.float32), relu_in=True)


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("sizes", [(100, 1000), (5, 40, 500)])
def test_batches_too_large_to_be_copied_at_once(sizes: tuple[int, ...], stride: int) -> None:
    """Padded copies are made of as many images at a time as take 4 MB: here of 2, 2 and 1."""
    check(make(sizes, (2, 3), batch=5), stride=stride, relu_in=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("width", [1, 2, 3, 7, 8, 9, 15, 16, 17, 31, 32, 33, 77, 80, 96, 97])
def test_every_way_a_row_ends(width: int, stride: int, dtype: torch.dtype) -> None:
    for channels in ((3, 1), (1, 2), (2, 4), (2, 13)):
        check(make((5, width), channels, dtype=dtype, affine=False), stride=stride)
    check(make((2, 3, width), (2, 3), dtype=dtype), stride=stride, relu_in=True, relu_out=True)


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("sizes", [(1, 1), (1, 20), (2, 18), (4, 17), (1, 1, 1), (1, 2, 20), (2, 1, 20), (3, 5, 20)])
def test_tiny_images(sizes: tuple[int, ...], stride: int) -> None:
    for out_channels in (1, 2, 5, 8):
        check(make(sizes, (2, out_channels)), stride=stride)
        check(make(sizes, (2, out_channels), affine=False), stride=stride)


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize(("bias", "affine", "relu_in", "relu_out"), list(product([False, True], repeat=4)))
def test_every_combination(dimensions: int, bias: bool, affine: bool, relu_in: bool, relu_out: bool) -> None:
    tensors = make((3, 5, 19)[-dimensions:], (3, 6), bias=bias, affine=affine)
    for stride in (1, 2):
        check(tensors, stride=stride, relu_in=relu_in, relu_out=relu_out)


@pytest.mark.parametrize("width", [16, 17, 31, 48, 77])
@pytest.mark.parametrize("height", [1, 2, 3, 8])
@pytest.mark.parametrize("depth", [1, 2, 5])
def test_tiles(depth: int, height: int, width: int) -> None:
    """Layers of many channels go another way (Winograd's), also at the edges of the volume."""
    check_tiles((depth, height, width))


@pytest.mark.parametrize("width", [31, 32, 33, 64, 95, 97, 161])
@pytest.mark.parametrize("height", [1, 2, 3, 8])
def test_flat_tiles(height: int, width: int) -> None:
    check_tiles((height, width))


def check_tiles(sizes: tuple[int, ...]) -> None:
    for channels, affine in (((8, 8), False), ((11, 18), True), ((16, 16), False)):
        tensors = make(sizes, channels, dtype=torch.float32, affine=affine)
        check(tensors, relu_in=affine, relu_out=not affine)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_empty_batch(dimensions: int) -> None:
    tensors = make((3, 5, 19)[-dimensions:], (3, 6), batch=0)
    inputs = {name: t.requires_grad_() for name, t in tensors.items()}
    out = OPERATORS[dimensions](**inputs)
    assert out.shape == (0, 6, *tensors["input"].shape[2:])
    for grad in torch.autograd.grad(out.sum(), list(inputs.values())):
        assert not grad.any()


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("sizes", [(3, 9), (2, 2, 3)])
def test_gradcheck(sizes: tuple[int, ...], stride: int) -> None:
    tensors = {name: t.requires_grad_() for name, t in make(sizes, (1, 2), batch=1).items()}

    def call(*values: Tensor) -> Tensor:
        return OPERATORS[len(sizes)](
            **dict(zip(tensors, values, strict=True)), stride=stride, relu_in=True, relu_out=True
        )

    assert torch.autograd.gradcheck(call, tuple(tensors.values()))


def test_second_derivative_is_refused() -> None:
    tensors = {name: t.requires_grad_() for name, t in make((4, 9), (2, 3)).items()}
    (grad,) = torch.autograd.grad(anynet_ext.conv3x3(**tensors).sum(), tensors["input"], create_graph=True)
    with pytest.raises(RuntimeError, match="second derivative"):
        grad.sum().backward()


def test_relu_keeps_nan() -> None:
    tensors = make((3, 40), (1, 1), affine=False, batch=1)
    tensors["input"][0, 0, 1, 20] = float("nan")
    for options in ({"relu_in": True}, {"relu_out": True}):
        nan = anynet_ext.conv3x3(**tensors, **options).isnan()
        assert nan[0, 0, :, 19:22].all()
        assert nan.sum() == 9


@pytest.mark.parametrize("channels", [(2, 3), (16, 16)])
@pytest.mark.parametrize("sizes", [(5, 38), (4, 6, 38)])
def test_gradients_that_are_not_finite_pass_relu_as_pytorchs(sizes: tuple[int, ...], channels: tuple[int, int]) -> None:
    tensors = make(sizes, channels, affine=False, batch=1, dtype=torch.float32)
    found = []
    for module in (anynet_ext, reference):
        leaves = {name: t.clone().requires_grad_() for name, t in tensors.items()}
        out = getattr(module, f"conv{'x'.join('3' * len(sizes))}")(**leaves, relu_out=True)
        grad = torch.where(out > 0, 1.0, torch.inf).to(out.dtype)  # as of a square root
        found.append(torch.autograd.grad(out, list(leaves.values()), grad))
    for one, other in zip(*found, strict=True):
        assert other.isfinite().all()
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("dimensions", "channels", "seen"),
    [(2, (7, 9), 9), (2, (4, 64), 9), (2, (12, 12), 12), (3, (1, 8), 27), (3, (2, 3), 27), (3, (8, 8), 48)],
)
def test_nan_spreads_over_tiles_in_the_layers_that_are_documented(
    dimensions: int, channels: tuple[int, int], seen: int
) -> None:
    input = torch.zeros(1, channels[0], *(9, 15, 64)[-dimensions:])
    input[(0, 0, *(3, 6, 31)[-dimensions:])] = torch.nan  # in the first row and plane of tiles
    weight = torch.ones(channels[1], channels[0], *[3] * dimensions)
    assert OPERATORS[dimensions](input, weight)[0, 0].isnan().sum() == seen


def test_any_layout() -> None:
    tensors = make((6, 20), (4, 5))
    expected = anynet_ext.conv3x3(**tensors)
    strided = {name: torch.stack([t, t], -1)[..., 0] for name, t in tensors.items()}
    strided["input"] = tensors["input"].contiguous(memory_format=torch.channels_last)
    assert not strided["weight"].is_contiguous()
    assert torch.equal(anynet_ext.conv3x3(**strided), expected)


# ------------------------------------------------------------------------------------------- kernels, one set at a time


def volume(tensors: dict[str, Tensor], name: str) -> np.ndarray:
    """A 2-D problem's tensor as the kernels take it: with depth 1."""
    tensor = tensors[name]
    return (tensor if tensor.dim() == 5 else tensor.unsqueeze(2)).numpy()


@pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("sizes", [(3, 2), (9, 5), (5, 16), (6, 37), (2, 3, 21), (3, 5, 80)])
def test_kernels(isa: Any, dtype: torch.dtype, stride: int, sizes: tuple[int, ...]) -> None:
    for channels in ((3, 1), (5, 2), (2, 4), (3, 15), (8, 9)):
        tensors = make(sizes, channels, dtype=dtype)
        leaves = {name: t.clone().requires_grad_() for name, t in tensors.items()}
        expected = reference.conv3x3(**leaves, stride=stride, relu_in=True, relu_out=True)
        x, w = volume(tensors, "input"), volume(tensors, "weight")
        vectors = [tensors[name].numpy() for name in ("bias", "scale", "shift")]
        out = _kernels.conv(isa, x, w, *vectors, stride, True, True, 2)
        tolerance = {"rtol": 1e-9, "atol": 1e-9} if dtype == torch.float64 else {"rtol": 1e-4, "atol": 1e-4}
        torch.testing.assert_close(torch.from_numpy(out).reshape(expected.shape), expected.detach(), **tolerance)

        plain = reference.conv3x3(leaves["input"], leaves["weight"], leaves["bias"], stride=stride)
        grad = torch.randn(plain.shape, generator=torch.Generator().manual_seed(0), dtype=dtype)
        grads = torch.autograd.grad(plain, [leaves[name] for name in ("input", "weight", "bias")], grad)
        g = volume({"grad": grad}, "grad")
        grad_input = _kernels.conv_backward_input(isa, g, w, None, list(x.shape), stride, 2)
        grad_weight, grad_bias = _kernels.conv_backward_weight(isa, g, x, None, None, w.shape[2], stride, False, 2)
        for ours, theirs in zip((grad_input, grad_weight, grad_bias), grads, strict=True):
            torch.testing.assert_close(torch.from_numpy(ours).reshape(theirs.shape), theirs, **tolerance)

        fused = _kernels.conv_backward_input(isa, g, w, x, list(x.shape), stride, 2)  # a ReLU that saw x came before
        assert np.array_equal(fused, np.where(x > 0, grad_input, 0))
        fused, _ = _kernels.conv_backward_weight(isa, g, x, *vectors[1:], w.shape[2], stride, True, 2)
        activated = np.maximum(x * vectors[1].reshape(1, -1, 1, 1, 1) + vectors[2].reshape(1, -1, 1, 1, 1), 0)
        apart, _ = _kernels.conv_backward_weight(isa, g, activated, None, None, w.shape[2], stride, False, 2)
        torch.testing.assert_close(torch.from_numpy(fused), torch.from_numpy(apart), **tolerance)


@pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
@pytest.mark.parametrize("stride", [1, 2])
def test_threads_do_not_change_a_bit(isa: Any, stride: int) -> None:
    for channels in ((5, 7), (8, 9)):
        tensors = make((7, 23, 77), channels, dtype=torch.float32, batch=3)  # large enough to be worth the threads
        x, w = volume(tensors, "input"), volume(tensors, "weight")
        results = []
        for threads in (1, 2, 3, 5, 5):
            out = _kernels.conv(isa, x, w, None, None, None, stride, False, False, threads)
            grad_input = _kernels.conv_backward_input(isa, out, w, x, list(x.shape), stride, threads)
            grads = _kernels.conv_backward_weight(isa, out, x, None, None, 3, stride, True, threads)
            results.append((out, grad_input, *grads))
        for other in results[1:]:
            for a, b in zip(results[0], other, strict=True):
                assert np.array_equal(a, b)


# ------------------------------------------------------------------------------------------------- errors and PyTorch


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"input": torch.zeros(2, 3, 8)}, ValueError, r"expected input of shape \[N, C, H, W\], got \[2, 3, 8\]"),
        ({"input": torch.zeros(2, 65, 4, 8)}, ValueError, r"C in 1\.\.64 .* got \[2, 65, 4, 8\]"),
        ({"input": torch.zeros(2, 3, 0, 8)}, ValueError, "at least one pixel"),
        ({"input": torch.zeros(2, 3, 4, 8).half()}, TypeError, "float32 or float64, got torch.float16"),
        ({"input": torch.zeros(2, 3, 4, 8).double()}, TypeError, "one dtype"),
        ({"weight": torch.zeros(5, 4, 3, 3)}, ValueError, r"expected weight of shape \[O, 3, 3, 3\]"),
        ({"weight": torch.zeros(5, 3, 5, 5)}, ValueError, r"got \[5, 3, 5, 5\]"),
        ({"weight": torch.zeros(65, 3, 3, 3)}, ValueError, r"O in 1\.\.64, got \[65, 3, 3, 3\]"),
        ({"weight": None}, TypeError, "expected weight to be a Tensor, got NoneType"),
        ({"bias": torch.zeros(4)}, ValueError, r"expected bias of shape \[5\], got \[4\]"),
        ({"scale": torch.zeros(3)}, ValueError, "both or neither of scale and shift"),
        ({"stride": 3}, ValueError, "expected stride 1 or 2, got 3"),
        ({"stride": 1.0}, TypeError, "expected stride to be an int, got float"),
    ],
)
def test_errors(change: dict[str, Any], error: type[Exception], message: str) -> None:
    arguments = {"input": torch.zeros(2, 3, 4, 8), "weight": torch.zeros(5, 3, 3, 3)} | change
    with pytest.raises(error, match=message):
        anynet_ext.conv3x3(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((2, 3, 4, 8), (5, 3, 3), None), "weight"),
        (((2, 65, 4, 8), (5, 65, 3, 3), None), "input"),
        (((2, 3, 4, 8), (5, 3, 3, 3), (4,)), "bias"),
    ],
)
def test_operator_checks_too(arguments: tuple[tuple[int, ...], ...], message: str) -> None:
    tensors = [None if shape is None else torch.zeros(shape) for shape in arguments]
    with pytest.raises(RuntimeError, match=f"conv3x3: expected {message}"):
        torch.ops.anynet.conv3x3(*tensors, None, None, 1, False, False)


def test_operators_tell_the_dtypes_that_came() -> None:
    operators, x, weight = torch.ops.anynet, torch.zeros(2, 3, 4, 8), torch.zeros(5, 3, 3, 3)
    grad = torch.zeros(2, 5, 4, 8)
    for wrong_call, message in (
        (lambda: operators.conv3x3(x, weight.double()), "input and weight of one dtype, got float32 and float64"),
        (lambda: operators.conv3x3(x, weight, weight[:, 0, 0, 0].double()), "bias as float32 [5], got float64 [5]"),
        (
            lambda: operators.conv3x3_backward_input(grad.double(), weight, None, [2, 3, 4, 8], 1),
            "grad as float32 [2, 5, 4, 8], got float64 [2, 5, 4, 8]",
        ),
        (
            lambda: operators.conv3x3_backward_input(grad, weight, x.double(), [2, 3, 4, 8], 1),
            "before as float32 [2, 3, 4, 8], got float64 [2, 3, 4, 8]",
        ),
        (
            lambda: operators.conv3x3_backward_weight(grad.double(), x, None, None, 1, False),
            "grad of the output's shape and dtype for input float32 [2, 3, 4, 8], got float64 [2, 5, 4, 8]",
        ),
    ):
        with pytest.raises(RuntimeError) as caught:
            wrong_call()
        assert str(caught.value).splitlines()[0] == f"conv3x3: expected {message}"


@pytest.mark.parametrize("sizes", [[2, 4, -3, 5], [-2, 4, 3, 5], [2, 4, 0, 5], [2, 65, 3, 5], [2, 4, 15], []])
def test_the_gradient_checks_the_inputs_size(sizes: list[int]) -> None:
    grad, weight = torch.zeros(2, 2, 3, 5), torch.zeros(2, 4, 3, 3)
    with pytest.raises(RuntimeError) as caught:
        torch.ops.anynet.conv3x3_backward_input(grad, weight, None, sizes, 1)
    expected = f"conv3x3: expected input of shape [N, C, H, W] with C in 1..64 and at least one pixel, got {sizes}"
    assert str(caught.value).splitlines()[0] == expected


@pytest.mark.parametrize("dimensions", [2, 3])
def test_opcheck(dimensions: int) -> None:
    tensors = {name: t.requires_grad_() for name, t in make((3, 5, 19)[-dimensions:], (3, 6)).items()}
    operators = torch.ops.anynet
    name = {2: "conv3x3", 3: "conv3x3x3"}[dimensions]
    torch.library.opcheck(getattr(operators, name).default, (*tensors.values(), 2, True, True))
    input, weight = tensors["input"].detach(), tensors["weight"].detach()
    grad = OPERATORS[dimensions](input, weight)
    for before in (None, input):
        arguments = (grad, weight, before, list(input.shape), 1)
        torch.library.opcheck(getattr(operators, f"{name}_backward_input").default, arguments)
    scale, shift = tensors["scale"].detach(), tensors["shift"].detach()
    torch.library.opcheck(getattr(operators, f"{name}_backward_weight").default, (grad, input, scale, shift, 1, True))


def test_vmap() -> None:
    tensors = make((6, 20), (3, 4))
    stack = torch.stack([tensors["input"], 2 * tensors["input"]], 1).requires_grad_()

    def run(input: Tensor) -> Tensor:
        return anynet_ext.conv3x3(input, tensors["weight"], tensors["bias"], relu_in=True)

    mapped, looped = torch.vmap(run, in_dims=1)(stack), torch.stack([run(input) for input in stack.unbind(1)])
    assert torch.equal(mapped, looped)
    grad = torch.randn_like(mapped)
    torch.testing.assert_close(torch.autograd.grad(mapped, stack, grad), torch.autograd.grad(looped, stack, grad))
    with pytest.raises(RuntimeError, match="vmap over weight is not supported"):
        torch.vmap(lambda w: anynet_ext.conv3x3(tensors["input"], w))(torch.stack([tensors["weight"]] * 2))


@pytest.mark.slow
@pytest.mark.parametrize("dynamic", [False, True])
def test_compile(dynamic: bool) -> None:
    compiled = torch.compile(anynet_ext.conv3x3, fullgraph=True, dynamic=dynamic)
    for sizes in ((6, 20), (7, 33)):
        tensors = make(sizes, (3, 4))
        inputs = {name: t.clone().requires_grad_() for name, t in tensors.items()}
        out = compiled(**inputs, stride=2, relu_in=True)
        torch.testing.assert_close(out, anynet_ext.conv3x3(**tensors, stride=2, relu_in=True))
        out.sum().backward()
        assert inputs["weight"].grad is not None


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_autocast_computes_in_float32(dtype: torch.dtype) -> None:
    tensors = {name: t.to(dtype) for name, t in make((6, 20), (3, 4), dtype=torch.float32).items()}
    with torch.autocast("cpu", dtype=dtype):
        out = anynet_ext.conv3x3(**tensors)
    assert out.dtype == torch.float32
    assert torch.equal(out, anynet_ext.conv3x3(**{name: t.float() for name, t in tensors.items()}))


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU and the CUDA build of torch")
@pytest.mark.parametrize("dimensions", [2, 3])
def test_cuda_calls_pytorch(dimensions: int) -> None:
    tensors = make((3, 5, 19)[-dimensions:], (3, 6))
    on_cpu = OPERATORS[dimensions](**tensors, relu_in=True, stride=2)
    inputs = {name: t.cuda().requires_grad_() for name, t in tensors.items()}
    out = OPERATORS[dimensions](**inputs, relu_in=True, stride=2)
    torch.testing.assert_close(out.cpu(), on_cpu)
    leaves = {name: t.requires_grad_() for name, t in tensors.items()}
    expected = torch.autograd.grad(OPERATORS[dimensions](**leaves, relu_in=True, stride=2).sum(), list(leaves.values()))
    for ours, theirs in zip(torch.autograd.grad(out.sum(), list(inputs.values())), expected, strict=True):
        torch.testing.assert_close(ours.cpu(), theirs)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("channels", [(1, 1), (3, 4), (5, 8), (2, 11), (18, 3)])
@pytest.mark.parametrize("sizes", [(1, 1), (7, 35), (13, 66), (1, 1, 1), (2, 3, 5), (5, 9, 34)])
def test_cuda_equals_reference(
    cuda: Any, sizes: tuple[int, ...], channels: tuple[int, int], stride: int, dtype: torch.dtype
) -> None:
    name = "conv3x3" if len(sizes) == 2 else "conv3x3x3"
    operator = getattr(getattr(torch.ops, cuda.namespace), name)
    for affine, relu in ((False, False), (True, True), (False, True), (True, False)):
        tensors = make(sizes, channels, bias=affine, affine=affine, dtype=dtype)
        options = {"stride": stride, "relu_in": relu, "relu_out": not relu}
        expected = getattr(reference, name)(**tensors, **options)
        moved = {key: t.to(cuda.device) for key, t in tensors.items()}
        out = operator(*(moved.get(key) for key in ("input", "weight", "bias", "scale", "shift")), *options.values())
        tolerance = 1e-9 if dtype == torch.float64 else 1e-4
        torch.testing.assert_close(out.cpu(), expected, rtol=tolerance, atol=tolerance)


def test_cuda_of_an_empty_batch(cuda: Any) -> None:
    operator = getattr(torch.ops, cuda.namespace).conv3x3
    input, weight = torch.zeros(0, 3, 4, 5, device=cuda.device), torch.zeros(2, 3, 3, 3, device=cuda.device)
    assert operator(input, weight, None, None, None, 1, False, False).shape == (0, 2, 4, 5)


def chain_call(sizes: tuple[int, ...], channels: Sequence[int], bias: bool, relu_out: bool) -> Callable[[], Any]:
    def make() -> tuple[tuple[Any, ...], dict[str, Any]]:
        layers = list(pairwise(channels))
        weights = [normal(o, i, *[3] * len(sizes)) / (i * 3 ** len(sizes)) ** 0.5 for i, o in layers]
        biases = [normal(o) if bias == (i % 2 == 0) else None for i, (_, o) in enumerate(layers)]
        return call(normal(2, channels[0], *sizes), weights, biases, relu_out=relu_out)

    return make


INPUT, WEIGHTS, BIASES = chain_call((4, 5), (2, 3, 2), True, False)()[0]


class TestConvChain(InferenceOperator):
    op = "conv_chain"
    cases: ClassVar = {
        f"{sizes}-{channels}-{bias}": chain_call(sizes, channels, bias, not bias)
        for sizes in [(5, 6), (1, 1), (2, 3, 5), (19, 34), (1, 1, 1), (5, 9, 33)]
        for channels in [(2, 3, 2), (3, 2), (1, 4, 1), (5, 8, 6, 7), (4, 4, 4, 4, 4, 1), (40, 30, 3)]
        for bias in (True, False)
    }
    errors: ClassVar = [
        (
            lambda: call(INPUT[0], WEIGHTS, BIASES),
            r"input as contiguous float32 tensor of 4 dimensions, got float32 \[2, 4, 5\]$",
        ),
        (
            lambda: call(INPUT, [normal(3, 1, 3, 3), WEIGHTS[1]], BIASES),
            r"weights of shape \[O, 2, 3, 3\] .*\[3, 1, 3, 3\]",
        ),
        (
            lambda: call(INPUT, [WEIGHTS[0], normal(2, 2, 3, 3)], BIASES),
            r"weights of shape \[O, 3, 3, 3\] .*\[2, 2, 3, 3\]",
        ),
        (lambda: call(INPUT, WEIGHTS, [normal(2), None]), r"biases as float32 \[3\], got float32 \[2\]"),
        (lambda: call(INPUT, WEIGHTS, [None, normal(3)]), r"biases as float32 \[2\], got float32 \[3\]"),
        (lambda: call(INPUT, WEIGHTS, BIASES[:1]), "at least one weight and as many biases, got 2 and 1"),
        (lambda: call(INPUT, [], []), "at least one weight and as many biases, got 0 and 0"),
        (lambda: call(normal(2, 2, 0, 5), WEIGHTS, BIASES), "at least one pixel"),
    ]
    test_every_instruction_set_equals_reference = None  # it is conv3x3 and conv3x3x3 on the CPU
