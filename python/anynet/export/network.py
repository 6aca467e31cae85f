"""The deployed network as `torch.export` sees it: images in, one map per stage out."""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

from anynet.checkpoint import load_checkpoint
from anynet.errors import AnyNetError, one_line
from anynet.model.config import AnyNetConfig
from anynet.model.deploy import DeployedAnyNet
from anynet.scheduler import last_stage_of

INPUTS = ("left", "right")
LARGEST_SIDE = 32768  # pixels of an image's height and width


@dataclass(frozen=True)
class Request:
    """What to export.

    Attributes:
        weights: the name of packaged weights, or a path.
        height, width: of the images; of those that a program of any size is traced with.
        stages: how many, from the first; None: all.
        dynamic: for images of any size, from `smallest_side` on; for pt2 alone.
    """

    weights: str | os.PathLike[str]
    height: int
    width: int
    stages: int | None = None
    dynamic: bool = False


class Network(nn.Module):
    """uint8 RGB images [H, W, 3] to the first stages' disparity maps, float32 [H, W], in pixels."""

    def __init__(self, deployed: DeployedAnyNet, stages: int | None) -> None:
        super().__init__()
        self.deployed, self.stages = deployed, stages

    def forward(self, left: Tensor, right: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.deployed(left, right, self.stages))


def outputs(stages: int) -> list[str]:
    return [f"disparity_{stage}" for stage in range(1, stages + 1)]


def smallest_side(config: AnyNetConfig) -> int:
    """The least height and width in pixels for which no tensor on the way is one pixel high or wide.

    That is the border between two kinds of graphs for PyTorch, of which a program holds one.
    """
    return (config.stride << config.first_stage.hourglass) + 1


def trace(request: Request) -> ExportedProgram:
    """The program of a request, with our operators in it.

    Raises:
        AnyNetError: if the weights, their `input_scale`, the size or the stages cannot be exported.
    """
    model = load_checkpoint(request.weights)
    config = model.config
    if config.zoom != 1:
        raise AnyNetError(
            f"export: expected weights of input_scale 1 or 2, got {config.input_scale:g}: its images are resized "
            "before the network"
        )
    stages = last_stage_of("export", request.stages, config.stages, "stages")
    least = smallest_side(config) if request.dynamic else 1
    for name, side in (("height", request.height), ("width", request.width)):
        if type(side) is not int or not least <= side <= LARGEST_SIDE:
            raise AnyNetError(f"export: expected {name} as an integer from {least} to {LARGEST_SIDE}, got {side!r}")
    network = Network(DeployedAnyNet(model), stages).eval()
    # Two tensors: of one that stands for both images, PyTorch would make one input.
    images = tuple(torch.zeros(request.height, request.width, 3, dtype=torch.uint8) for _ in INPUTS)
    shapes = None
    if request.dynamic:
        size = {i: Dim(name, min=least, max=LARGEST_SIDE) for i, name in enumerate(("height", "width"))}
        shapes = {name: size for name in INPUTS}
    with torch.no_grad():
        try:
            # Deferred: what PyTorch cannot prove of all sizes is checked when the program runs.
            return torch.export.export(
                network, images, dynamic_shapes=shapes, prefer_deferred_runtime_asserts_over_guards=request.dynamic
            )
        except RuntimeError as error:
            raise AnyNetError(f"export: PyTorch cannot trace this network: {one_line(error)}") from error


def check_one_size(request: Request, format: str) -> None:
    if request.dynamic:
        raise AnyNetError(f"export: expected images of one size for {format}, got dynamic, which pt2 alone can be")
