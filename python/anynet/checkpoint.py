"""Weights on disk: our .safetensors (weights, configuration, metadata) and the authors' released .tar."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from anynet import legacy
from anynet.authors import read_authors
from anynet.errors import AnyNetError, one_line
from anynet.io.files import write_atomically
from anynet.model.anynet import AnyNet
from anynet.model.config import AnyNetConfig
from anynet.model.presets import authors
from anynet.shutdown import computing

if TYPE_CHECKING:
    from anynet.baselines.model import BaselineModel

PACKAGED = Path(__file__).parent / "weights"
LIMIT = 2**30  # bytes of a file
HEADER_LIMIT = 2**20  # characters of its configuration, and of its metadata


def save_checkpoint(
    path: str | os.PathLike[str], model: AnyNet | BaselineModel, metadata: dict[str, Any] | None = None
) -> None:
    """Writes weights, configuration and `metadata` (anything JSON can hold) as .safetensors, whole or not at all.

    Weights of any floating-point type are stored as float32.

    Raises:
        AnyNetError: if `load_checkpoint` would refuse the file, or it cannot be written.
    """
    config = model.config
    # Compiled modules have names of their own.
    tensors = {name.replace("_orig_mod.", ""): _stored(t) for name, t in model.state_dict().items()}
    network: Any = AnyNet if isinstance(config, AnyNetConfig) else type(getattr(model, "_orig_mod", model))
    with torch.device("meta"):
        own = network(config).float().state_dict()
    check_tensors(Path(path), config, tensors, own)
    try:
        header = {"config": json.dumps(asdict(config)), "metadata": json.dumps(metadata or {})}
        for name in header:
            stored_object(header, name)
    except (TypeError, ValueError, RecursionError) as error:
        raise AnyNetError(f"cannot write {path}: {one_line(error)}") from None
    write_atomically(path, save(tensors, header))


def _stored(tensor: Tensor) -> Tensor:
    """In memory of its own, which tied weights have not. What `check_tensors` refuses stays what it is."""
    if tensor.is_meta or not _is_dense(stored := tensor.cpu()):
        return tensor
    return (stored.float() if stored.is_floating_point() else stored).clone(memory_format=torch.contiguous_format)


@computing()
def load_checkpoint(weights: str | os.PathLike[str], input_scale: float | None = None) -> AnyNet:
    """The network with its weights, in eval mode, on the CPU.

    Args:
        weights: the name of packaged weights ("default"), or the path of a .safetensors file of `save_checkpoint` or of
            a .tar that the authors released. No code in the file is run.
        input_scale: resize the images by this factor first (`AnyNetConfig`). Default: what the weights say.

    Raises:
        AnyNetError: if there is no such file, or it is not a checkpoint of this network, or not all of it is finite.
    """
    stored = _read(find_weights(weights))
    config = stored.config if input_scale is None else stored.config.with_input_scale(input_scale)
    with torch.device("meta"):
        model = AnyNet(config).float()  # whatever the default is
    check_tensors(stored.path, config, stored.tensors, model.state_dict())
    # PyTorch's own format keeps strides, and the operators want none.
    model.load_state_dict({name: tensor.detach().contiguous() for name, tensor in stored.tensors.items()}, assign=True)
    return model.eval()


@computing()
def load_partial(weights: str | os.PathLike[str], config: AnyNetConfig) -> AnyNet:
    """A network of this configuration, in eval mode, with all weights that have their place in it.

    Tensors of other names or shapes are left out, and what then lacks weights begins as a new network's does.

    Raises:
        AnyNetError: as `load_checkpoint`, or if no weights have a place.
    """
    stored = _read(find_weights(weights))
    model = AnyNet(config).float()
    own = model.state_dict()
    fitting = {n: t for n, t in stored.tensors.items() if n in own and _is_dense(t) and own[n].shape == t.shape}
    if not fitting:
        raise AnyNetError(f"{stored.path}: expected weights of a part of the network, got none")
    check_tensors(stored.path, config, fitting, {name: own[name] for name in fitting})
    model.load_state_dict(fitting, strict=False)
    return model.eval()


def load_metadata(weights: str | os.PathLike[str]) -> dict[str, Any]:
    """What `save_checkpoint` was given as metadata."""
    return _read(find_weights(weights)).metadata


def find_weights(weights: str | os.PathLike[str]) -> Path:
    """The file of a packaged name or path."""
    packaged = {file.stem: file for file in sorted(PACKAGED.glob("*.safetensors"))}
    if str(weights) in packaged:
        return packaged[str(weights)]
    try:
        path = Path(weights)
        found = os.path.isfile(path)  # unlike Path's, it takes names that are too long for the system
    except TypeError:  # no name at all
        found = False
    if not found:
        names = ", ".join(packaged) or "none"
        raise AnyNetError(f"expected a file of weights or a packaged name ({names}), got {str(weights)!r}")
    return path


@dataclass(frozen=True)
class _Checkpoint:
    """A file's content, not yet known to fit together."""

    path: Path
    config: AnyNetConfig
    tensors: dict[str, Tensor]
    metadata: dict[str, Any]


def check_tensors(path: Path, config: object, tensors: Mapping[str, Tensor], own: Mapping[str, Tensor]) -> None:
    """Raises AnyNetError unless a file's tensors are those of the configured network, whose own are `own`; finite."""

    def expected(what: str) -> AnyNetError:
        return AnyNetError(f"{path}: expected weights of {config}; {what}")

    if surplus := [name for name in tensors if name not in own]:
        raise expected(f"the network has no {', '.join(surplus)[:200]}")
    for name, tensor in own.items():
        stored = tensors.get(name)
        if stored is None:
            raise expected(f"{name} is missing")
        if not _is_dense(stored):
            raise expected(f"{name} is no dense tensor on the CPU")
        if stored.shape != tensor.shape:
            raise expected(f"{name} has shape {list(stored.shape)}, not {list(tensor.shape)}")
        if stored.dtype != tensor.dtype:
            raise expected(f"{name} is {stored.dtype}, not {tensor.dtype}")
        if not stored.isfinite().all():
            raise AnyNetError(f"{path}: expected finite weights, got NaN or infinity in {name}")
        if name.endswith("running_var") and (stored < 0).any():
            raise AnyNetError(f"{path}: expected variances of at least 0, got {stored.min():g} in {name}")


def _is_dense(value: object) -> bool:
    """Whether what a file has under a tensor's name is one with values in memory."""
    return (
        isinstance(value, Tensor)
        and not value.is_nested
        and value.layout == torch.strided
        and value.device.type == "cpu"
    )


def _read(path: Path) -> _Checkpoint:
    try:
        with path.open("rb") as file:
            # A safetensors file begins with the length of its JSON header, 8 bytes, and then the header.
            ours = file.read(9)[8:] == b"{"
        if ours:
            return _ours(path, *read_safetensors(path))
        _check_size(path)
        tensors = read_authors(path)
    except OSError as error:
        raise AnyNetError(f"{path}: cannot be read: {error.strerror}") from None
    return _Checkpoint(path, authors(), tensors, {})


def _check_size(path: Path) -> None:
    size = path.stat().st_size
    if size > LIMIT:
        raise AnyNetError(f"{path}: expected a file of at most {LIMIT} bytes, got {size}")


def read_safetensors(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """The texts in the header of such a file, and its tensors.

    Raises:
        AnyNetError: if it is not sound, or larger than `LIMIT`.
        OSError: if it cannot be read.
    """
    _check_size(path)
    try:
        with safe_open(path, "pt") as file:
            header = file.metadata() or {}
            # Copies: what is mapped would change, or vanish, with the file.
            tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118 (not a dict)
    except OSError:
        raise
    except (SafetensorError, ValueError, TypeError, RuntimeError, AttributeError) as error:
        raise AnyNetError(f"{path}: not a sound .safetensors file: {one_line(error)}") from None
    return header, tensors


def _ours(path: Path, header: Mapping[str, str], tensors: dict[str, Tensor]) -> _Checkpoint:
    try:
        options, metadata = stored_object(header, "config"), stored_object(header, "metadata")
        if legacy.is_legacy(options):
            options = legacy.upgrade_options(options)
            tensors = {legacy.upgrade_name(name): tensor for name, tensor in tensors.items()}
        return _Checkpoint(path, AnyNetConfig.from_dict(options), tensors, metadata)
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise AnyNetError(f"{path}: its configuration is not AnyNet's: {one_line(error)}") from None


def stored_object(header: Mapping[str, str], name: str) -> dict[str, Any]:
    """A JSON object out of a file's header.

    Raises:
        KeyError, ValueError, RecursionError: if there is none.
    """
    text = header[name]
    if len(text) > HEADER_LIMIT:
        raise AnyNetError(f"expected {name} of at most {HEADER_LIMIT} characters, got {len(text)}")
    value = json.loads(text)
    if not isinstance(value, dict):
        raise AnyNetError(f"expected {name} as a JSON object, got {type(value).__name__}")
    return value
