from __future__ import annotations

import os
import pickle
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from skimage.data import stereo_motorcycle

from anynet import AnyNet, AnyNetConfig, Predictor, load_checkpoint, save_checkpoint
from anynet.checkpoint import PACKAGED, load_metadata
from anynet.errors import AnyNetError
from anynet.evaluation.metrics import scores
from anynet.model.config import MEAN, STD, FirstStageConfig, RefinementConfig

SHARED = Path(__file__).parents[2] / ".." / "shared"
needs_shared = pytest.mark.skipif(not SHARED.exists(), reason="the authors' weights and KITTI are not in ../shared")


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "weights.safetensors"
    save_checkpoint(path, AnyNet(), {"epochs": 3})
    return path


def test_round_trip(tmp_path: Path) -> None:
    torch.manual_seed(0)
    config = AnyNetConfig(first_stage=FirstStageConfig(channels=8), refinement=RefinementConfig(directions=(0, 1)))
    model = AnyNet(config)
    model(*torch.randn(2, 1, 3, 32, 32))  # moves the batch-norm statistics
    path = tmp_path / "weights.safetensors"
    save_checkpoint(path, model, {"trained_on": ["a", "b"]})
    loaded = load_checkpoint(path)
    assert loaded.config == config
    assert not loaded.training
    assert loaded.state_dict().keys() == model.state_dict().keys()
    for name, tensor in model.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor), name
    assert load_metadata(path) == {"trained_on": ["a", "b"]}


@pytest.mark.parametrize("name", sorted(file.stem for file in PACKAGED.glob("*.safetensors")))
def test_packaged_weights_are_trained(name: str) -> None:
    """On a real pair that no training saw, each stage is better than the one before, or at most a little worse."""
    left, right, truth = stereo_motorcycle()
    known = np.isfinite(truth) & (truth > 0)
    d1 = [scores(e.disparity, truth, known).d1 for e in Predictor(name).stages(left, right)]
    assert d1[-1] < 25
    assert d1[-1] < 0.9 * d1[0]
    assert all(later < 1.1 * before for before, later in pairwise(d1))
    assert (PACKAGED / f"{name}.md").exists()
    assert "recipe" in load_metadata(PACKAGED / f"{name}.safetensors")


def test_a_failed_save_leaves_the_old_file_and_nothing_else(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    before = saved.read_bytes()
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(AnyNetError, match=r"cannot write .*weights.safetensors: No space left on device"):
        save_checkpoint(saved, AnyNet())
    assert saved.read_bytes() == before
    assert os.listdir(saved.parent) == [saved.name]


def test_missing_and_foreign_files(tmp_path: Path, saved: Path) -> None:
    with pytest.raises(AnyNetError, match=r"packaged name .* got 'nowhere.tar'"):
        load_checkpoint("nowhere.tar")
    with pytest.raises(AnyNetError, match=r"packaged name"):
        load_checkpoint(tmp_path)
    for name, content in {
        "empty": b"",
        "text": b"not a checkpoint at all",
        "cut.safetensors": saved.read_bytes()[:2000],
        "half.safetensors": saved.read_bytes()[:-1000],
        "number.tar": pickle.dumps(3),
    }.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(AnyNetError, match=name):
            load_checkpoint(tmp_path / name)
    torch.save({"weights": torch.zeros(3)}, tmp_path / "other.tar")
    with pytest.raises(AnyNetError, match=r"other.tar.*state_dict"):
        load_checkpoint(tmp_path / "other.tar")
    torch.save({"state_dict": {"module.fc.weight": torch.zeros(3)}}, tmp_path / "resnet.tar")
    with pytest.raises(AnyNetError, match=r"resnet.tar: expected weights of AnyNetConfig"):
        load_checkpoint(tmp_path / "resnet.tar")
    save_file({"fc.weight": torch.zeros(3)}, tmp_path / "other.safetensors")
    with pytest.raises(AnyNetError, match=r"other.safetensors: its configuration is not AnyNet's"):
        load_checkpoint(tmp_path / "other.safetensors")


def test_no_code_of_a_checkpoint_is_run(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    torch.save({"state_dict": Trap()}, tmp_path / "trap.tar")
    with pytest.raises(AnyNetError, match=r"trap.tar"):
        load_checkpoint(tmp_path / "trap.tar")
    assert not (tmp_path / "sprung").exists()


def d1_per_pair(weights: str, names: list[str]) -> np.ndarray:
    """[pairs, 4]: per cent of the non-occluded pixels wrong by more than 3 px and 5 %, on the authors' crop."""

    def crop(image: np.ndarray) -> np.ndarray:
        """The bottom right 368 x 1232, after black at the top and left where the image is smaller."""
        image = image[-368:, -1232:]
        missing = [(368 - image.shape[0], 0), (1232 - image.shape[1], 0)]
        return np.pad(image, missing + [(0, 0)] * (image.ndim - 2))

    def normalised(path: Path) -> torch.Tensor:
        rgb = crop(cv2.imread(str(path))[..., ::-1]) / 255
        return torch.from_numpy((rgb - MEAN) / STD).permute(2, 0, 1)[None].float()

    folder = SHARED / "data/kitti2015/training"
    model = load_checkpoint(SHARED / "checkpoints" / weights)
    rows = []
    for name in names:
        truth = crop(cv2.imread(str(folder / "disp_noc_0" / name), cv2.IMREAD_UNCHANGED)) / 256
        known = (truth > 0) & (truth < 192)
        with torch.inference_mode():
            estimates = model(normalised(folder / "image_2" / name), normalised(folder / "image_3" / name))
        errors = [np.abs(e[0, 0].numpy() - truth)[known] for e in estimates]
        rows.append([100 * np.mean((e > 3) & (e > 0.05 * truth[known])) for e in errors])
    return np.array(rows)


@needs_shared
def test_official_weights_on_one_pair() -> None:
    errors = d1_per_pair("kitti2015.tar", ["000002_10.png"])[0]
    np.testing.assert_allclose(errors, [17.17, 9.75, 7.11, 6.90], atol=0.05)


@needs_shared
@pytest.mark.slow
@pytest.mark.parametrize(
    ("weights", "published"),
    [("kitti2015.tar", [14.66, 9.97, 6.69, 6.03]), ("sceneflow.tar", [37.13, 30.43, 28.45, 27.96])],
)
def test_official_weights_reproduce_the_authors_errors(weights: str, published: list[float]) -> None:
    names = sorted(p.name for p in (SHARED / "data/kitti2015/training/image_2").glob("*.png"))
    assert len(names) == 35
    np.testing.assert_allclose(d1_per_pair(weights, names).mean(0), published, atol=0.05)
