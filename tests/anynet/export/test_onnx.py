"""ONNX files in onnxruntime and OpenVINO; TensorRT's parser by its list of operators."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from exports import in_double_precision
from networks import wild
from numpy.typing import NDArray

import anynet_ext
from anynet import AnyNetError, save_checkpoint
from anynet.export import export_as
from anynet.export import onnx as exporter
from anynet.export.network import Request

from .cases import OPTIONS, WEIGHTS, Pair, network
from .tensorrt import OPERATORS

onnx = pytest.importorskip("onnx", reason="the extra `export` is not installed")
onnxruntime = pytest.importorskip("onnxruntime", reason="the extra `export` is not installed")
pytest.importorskip("onnxscript", reason="the extra `export` is not installed")

LIMIT, SHARE = 0.01, 0.001  # pixels, and the share of those that may be above it where the network multiplies rounding
LAST_LIMIT = 0.1  # of the few pixels at which propagation, the last stage, multiplies it


def assert_close(
    found: list[NDArray[np.float32]], expected: list[NDArray[np.float32]], weights: str | Path, pair: Pair
) -> None:
    """Within the limit, or, at few pixels, as close as the predictor itself is to the network in double precision."""
    exact = in_double_precision(weights, [pair.left, pair.right])
    assert len(found) == len(expected)
    for stage, (one, other, ideal) in enumerate(zip(found, expected, exact[: len(expected)], strict=True), 1):
        difference, limit = np.abs(one - other), LAST_LIMIT if stage == len(exact) else LIMIT
        assert difference.max() < max(limit, 4 * np.abs(other - ideal).max())
        assert (difference > LIMIT).mean() < SHARE


def operators(graph: onnx.GraphProto) -> Iterator[str]:
    for node in graph.node:
        assert node.domain == ""
        yield node.op_type
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.GRAPH:
                yield from operators(attribute.g)


def in_onnxruntime(path: Path, pair: Pair) -> list[NDArray[np.float32]]:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    found: list[NDArray[np.float32]] = session.run(None, {"left": pair.left, "right": pair.right})
    return found


def test_what_it_needs_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "anynet.export.scan", None)
    with pytest.raises(AnyNetError, match=r"pip install 'anynet\[export\]'"):
        export_as("onnx", Request("default", 40, 56), tmp_path / "network.onnx")


def test_it_is_for_one_size(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected images of one size for onnx"):
        export_as("onnx", Request("default", 40, 56, dynamic=True), tmp_path / "network.onnx")


class Scans(torch.nn.Module):
    def forward(self, x: torch.Tensor, gates: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return tuple(anynet_ext.spatial_propagation(x, gates, direction) for direction in range(4))


def test_propagation_in_all_directions(tmp_path: Path) -> None:
    x, gates = torch.rand(2, 3, 5, 7), torch.rand(2, 3, 3, 5, 7) - 0.4
    exporter.save(torch.export.export(Scans(), (x, gates)), tmp_path / "scans.onnx", ["x", "gates"], list("abcd"))
    session = onnxruntime.InferenceSession(tmp_path / "scans.onnx", providers=["CPUExecutionProvider"])
    found = session.run(None, {"x": x.numpy(), "gates": gates.numpy()})
    for one, other in zip(found, Scans()(x, gates), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_running_minimum() -> None:
    x = torch.rand(2, 3, 77)
    assert torch.equal(exporter._cummin(x, -1)[0], x.cummin(-1).values)


@pytest.mark.slow
@pytest.mark.parametrize("weights", WEIGHTS)
def test_packaged_weights(weights: str, pair: Pair, tmp_path: Path) -> None:
    path = tmp_path / "network.onnx"
    export_as("onnx", Request(weights, *pair.left.shape[:2]), path)
    model = onnx.load(path)
    onnx.checker.check_model(model)
    assert [(opset.domain, opset.version) for opset in model.opset_import] == [("", exporter.OPSET)]
    assert [node.name for node in model.graph.input] == ["left", "right"]
    assert [node.name for node in model.graph.output] == [f"disparity_{k}" for k in (1, 2, 3, 4)]
    assert set(operators(model.graph)) <= OPERATORS
    expected = pair.disparities(weights)
    assert_close(in_onnxruntime(path, pair), expected, weights, pair)
    openvino = pytest.importorskip("openvino")
    compiled = openvino.Core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    results = compiled([pair.left, pair.right])
    assert_close([results[k] for k in range(4)], expected, weights, pair)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(OPTIONS))
def test_every_option(name: str, pair: Pair, tmp_path: Path) -> None:
    weights, path = tmp_path / "w.safetensors", tmp_path / "network.onnx"
    save_checkpoint(weights, wild(network(name)))
    export_as("onnx", Request(weights, *pair.left.shape[:2]), path)
    assert set(operators(onnx.load(path).graph)) <= OPERATORS
    assert_close(in_onnxruntime(path, pair)[:-1], pair.disparities(weights)[:-1], weights, pair)
