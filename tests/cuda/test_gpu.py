"""What only a GPU can show: streams, devices, graphs, repeats. (tests/ops runs every operator on "cuda" as well.)"""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import anynet_ext

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU and the CUDA build of torch"),
]


def inputs(device: str) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(3)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator).to(device)

    return {
        "left": normal(2, 8, 48, 96),
        "right": normal(2, 8, 48, 96),
        "disparity": normal(2, 1, 48, 96) * 8,
        "cost": normal(2, 12, 48, 96),
        "gates": normal(2, 3, 8, 48, 96) / 8,
    }


CALLS: dict[str, Callable[[dict[str, Tensor]], Tensor]] = {
    "cost_volume": lambda t: anynet_ext.cost_volume(t["left"], t["right"], None, 0, 11),
    "cost_volume with disparity": lambda t: anynet_ext.cost_volume(t["left"], t["right"], t["disparity"], -2, 2),
    "warp": lambda t: anynet_ext.warp(t["left"], t["disparity"]),
    "soft_argmin": lambda t: anynet_ext.soft_argmin(t["cost"], 0),
    **{
        f"spatial_propagation {d}": lambda t, d=d: anynet_ext.spatial_propagation(t["left"], t["gates"], d)
        for d in range(4)
    },
}
every_call = pytest.mark.parametrize("call", CALLS.values(), ids=CALLS.keys())


def forward_and_backward(call: Callable[[dict[str, Tensor]], Tensor], tensors: dict[str, Tensor]) -> list[Tensor]:
    leaves = {name: t.detach().requires_grad_() for name, t in tensors.items()}
    out = call(leaves)
    grads = torch.autograd.grad(out, list(leaves.values()), torch.ones_like(out), allow_unused=True)
    return [out.detach(), *(g for g in grads if g is not None)]


@every_call
def test_equals_the_cpu(call):
    for gpu, cpu in zip(
        forward_and_backward(call, inputs("cuda")), forward_and_backward(call, inputs("cpu")), strict=True
    ):
        torch.testing.assert_close(gpu.cpu(), cpu, rtol=1e-4, atol=1e-4)


@every_call
def test_repeats_bit_for_bit(call):
    tensors = inputs("cuda")
    first = forward_and_backward(call, tensors)
    for _ in range(5):
        for one, other in zip(first, forward_and_backward(call, tensors), strict=True):
            assert torch.equal(one, other)


@every_call
def test_side_stream(call):
    """Work goes to the current stream: on a side stream that is still busy, results wait for their inputs."""
    tensors = inputs("cuda")
    expected = call(tensors)
    stream = torch.cuda.Stream()
    late = {name: torch.zeros_like(t) for name, t in tensors.items()}
    torch.cuda.synchronize()
    with torch.cuda.stream(stream):
        torch.cuda._sleep(50_000_000)
        for name, t in tensors.items():
            late[name].copy_(t)
        out = call(late)
    stream.synchronize()
    assert torch.equal(out, expected)


@every_call
def test_graph_capture(call):
    tensors = inputs("cuda")
    call(tensors)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        out = call(tensors)
    for t in tensors.values():
        t.mul_(0.5)
    graph.replay()
    assert torch.equal(out, call(tensors))


@every_call
@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two GPUs")
def test_second_device(call):
    assert torch.cuda.current_device() == 0
    out = call(inputs("cuda:1"))
    assert out.device == torch.device("cuda:1")
    assert torch.cuda.current_device() == 0
    torch.testing.assert_close(out.cpu(), call(inputs("cpu")), rtol=1e-4, atol=1e-4)


def test_mixed_devices():
    t = inputs("cuda")
    with pytest.raises((RuntimeError, ValueError), match="device"):
        anynet_ext.warp(t["left"], t["disparity"].cpu())


def test_mixed_devices_of_raw_operators():
    """Tensors that no Python function checks, one at a time on the CPU."""
    ops, image = torch.ops.anynet, torch.zeros(8, 8, 3, dtype=torch.uint8)
    values, vector = torch.rand(2, 2, 4), torch.rand(2)
    calls = [
        (
            ops.stem,
            (image, image, torch.rand(3), torch.rand(2, 3, 3, 3), vector, torch.rand(2, 2, 3, 3), vector, vector),
        ),
        (ops.batch_norm_relu_backward, (values, values, *[vector] * 4)),
    ]
    for op, tensors in calls:
        numbers = () if op is ops.stem else (1e-5,)
        for i in range(len(tensors)):
            mixed = [t if k == i else t.cuda() for k, t in enumerate(tensors)]
            with pytest.raises(RuntimeError, match=r"expected all tensors on one device, got c.*, for .*, c"):
                op(*mixed, *numbers)
