"""Networks and inputs that several tests share."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from anynet import AnyNet, AnyNetConfig
from anynet.model.layers import Convolution


def wild(config: AnyNetConfig | None = None, seed: int = 8) -> AnyNet:
    """Random weights of larger scales than training begins with: disparities from -40 to 200, mostly positive."""
    model = AnyNet(config)
    torch.manual_seed(seed)
    for module in model.modules():
        if isinstance(module, Convolution):
            nn.init.normal_(module.weight, std=math.sqrt(2 / module.weight[:, 0].numel()))
    return model.eval()


def with_weights_of(model: AnyNet, **parts: Any) -> AnyNet:
    """The same weights in a network of which some parts are configured otherwise."""
    other = AnyNet(replace(model.config, **parts)).eval()
    other.load_state_dict(model.state_dict())
    return other


def pair(height: int, width: int, batch: int = 1) -> tuple[Tensor, Tensor]:
    """Two images of noise."""
    generator = torch.Generator().manual_seed(height * width)
    left, right = (torch.randn(batch, 3, height, width, generator=generator) for _ in range(2))
    return left, right


def trained(module: nn.Module) -> nn.Module:
    """With batch norms that do something, and weights that begin as 0 random."""
    torch.manual_seed(1)
    for part in module.modules():
        if isinstance(part, (nn.BatchNorm2d, nn.BatchNorm3d)):
            for tensor in (part.weight, part.bias, part.running_mean):
                nn.init.normal_(tensor)  # type: ignore[arg-type]
            nn.init.uniform_(part.running_var, 0.5, 2)  # type: ignore[arg-type]
        elif isinstance(part, Convolution):
            nn.init.normal_(part.weight, std=0.3)
    return module.eval()


def picture(*shape: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))
