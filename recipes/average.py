"""The mean of several weights of one network: python recipes/average.py OUT A B ..., all .safetensors files.

One that is named twice counts twice.
"""

from __future__ import annotations

import sys

import torch

from anynet import load_checkpoint, save_checkpoint
from anynet.checkpoint import load_metadata


def main() -> None:
    out, *files = sys.argv[1:]
    model = load_checkpoint(files[0])
    states = [load_checkpoint(file).state_dict() for file in files]
    for name, tensor in model.state_dict().items():
        if tensor.is_floating_point():
            tensor.copy_(torch.stack([state[name] for state in states]).mean(0))
    save_checkpoint(out, model, {"mean_of": [load_metadata(file) for file in files]})


if __name__ == "__main__":
    main()
