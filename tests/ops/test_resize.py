"""resize: against `torch.nn.functional.interpolate`, both passes."""

import pytest
import torch
from operator_cases import ISAS, TOLERANCES, from_array, to_array

import anynet_ext
from anynet_ext import _kernels, _resize, reference

SIZES = [
    ((5, 7), (20, 28)),
    ((5, 7), (11, 13)),
    ((9, 40), (4, 10)),
    ((1, 1), (3, 4)),
    ((6, 1), (1, 5)),
    ((3, 5), (3, 5)),
    ((23, 77), (46, 154)),
]
TOLERANCE = {torch.float64: 1e-12, torch.float32: 2e-5, torch.float16: 2e-3, torch.bfloat16: 2e-2}


def images(shape: tuple[int, ...], dtype: torch.dtype) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("align_corners", [False, True])
@pytest.mark.parametrize(("small", "size"), SIZES)
@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("layout", ["contiguous", "channels_last", "sliced"])
def test_matches_reference(layout, dtype, small, size, align_corners):
    tolerance = {"rtol": TOLERANCE[dtype], "atol": TOLERANCE[dtype]}
    input, add = images((2, 3, *small), dtype), images((2, 3, *size), dtype)
    if layout == "channels_last":
        input, add = (t.contiguous(memory_format=torch.channels_last) for t in (input, add))
    if layout == "sliced":
        input, add = (torch.stack([t, t], -1)[..., 0] for t in (input, add))
    for rest in ({}, {"add": add}, {"scale": -4.0, "add": add}):
        got = anynet_ext.resize(input, size, align_corners=align_corners, **rest)
        exact = {k: v.double() if k == "add" else v for k, v in rest.items()}
        want = reference.resize(input.double(), size, align_corners=align_corners, **exact).to(dtype)
        torch.testing.assert_close(got, want, **tolerance)
        assert got.is_contiguous()


@pytest.mark.parametrize("align_corners", [False, True])
@pytest.mark.parametrize(("small", "size"), SIZES)
def test_gradients(small, size, align_corners):
    input = images((2, 3, *small), torch.float64).requires_grad_()
    add = images((2, 3, *size), torch.float64).requires_grad_()
    weight = images((2, 3, *size), torch.float64).flip(3)
    for gradient in (weight, torch.ones((), dtype=torch.float64).expand(weight.shape)):
        results = []
        for module in (anynet_ext, reference):
            out = module.resize(input, size, scale=3.0, add=add, align_corners=align_corners)
            results.append(torch.autograd.grad(out, (input, add), gradient))
        torch.testing.assert_close(*results, rtol=1e-12, atol=1e-12)
    if input.numel() < 300:
        plane = [t[:1, :1].detach().requires_grad_() for t in (input, add)]  # of all, the derivatives would be 10^7
        assert torch.autograd.gradcheck(
            lambda i, a: anynet_ext.resize(i, size, scale=3.0, add=a, align_corners=align_corners), plane
        )


@pytest.mark.parametrize("align_corners", [False, True])
@pytest.mark.parametrize(("small", "size"), SIZES)
@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
def test_kernels(isa, dtype, small, size, align_corners):
    tolerance = {"rtol": TOLERANCE[dtype], "atol": TOLERANCE[dtype]}
    input, add, grad = images((2, 3, *small), dtype), images((2, 3, *size), dtype), images((2, 3, *size), dtype).flip(3)
    leaf = input.double().clone().requires_grad_()
    expected = reference.resize(leaf, size, scale=-4.0, add=add.double(), align_corners=align_corners)
    (expected_grad,) = torch.autograd.grad(expected, leaf, grad.double())
    out = _kernels.resize(isa, to_array(input), *size, -4.0, to_array(add), align_corners, 2)
    torch.testing.assert_close(from_array(out), expected.detach().to(dtype), **tolerance)
    back = _kernels.resize_backward(isa, to_array(grad), *small, -4.0, align_corners, 2)
    scale = max(1.0, expected_grad.abs().max().item())
    torch.testing.assert_close(from_array(back).double() / scale, expected_grad / scale, **tolerance)


@pytest.mark.parametrize("index", [0, 4])
def test_devices(index):
    arguments = [torch.zeros(1, 1, 2, 2), 4, 4, 1.0, torch.zeros(1, 1, 4, 4), False]
    arguments[index] = arguments[index].to("meta")
    with pytest.raises(RuntimeError, match="resize: expected all tensors on one device, got cpu and meta"):
        torch.ops.anynet.resize(*arguments)


def test_bits_do_not_depend_on_threads():
    input, grad = images((2, 2, 92, 308), torch.float32), images((2, 2, 368, 1232), torch.float32)
    threads, seen = torch.get_num_threads(), set()
    try:
        for count in (1, 2, 3, 2):
            torch.set_num_threads(count)
            out = anynet_ext.resize(input, (368, 1232))
            back = torch.ops.anynet.resize_backward(grad, 92, 308, 1.0, False)
            seen.add((out.numpy().tobytes(), back.numpy().tobytes()))
    finally:
        torch.set_num_threads(threads)
    assert len(seen) == 1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.bfloat16], ids=str)
def test_what_cuda_computes_by_pytorch(dtype):
    """On CPU tensors: contiguous, half types rounded once, and the same refused, as by the CPU's operator."""
    input = torch.randn(2, 3, 4, 5).to(dtype).contiguous(memory_format=torch.channels_last)
    add = torch.randn(2, 3, 8, 9).to(dtype)
    wide, wide_add = input.double(), add.double()
    for found, expected in (
        (_resize._by_pytorch(input, 8, 9, 2.0, add), torch.ops.anynet.resize(wide, 8, 9, 2.0, wide_add)),
        (_resize._backward_by_pytorch(input, 3, 2, 2.0, True), torch.ops.anynet.resize_backward(wide, 3, 2, 2.0, True)),
    ):
        assert (found.dtype, found.stride()) == (dtype, expected.stride())
        torch.testing.assert_close(found.double(), expected, **TOLERANCES[dtype])
    assert _resize._by_pytorch(input[:, :0], 8, 9).shape == (2, 0, 8, 9)
    assert _resize._backward_by_pytorch(input[:0], 3, 2, 1.0, False).shape == (0, 3, 3, 2)
    large = torch.full((1, 1, 2, 2), 40000.0).half()
    assert _resize._by_pytorch(large, 4, 4, 2.0, -torch.full((1, 1, 4, 4), 40000.0).half()).max() == 40000
    for wrong in (add[:1], add.int(), add.to("meta")):
        with pytest.raises((TypeError, ValueError), match="resize: expected"):
            _resize._by_pytorch(input, 8, 9, 1.0, wrong)


def test_empty_batch():
    assert anynet_ext.resize(torch.zeros(0, 2, 3, 4), (6, 8)).shape == (0, 2, 6, 8)
    assert torch.ops.anynet.resize_backward(torch.zeros(0, 2, 6, 8), 3, 4, 1.0, False).shape == (0, 2, 3, 4)


def double(x: torch.Tensor) -> torch.Tensor:
    return anynet_ext.resize(x, (x.shape[2] * 2, x.shape[3] * 2), scale=2.0)


@pytest.mark.parametrize("backend", ["aot_eager", pytest.param("inductor", marks=pytest.mark.slow)])
def test_compile(backend):
    compiled = torch.compile(double, fullgraph=True, dynamic=True, backend=backend)
    for shape in ((1, 2, 3, 4), (2, 1, 5, 9)):
        x = torch.randn(shape)
        torch.testing.assert_close(compiled(x), reference.resize(x, (2 * shape[2], 2 * shape[3]), scale=2.0))


def test_dispatcher():
    input = torch.randn(2, 3, 4, 5, requires_grad=True)
    add = torch.randn(2, 3, 8, 9, requires_grad=True)
    torch.library.opcheck(torch.ops.anynet.resize.default, (input, 8, 9, 2.0, add, False))
    torch.library.opcheck(torch.ops.anynet.resize.default, (input, 8, 9, 1.0, None, True))
    torch.library.opcheck(torch.ops.anynet.resize_backward.default, (add.detach(), 4, 5, 2.0, False))
    with torch.autocast("cpu", torch.bfloat16):
        assert double(torch.randn(1, 1, 2, 2, dtype=torch.bfloat16)).dtype == torch.float32


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: anynet_ext.resize(torch.zeros(2, 3, 4), (6, 8)), ValueError, "N, C, H, W"),
        (lambda: anynet_ext.resize(torch.zeros(1, 1, 0, 4), (6, 8)), ValueError, r"\[1, 1, 0, 4\]"),
        (lambda: anynet_ext.resize(torch.zeros(1, 1, 2, 4), (0, 8)), ValueError, "0 x 8"),
        (lambda: anynet_ext.resize(torch.zeros(1, 1, 2, 4), (2.5, 8)), TypeError, "float"),
        (lambda: anynet_ext.resize(torch.zeros(1, 1, 2, 4), 5), TypeError, r"size as \(H, W\), got 5"),
        (lambda: anynet_ext.resize(torch.zeros(1, 1, 2, 4), (5, 5, 5)), TypeError, r"got \(5, 5, 5\)"),
        (lambda: anynet_ext.resize(torch.zeros(1, 1, 2, 4).int(), (2, 8)), TypeError, "int32"),
        (lambda: anynet_ext.resize(torch.zeros(1, 1, 2, 4), (2, 8), add=torch.zeros(1, 1, 2, 4)), ValueError, "add"),
        (lambda: torch.ops.anynet.resize(torch.zeros(2, 3, 4), 6, 8, 1.0, None, False), RuntimeError, "N, C, H, W"),
        (
            lambda: torch.ops.anynet.resize(torch.zeros(1, 1, 3, 4), 6, 0, 1.0, None, False),
            RuntimeError,
            "at least one pixel .* got 6 x 0",
        ),
    ],
)
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize("size", [(6, 20), (12, 20), (6, 31), (13, 41)])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_values_that_are_not_finite_spread_as_in_pytorch(value, size):
    input = torch.rand(1, 1, 6, 20)
    input[0, 0, 3, 10] = value
    got, want = (module.resize(input, size) for module in (anynet_ext, reference))
    assert torch.equal(got.isfinite(), want.isfinite())
