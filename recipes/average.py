"""The mean of several weights of one network: python recipes/average.py OUT A B ..., all .safetensors files.

One that is named twice counts twice.
"""

from __future__ import annotations

import sys

import torch

from anynet import load_checkpoint, save_checkpoint
from anynet.checkpoint import load_metadata
from anynet.errors import AnyNetError


def main() -> None:
    out, *files = sys.argv[1:] or [""]
    if not files:
        raise AnyNetError(f"expected OUT and files of weights, got {out or 'nothing'}")
    model = load_checkpoint(files[0])
    states = []
    for file in files:
        other = load_checkpoint(file)
        if other.config != model.config:
            raise AnyNetError(f"expected weights of the network of {files[0]}, got {file}'s")
        states.append(other.state_dict())
    for name, tensor in model.state_dict().items():
        if tensor.is_floating_point():
            tensor.copy_(torch.stack([state[name] for state in states]).mean(0))
    save_checkpoint(out, model, {"mean_of": [load_metadata(file) for file in files]})


if __name__ == "__main__":
    try:
        main()
    except AnyNetError as error:
        sys.exit(str(error))
