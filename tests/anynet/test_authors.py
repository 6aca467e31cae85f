from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from anynet import AnyNet, load_checkpoint
from anynet.authors import read_authors
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
