"""The weights that the authors released (.tar): their names and shapes in ours."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from anynet.errors import AnyNetError

# The authors number their modules; a pre-activation layer is 0 norm, 1 ReLU, 2 convolution.
_LAYER = {"0": "norm", "2": "conv"}
_NAMES: list[tuple[str, Callable[[re.Match[str]], str]]] = [
    (r"feature_extraction.block0.0.0.(\w+)", lambda m: f"features.first.{m[1]}"),
    (r"feature_extraction.block0.0.1.([02]).(\w+)", lambda m: f"features.halve.{_LAYER[m[1]]}.{m[2]}"),
    (
        r"feature_extraction.block0.1.(\d).([02]).(\w+)",
        lambda m: f"features.down.0.{int(m[1]) - 1}.{_LAYER[m[2]]}.{m[3]}",
    ),
    (
        r"feature_extraction.blocks.(\d).(\d).([02]).(\w+)",
        lambda m: f"features.down.{int(m[1]) + 1}.{int(m[2]) - 1}.{_LAYER[m[3]]}.{m[4]}",
    ),
    (
        r"feature_extraction.upblocks.(\d).conv.(\d).([02]).(\w+)",
        lambda m: f"features.up.{m[1]}.{m[2]}.{_LAYER[m[3]]}.{m[4]}",
    ),
    (r"volume_postprocess.0.(\d).([02]).(\w+)", lambda m: f"first_stage.network.{m[1]}.{_LAYER[m[2]]}.{m[3]}"),
    (
        r"volume_postprocess.([12]).(\d).([02]).(\w+)",
        lambda m: f"residual_stages.{int(m[1]) - 1}.network.{m[2]}.{_LAYER[m[3]]}.{m[4]}",
    ),
    (r"refine_spn.0.(\d).(\w+)", lambda m: f"refinement.guidance.{int(m[1]) // 2}.{m[2]}"),  # ReLUs between them
    (r"refine_spn.1.(\w+)", lambda m: f"refinement.expand.{m[1]}"),
    (r"refine_spn.2.(\w+)", lambda m: f"refinement.reduce.{m[1]}"),
]


def read_authors(path: Path) -> dict[str, Tensor]:
    """The tensors of such a file, by our names. No code in the file is run.

    Raises:
        AnyNetError: if it is not one.
        OSError: if it cannot be read.
    """
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except OSError:
        raise
    except Exception:  # torch.load raises a dozen types on foreign bytes, and advises to switch its safety off
        raise AnyNetError(f"{path}: expected weights, .safetensors or the authors' .tar, got another file") from None
    theirs = stored.get("state_dict") if isinstance(stored, dict) else None
    if not isinstance(theirs, dict):
        raise AnyNetError(f"{path}: expected weights, .safetensors or the authors' .tar, got no state_dict")
    tensors = {_our_name(path, str(name)): tensor for name, tensor in theirs.items()}
    # Their version of PyTorch did not count batches yet.
    norms = [name.removesuffix("running_mean") for name in tensors if name.endswith(".running_mean")]
    return {**{f"{norm}num_batches_tracked": torch.tensor(0) for norm in norms}, **tensors}


def _our_name(path: Path, name: str) -> str:
    for pattern, ours in _NAMES:
        if match := re.fullmatch(pattern, name.removeprefix("module.")):
            return ours(match)
    # Also a name of ours: such a network need not be configured as theirs is.
    raise AnyNetError(f"{path}: expected names of the authors' tensors, got {name[:200]!r}")
