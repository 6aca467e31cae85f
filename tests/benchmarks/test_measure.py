"""What the benchmarks share, and that each of them starts."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import measure
import pytest
import torch
from rich.table import Table
from torch import Tensor
from torch.overrides import TorchFunctionMode

import anynet_ext
from anynet import AnyNet

SCRIPTS = sorted(
    path.name for path in Path(measure.__file__).parent.glob("*.py") if path.name not in ("measure.py", "peers.py")
)


class Calls(TorchFunctionMode):
    """The names of the operators of ours that are called."""

    def __init__(self) -> None:
        super().__init__()
        self.names: set[str] = set()

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        overload = function.default if isinstance(function, torch._ops.OpOverloadPacket) else function
        if isinstance(overload, torch._ops.OpOverload) and overload.namespace == "anynet":
            self.names.add(overload._schema.name.removeprefix("anynet::"))
        return function(*args, **(kwargs or {}))


def disparities(model: AnyNet, images: Tensor) -> list[Tensor]:
    with torch.no_grad():
        return list(model(*images))


def test_the_network_on_plain_operators_is_the_same() -> None:
    torch.manual_seed(0)
    model, images = AnyNet().eval(), torch.rand(2, 1, 3, 64, 128)
    with Calls() as calls:
        ours = disparities(model, images)
    assert {"conv3x3", "conv3x3x3", "cost_volume", "resize", "soft_argmin", "spatial_propagation"} <= calls.names
    with Calls() as calls, measure.PlainOperators():
        plain = disparities(model, images)
    assert calls.names == set()
    for one, other in zip(ours, plain, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-3)


def test_only_the_named_operators_are_replaced() -> None:
    with Calls() as calls, measure.PlainOperators(measure.CONVOLUTIONS):
        disparities(AnyNet().eval(), torch.rand(2, 1, 3, 64, 128))
    assert calls.names.isdisjoint(measure.CONVOLUTIONS)
    assert "cost_volume" in calls.names


@pytest.mark.parametrize("name", measure.OPERATORS)
def test_plain_operators_compute_and_learn_the_same(name: str) -> None:
    torch.manual_seed(0)
    x = torch.randn(2, 3, 8, 12, dtype=torch.float64)
    arguments: dict[str, tuple[list[Tensor], dict[str, Any]]] = {
        "conv3x3": ([x, torch.randn(4, 3, 3, 3)], {"stride": 2, "relu_in": True}),
        "conv3x3x3": ([x[:, :, None], torch.randn(4, 3, 3, 3, 3)], {}),
        "batch_norm_relu": ([x, torch.rand(3), torch.rand(3)], {}),
        "cost_volume": ([x, x + 1, 2 * x[:, :1]], {"first": -1, "last": 2}),
        "resize": ([x], {"size": (11, 5), "scale": 2.0}),
        "soft_argmin": ([x], {"first": 1}),
        "spatial_propagation": ([x, torch.rand(2, 3, 3, 8, 12) / 3], {"direction": 1}),
        "warp": ([x, 2 * x[:, :1]], {}),
    }
    tensors, options = arguments[name]
    results = []
    for names in ((), (name,)):
        leaves = [tensor.double().requires_grad_() for tensor in map(Tensor.clone, map(Tensor.detach, tensors))]
        with Calls() as calls, measure.PlainOperators(names):
            out = getattr(anynet_ext, name)(*leaves, **options)
        assert (name in calls.names) == (not names)
        out = out[0] if isinstance(out, tuple) else out
        out.square().sum().backward()
        results.append([out.detach(), *(leaf.grad for leaf in leaves)])
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other)


def test_tables_are_whole_where_the_output_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    output = io.StringIO()
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setenv("COLUMNS", "40")
    table = Table("kernel", "size", "ours")
    table.add_row("cost_volume around a map, backward", "1x32x184x616, 5 offsets", "1.0")
    measure.console().print(table)
    assert "cost_volume around a map, backward" in output.getvalue()
    assert "…" not in output.getvalue()


def test_interleaved_calls_take_turns_and_slow_ones_fewer() -> None:
    calls: list[str] = []
    times = measure.interleaved_ms({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=3)
    assert calls == ["a", "b"] * 5
    assert [len(each) for each in times.values()] == [3, 3]
    few = measure.interleaved_ms({"a": lambda: None}, rounds=3, slow=-1.0, slow_rounds=1)
    assert len(few["a"]) == 1


def test_figures() -> None:
    assert measure.median_ratio([2.0, 9.0, 4.0], [1.0, 3.0, 2.0]) == 2.0
    assert measure.Limits(1, loops={}, operations=1e9, product=5e8, bandwidth=1e6).ms(1e6, 5e3) == 5.0
    left, right = measure.pair(48, 64)
    assert (left[:, 20:] == right[:, :-20]).all()
    figure, axes = measure.subplots(ncols=2)
    assert len(axes) == len(figure.axes) == 2


def test_reports_are_written_where_asked_for(tmp_path: Path) -> None:
    measure.write_json(None, {})
    measure.write_json(tmp_path / "report.json", {"a": [1]})
    assert json.loads((tmp_path / "report.json").read_text()) == {"a": [1]}


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS)
def test_every_benchmark_starts(script: str) -> None:
    path = Path(measure.__file__).with_name(script)
    result = subprocess.run([sys.executable, str(path), "--help"], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith(f"usage: {script}")
