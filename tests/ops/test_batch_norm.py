"""batch_norm_relu against PyTorch's batch norm and ReLU."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import anynet_ext
from anynet_ext import _kernels, reference

ISAS = [isa for isa in _kernels.Isa.__members__.values() if _kernels.isa_available(isa)]
# Of a piece that is summed at a time, there are 4,096 float32 or 2,048 float64 elements.
SHAPES = [
    (2, 1),
    (1, 3, 2),
    (2, 3, 1, 1),
    (3, 2, 5, 7),
    (2, 1, 2, 3, 11),
    (2, 4, 70, 66),
    (1, 2, 4097),
    (2, 1, 3, 40, 90),
]


def make(shape: tuple[int, ...], dtype: torch.dtype = torch.float64, offset: float = 0.0) -> list[Tensor]:
    """input, weight, bias."""
    generator = torch.Generator().manual_seed(sum(shape))
    vectors = torch.randn(2, shape[1], generator=generator, dtype=torch.float64)
    input = torch.randn(shape, generator=generator, dtype=torch.float64) * 3 + offset
    return [tensor.to(dtype) for tensor in (input, *vectors)]


def results(module: Any, tensors: list[Tensor], eps: float = 1e-5) -> list[Tensor]:
    """out, mean, variance, and the gradients."""
    leaves = [t.clone().requires_grad_() for t in tensors]
    out, mean, variance = module.batch_norm_relu(*leaves, eps=eps)
    grad = torch.linspace(-1, 1.5, out.numel(), dtype=out.dtype, device=out.device).reshape(out.shape)
    return [out.detach(), mean, variance, *torch.autograd.grad(out, leaves, grad)]


@pytest.fixture(params=[1, 2, 5])
def threads(request: pytest.FixtureRequest) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("offset", [0.0, 100.0])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.usefixtures("threads")
def test_against_reference(shape: tuple[int, ...], dtype: torch.dtype, offset: float) -> None:
    expected = results(reference, make(shape, offset=offset), eps=0.01)
    found = results(anynet_ext, make(shape, dtype, offset), eps=0.01)
    tolerance = 1e-9 if dtype == torch.float64 else 2e-4 if offset else 2e-5
    for name, ours, theirs in zip(("out", "mean", "variance", "input", "weight", "bias"), found, expected, strict=True):
        size = theirs.abs().max().item()
        torch.testing.assert_close(
            ours.double(), theirs, rtol=tolerance, atol=tolerance * max(1, size), msg=lambda m, n=name: f"{n}: {m}"
        )


def test_results_do_not_depend_on_the_threads() -> None:
    tensors, before = make((2, 3, 150, 160), torch.float32), torch.get_num_threads()
    found = []
    for count in (1, 2, 7):
        torch.set_num_threads(count)
        found.append(results(anynet_ext, tensors))
    torch.set_num_threads(before)
    for others in found[1:]:
        assert all(torch.equal(one, other) for one, other in zip(found[0], others, strict=True))


def test_gradcheck() -> None:
    tensors = [t.requires_grad_() for t in make((2, 3, 4))]
    assert torch.autograd.gradcheck(lambda *values: anynet_ext.batch_norm_relu(*values)[0], tensors)


def test_statistics_have_no_gradient() -> None:
    input, weight, bias = make((2, 3, 4))
    out, mean, variance = anynet_ext.batch_norm_relu(input.requires_grad_(), weight, bias)
    assert out.requires_grad
    assert not mean.requires_grad
    assert not variance.requires_grad
    (grad,) = torch.autograd.grad(out.sum(), input, create_graph=True)
    with pytest.raises(RuntimeError, match="second derivative"):
        grad.sum().backward()


def test_nan_and_a_constant_channel() -> None:
    input, weight, bias = make((2, 2, 40))
    input[1, 0, 3] = float("nan")
    input[:, 1] = 7
    out, mean, variance = anynet_ext.batch_norm_relu(input, weight, bias)
    assert out[:, 0].isnan().all()
    assert mean[0].isnan()
    assert (mean[1], variance[1]) == (7, 0)
    assert torch.equal(out[:, 1], bias[1].relu().expand(2, 40))


def test_any_layout() -> None:
    input, weight, bias = make((2, 3, 6, 20))
    expected = anynet_ext.batch_norm_relu(input, weight, bias)[0]
    strided = torch.stack([weight, weight], 1)[:, 0]
    found = anynet_ext.batch_norm_relu(input.contiguous(memory_format=torch.channels_last), strided, bias)[0]
    assert torch.equal(found, expected)
    assert found.is_contiguous()


def test_good_citizen() -> None:
    tensors = [t.requires_grad_() for t in make((2, 3, 5, 4), torch.float32)]
    torch.library.opcheck(torch.ops.anynet.batch_norm_relu.default, (*tensors, 1e-5))
    with torch.autocast("cpu", torch.bfloat16):
        out, *_ = anynet_ext.batch_norm_relu(tensors[0].bfloat16(), *tensors[1:])
    assert out.dtype == torch.float32


@pytest.mark.parametrize("backend", ["aot_eager", pytest.param("inductor", marks=pytest.mark.slow)])
def test_compile(backend: str) -> None:
    tensors = [t.requires_grad_() for t in make((2, 3, 5, 4), torch.float32)]
    compiled = torch.compile(
        lambda *values: anynet_ext.batch_norm_relu(*values)[0].sin(), fullgraph=True, backend=backend
    )
    torch.testing.assert_close(compiled(*tensors), anynet_ext.batch_norm_relu(*tensors)[0].sin())


def test_errors() -> None:
    input, weight, bias = make((2, 3, 4))
    with pytest.raises(ValueError, match=r"shape \[N, C, ...\], got \[4\]"):
        anynet_ext.batch_norm_relu(input[0, 0], weight, bias)
    with pytest.raises(ValueError, match=r"more than one value per channel, got \[1, 3, 1\]"):
        anynet_ext.batch_norm_relu(input[:1, :, :1], weight, bias)
    with pytest.raises(ValueError, match=r"more than one value per channel, got \[0, 3, 4\]"):
        anynet_ext.batch_norm_relu(input[:0], weight, bias)
    with pytest.raises(ValueError, match=r"bias of shape \[3\], got \[2\]"):
        anynet_ext.batch_norm_relu(input, weight, bias[:2])
    with pytest.raises(TypeError, match=r"float32 or float64, got torch\.float16"):
        anynet_ext.batch_norm_relu(input.half(), weight.half(), bias.half())
    for eps in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match=f"expected eps above 0, got {eps}"):
            anynet_ext.batch_norm_relu(input, weight, bias, eps=eps)
        with pytest.raises(RuntimeError, match="expected eps above 0, got"):
            torch.ops.anynet.batch_norm_relu(input, weight, bias, eps)
    with pytest.raises(TypeError, match="expected all tensors of one dtype"):
        anynet_ext.batch_norm_relu(input, weight.float(), bias)
    with pytest.raises(RuntimeError, match=r"weight of shape \[3\], got \[2\]"):
        torch.ops.anynet.batch_norm_relu(input, weight[:2], bias, 1e-5)
    with pytest.raises(RuntimeError, match="dtype float32 or float64, got float16"):
        torch.ops.anynet.batch_norm_relu(input.half(), weight.half(), bias.half(), 1e-5)
    for grad, message in (
        (input[..., :2], r"grad of shape \[2, 3, 4\], got \[2, 3, 2\]"),
        (input.float(), "one dtype, got float64 and, for grad, float32"),
    ):
        with pytest.raises(RuntimeError, match=message):
            torch.ops.anynet.batch_norm_relu_backward(grad, input, weight, bias, weight, bias, 1e-5)


@pytest.mark.parametrize("offset", [0.0, 100.0])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_cuda(cuda: Any, shape: tuple[int, ...], dtype: torch.dtype, offset: float) -> None:
    namespace, eps = getattr(torch.ops, cuda.namespace), 0.01
    tensors = [t.to(cuda.device) for t in make(shape, dtype, offset)]
    out, mean, variance = namespace.batch_norm_relu(*tensors, eps)
    grad = torch.linspace(-1, 1.5, out.numel(), dtype=dtype, device=cuda.device).reshape(out.shape)
    grads = namespace.batch_norm_relu_backward(grad, *tensors, mean, variance, eps)
    tolerance = 1e-9 if dtype == torch.float64 else 2e-4 if offset else 2e-5
    for ours, theirs in zip(
        (out, mean, variance, *grads), results(reference, make(shape, offset=offset), eps), strict=True
    ):
        atol = tolerance * max(1, theirs.abs().max().item())
        torch.testing.assert_close(ours.double().cpu(), theirs, rtol=tolerance, atol=atol)
    if cuda.device == "cuda":
        again = results(anynet_ext, tensors, eps)
        assert all(torch.equal(one, other) for one, other in zip(again, results(anynet_ext, tensors, eps), strict=True))


@pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("pixels", [2, 15, 64, 69, 4100])
def test_kernels(isa: Any, dtype: torch.dtype, pixels: int) -> None:
    tensors = make((2, 3, pixels), dtype)
    expected = results(reference, [t.double() for t in tensors])
    arrays = [t.numpy() for t in tensors]
    out, mean, variance = _kernels.batch_norm_relu(isa, *arrays, 1e-5, 2)
    grad = np.linspace(-1, 1.5, out.size, dtype=out.dtype).reshape(out.shape)
    grads = _kernels.batch_norm_relu_backward(isa, grad, *arrays, mean, variance, 1e-5, 2)
    tolerance = 1e-9 if dtype == torch.float64 else 2e-5
    for ours, theirs in zip((out, mean, variance, *grads), expected, strict=True):
        atol = tolerance * max(1, theirs.abs().max().item())
        torch.testing.assert_close(torch.from_numpy(ours).double(), theirs, rtol=tolerance, atol=atol)
