from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from anynet import AnyNet, Predictor, load_checkpoint
from anynet.authors import _our_name, read_authors
from anynet.errors import AnyNetError
from anynet.model import presets

# Of a file as the authors release them: what stands before a layer's number, and that number.
LAYERS = {
    "feature_extraction.block0.0.1.": "features.halve.",
    "feature_extraction.block0.1.2.": "features.down.0.1.",
    "feature_extraction.blocks.1.1.": "features.down.2.0.",
    "feature_extraction.upblocks.0.conv.1.": "features.up.0.1.",
    "volume_postprocess.0.3.": "first_stage.network.3.",
    "volume_postprocess.2.5.": "residual_stages.1.network.5.",
}
OTHERS = {
    "feature_extraction.block0.0.0.weight": "features.first.weight",
    "feature_extraction.block0.0.0.bias": "features.first.bias",
    "refine_spn.0.4.weight": "refinement.guidance.2.weight",
    "refine_spn.1.weight": "refinement.expand.weight",
    "refine_spn.2.weight": "refinement.reduce.weight",
}


def test_names(tmp_path: Path) -> None:
    own = AnyNet(presets.authors()).state_dict()
    theirs: dict[str, Tensor] = {f"module.{name}": own[ours] for name, ours in OTHERS.items()}
    expected = set(OTHERS.values())
    for before, ours in LAYERS.items():
        for number, tensor in (("0", "norm.weight"), ("0", "norm.running_mean"), ("2", "conv.weight")):
            theirs[f"module.{before}{number}.{tensor.split('.')[1]}"] = own[ours + tensor]
            expected.add(ours + tensor)
        expected.add(f"{ours}norm.num_batches_tracked")  # which their version of PyTorch lacks
    torch.save({"state_dict": theirs, "epoch": 3}, tmp_path / "theirs.tar")
    read = read_authors(tmp_path / "theirs.tar")
    assert read.keys() == expected
    assert all(torch.equal(tensor, own[name]) for name, tensor in read.items())
    with pytest.raises(AnyNetError, match=r"theirs.tar: expected weights of .* is missing"):
        load_checkpoint(tmp_path / "theirs.tar")


@pytest.mark.parametrize(
    "content",
    [{}, {"state_dict": 3}, {"state_dict": {3: torch.zeros(1)}}, {"state_dict": {"a\nb": torch.zeros(1)}}, [1, 2]],
)
def test_other_files(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / "other.tar")
    with pytest.raises(AnyNetError, match=r"other\.tar[^\n]*\Z"):
        load_checkpoint(tmp_path / "other.tar")


def test_our_own_names_are_not_theirs(tmp_path: Path) -> None:
    """Their networks reverse the residual stages' disparities; these weights would be read as such ones."""
    torch.save({"state_dict": AnyNet(presets.paper()).state_dict()}, tmp_path / "mine.tar")
    with pytest.raises(AnyNetError, match=r"mine\.tar: expected names of the authors' tensors, got 'features\."):
        load_checkpoint(tmp_path / "mine.tar")


def whole() -> dict[str, Tensor]:
    """All tensors of a network, by the authors' names."""
    layers = ["feature_extraction.block0.0.1", "feature_extraction.block0.1.1", "feature_extraction.block0.1.2"]
    for i, k in product((0, 1), repeat=2):
        layers += [f"feature_extraction.blocks.{i}.{k + 1}", f"feature_extraction.upblocks.{i}.conv.{k}"]
    layers += [f"volume_postprocess.{i}.{k}" for i, k in product(range(3), range(6))]
    tensors = "0.weight", "0.bias", "0.running_mean", "0.running_var", "2.weight"
    names = [f"{layer}.{tensor}" for layer, tensor in product(layers, tensors)]
    names += [*OTHERS, *(f"refine_spn.0.{k}.weight" for k in (0, 2, 6))]
    own = AnyNet(presets.authors()).state_dict()
    return {f"module.{name}": own[_our_name(Path(), name)] for name in names}


@pytest.mark.parametrize(
    "lay_out",
    [lambda t: t.to(memory_format=torch.channels_last), lambda t: t[:1].expand(t.shape), lambda t: t.requires_grad_()],
)
def test_weights_of_any_strides(tmp_path: Path, lay_out: Callable[[Tensor], Tensor]) -> None:
    theirs, name = whole(), "module.refine_spn.0.2.weight"
    theirs[name] = lay_out(theirs[name])
    torch.save({"state_dict": theirs}, tmp_path / "theirs.tar")
    image = np.zeros((16, 16, 3), np.uint8)
    assert np.isfinite(Predictor(tmp_path / "theirs.tar").predict(image, image).disparity).all()


@pytest.mark.parametrize("change", [Tensor.to_sparse, lambda t: t.to("meta"), lambda t: t.to(torch.complex64), list])
@pytest.mark.parametrize("tensor", ["0.running_var", "2.weight"])
def test_tensors_of_other_kinds(tmp_path: Path, tensor: str, change: Callable[[Tensor], object]) -> None:
    theirs, name = whole(), f"module.feature_extraction.blocks.0.1.{tensor}"
    torch.save({"state_dict": theirs | {name: change(theirs[name])}}, tmp_path / "theirs.tar")
    with pytest.raises(AnyNetError, match=r"theirs\.tar: expected weights of .*; features\.down\.1\.0\.\S+ is "):
        load_checkpoint(tmp_path / "theirs.tar")
