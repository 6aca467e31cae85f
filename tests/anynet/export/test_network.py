from __future__ import annotations

from pathlib import Path

import pytest
import torch
from networks import wild

from anynet import AnyNetConfig, AnyNetError, save_checkpoint
from anynet.export import FORMATS, export_as
from anynet.export.network import Request, smallest_side, trace
from anynet.model import presets

from .cases import OPTIONS, network


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (Request("default", 0, 64), "expected height as an integer from 1 to 32768, got 0"),
        (Request("default", 64, 40000), "expected width as an integer from 1 to 32768, got 40000"),
        (Request("paper", 64, 16, dynamic=True), "expected width as an integer from 17 to 32768, got 16"),
        (Request("paper", "32", 48), "expected height as an integer from 1 to 32768, got '32'"),  # type: ignore[arg-type]
        (Request("paper", 32, 48.0), r"expected width as an integer from 1 to 32768, got 48\.0"),  # type: ignore[arg-type]
        (Request("paper", 32, 48, stages="2"), "expected stages from 1 to 4, got '2'"),  # type: ignore[arg-type]
        (Request("paper", 32, 48, stages=2.0), r"expected stages from 1 to 4, got 2\.0"),  # type: ignore[arg-type]
        (Request("default", 64, 64, stages=5), "expected stages from 1 to 4, got 5"),
        (Request("none", 64, 64), "expected a file of weights"),
    ],
)
def test_what_cannot_be_met_is_told(request_: Request, message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        trace(request_)


def test_other_input_scales_are_refused(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "half.safetensors", wild(AnyNetConfig(input_scale=0.5)))
    with pytest.raises(AnyNetError, match=r"expected weights of input_scale 1 or 2, got 0\.5"):
        trace(Request(tmp_path / "half.safetensors", 64, 64))


def test_formats_that_there_are_not(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="export: expected format onnx, pt2, aoti, got 'network'"):
        export_as("network", Request("paper", 64, 64), str(tmp_path / "a.pt2"))


def test_a_folder_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"cannot write .*network\.pt2: No such file or directory"):
        export_as("pt2", Request("paper", 64, 64), tmp_path / "none" / "network.pt2")


@pytest.mark.parametrize("format", FORMATS)
def test_an_error_of_the_work_is_not_one_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, format: str
) -> None:
    def full_cache(request: Request) -> None:
        raise OSError(28, "No space left on device", "/cache/kernel.so")

    monkeypatch.setattr(f"anynet.export.{format}.trace", full_cache)
    with pytest.raises(OSError, match=r"/cache/kernel\.so"):
        export_as(format, Request("paper", 64, 64), tmp_path / "network.pt2")
    assert not list(tmp_path.iterdir())


def test_smallest_sides() -> None:
    assert smallest_side(presets.paper()) == 17
    assert smallest_side(presets.paper().with_options({"first_stage.hourglass": 2, "input_scale": 2})) == 33


def test_stages_are_the_first_ones(small_weights: Path) -> None:
    left, right = torch.randint(0, 256, (2, 40, 56, 3), dtype=torch.uint8)
    two = trace(Request(small_weights, 40, 56, stages=2)).module()(left, right)
    every = trace(Request(small_weights, 40, 56)).module()(left, right)
    assert (len(two), len(every)) == (2, 4)
    assert all(torch.equal(one, other) for one, other in zip(two, every, strict=False))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(OPTIONS))
def test_every_option_can_be_traced(name: str, tmp_path: Path) -> None:
    model = wild(network(name))
    save_checkpoint(tmp_path / "w.safetensors", model)
    trace(Request(tmp_path / "w.safetensors", 83, 141, dynamic=True))
