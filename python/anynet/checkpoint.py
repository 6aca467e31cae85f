"""Weights on disk: our .safetensors (weights, configuration, metadata) and the authors' released .tar."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from anynet.config import AnyNetConfig
from anynet.errors import AnyNetError
from anynet.io.files import write_atomically
from anynet.network import AnyNet

PACKAGED = Path(__file__).parent / "weights"


def save_checkpoint(path: str | os.PathLike[str], model: AnyNet, metadata: dict[str, Any] | None = None) -> None:
    """Writes weights, configuration and `metadata` (anything JSON can hold) as .safetensors, whole or not at all."""
    tensors = {name: tensor.contiguous() for name, tensor in model.state_dict().items()}
    content = save(tensors, {"config": json.dumps(asdict(model.config)), "metadata": json.dumps(metadata or {})})
    write_atomically(path, content)


def load_checkpoint(
    weights: str | os.PathLike[str], input_scale: int | None = None, *, into: AnyNetConfig | None = None
) -> AnyNet:
    """The network with its weights, in eval mode, on the CPU.

    Args:
        weights: the name of packaged weights ("default"), or the path of a .safetensors file of `save_checkpoint` or of
            a .tar that the authors released. No code in the file is run.
        input_scale: 2 to enlarge the images to twice their size first, 1 not to. Default: what the weights say.
        into: a network that has all their parts, and others besides, which begin as a new network's do. One with
            `neighbours` takes those of one without, but for the residual stages.

    Raises:
        AnyNetError: if there is no such file, or it is not a checkpoint of this network.
    """
    path = find_weights(weights)
    model, state, _ = _read(path)
    if into is not None:
        model = AnyNet(into)
    if input_scale is not None:
        model = AnyNet(model.config.with_input_scale(input_scale))
    try:
        if into is not None and into.neighbours:  # its residual stages are of another kind
            state = {name: value for name, value in state.items() if not re.match(r"cost_nets\.[1-9]", name)}
        surplus = model.load_state_dict(state, strict=into is None).unexpected_keys
        if surplus:
            raise RuntimeError(f"the network has no {', '.join(surplus)}")
    except RuntimeError as error:
        raise AnyNetError(f"{path}: expected weights of {model.config}; {_one_line(error)}") from None
    return model.eval()


def load_metadata(weights: str | os.PathLike[str]) -> dict[str, Any]:
    """What `save_checkpoint` was given as metadata."""
    return _read(find_weights(weights))[2]


def find_weights(weights: str | os.PathLike[str]) -> Path:
    """The file of a packaged name or path."""
    packaged = {file.stem: file for file in sorted(PACKAGED.glob("*.safetensors"))}
    if str(weights) in packaged:
        return packaged[str(weights)]
    path = Path(weights)
    if not path.is_file():
        names = ", ".join(packaged) or "none"
        raise AnyNetError(f"expected a file of weights or a packaged name ({names}), got {str(weights)!r}")
    return path


def _read(path: Path) -> tuple[AnyNet, dict[str, Tensor], dict[str, Any]]:
    try:
        with path.open("rb") as file:
            # A safetensors file begins with the length of its JSON header, 8 bytes, and then the header.
            if file.read(9)[8:] == b"{":
                return _read_safetensors(path)
        return _read_official(path)
    except OSError as error:
        raise AnyNetError(f"{path}: cannot be read: {error.strerror}") from None


def _read_safetensors(path: Path) -> tuple[AnyNet, dict[str, Tensor], dict[str, Any]]:
    try:
        with safe_open(path, "pt") as file:
            header = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except SafetensorError as error:
        raise AnyNetError(f"{path}: not a sound .safetensors file: {_one_line(error)}") from None
    try:
        options = {k: _tuple(v) for k, v in json.loads(header["config"]).items()}
        return AnyNet(AnyNetConfig(**options)), state, json.loads(header["metadata"])
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError, AnyNetError) as error:
        raise AnyNetError(f"{path}: its configuration is not AnyNet's: {_one_line(error)}") from None


# The authors number their modules; a pre-activation layer is 0 norm, 1 ReLU, 2 convolution.
_PARTS = {"0": "norm", "2": "conv"}
_OFFICIAL_NAMES: list[tuple[str, Callable[[re.Match[str]], str]]] = [
    (r"feature_extraction.block0.0.0.(\w+)", lambda m: f"features.first.{m[1]}"),
    (r"feature_extraction.block0.0.1.(\d).(\w+)", lambda m: f"features.halve.{_PARTS[m[1]]}.{m[2]}"),
    (
        r"feature_extraction.block0.1.(\d).(\d).(\w+)",
        lambda m: f"features.down.0.{int(m[1]) - 1}.{_PARTS[m[2]]}.{m[3]}",
    ),
    (
        r"feature_extraction.blocks.(\d).(\d).(\d).(\w+)",
        lambda m: f"features.down.{int(m[1]) + 1}.{int(m[2]) - 1}.{_PARTS[m[3]]}.{m[4]}",
    ),
    (
        r"feature_extraction.upblocks.(\d).conv.(\d).(\d).(\w+)",
        lambda m: f"features.up.{m[1]}.{m[2]}.{_PARTS[m[3]]}.{m[4]}",
    ),
    (r"volume_postprocess.(\d).(\d).(\d).(\w+)", lambda m: f"cost_nets.{m[1]}.{m[2]}.{_PARTS[m[3]]}.{m[4]}"),
    (r"refine_spn.0.(\d).(\w+)", lambda m: f"refinement.guidance.{int(m[1]) // 2}.{m[2]}"),  # ReLUs between them
    (r"refine_spn.1.(\w+)", lambda m: f"refinement.expand.{m[1]}"),
    (r"refine_spn.2.(\w+)", lambda m: f"refinement.reduce.{m[1]}"),
]


def _our_name(official: str) -> str:
    for pattern, name in _OFFICIAL_NAMES:
        if match := re.fullmatch(pattern, official.removeprefix("module.")):
            return name(match)
    return official


def _read_official(path: Path) -> tuple[AnyNet, dict[str, Tensor], dict[str, Any]]:
    try:
        official = torch.load(path, map_location="cpu", weights_only=True)["state_dict"]
        state = {_our_name(name): tensor for name, tensor in official.items()}
    except OSError:
        raise
    except Exception as error:  # torch.load raises a dozen types on foreign bytes
        raise AnyNetError(
            f"{path}: expected .safetensors or the authors' .tar; {type(error).__name__}: {_one_line(error)}"
        ) from None
    return AnyNet(AnyNetConfig(reversed_residuals=True)), state, {}


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]


def _tuple(value: Any) -> Any:
    return tuple(_tuple(v) for v in value) if isinstance(value, list) else value
