from __future__ import annotations

import json
import os
import pickle
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from time import process_time

import cv2
import numpy as np
import pytest
import torch
from networks import wild
from safetensors.torch import save_file
from skimage.data import stereo_motorcycle
from torch import Tensor, nn

from anynet import AnyNet, AnyNetConfig, Predictor, checkpoint, load_checkpoint, save_checkpoint
from anynet.checkpoint import PACKAGED, load_metadata, load_partial
from anynet.errors import AnyNetError
from anynet.evaluation.metrics import scores
from anynet.model.config import MEAN, STD, FirstStageConfig, RefinementConfig, ResidualStagesConfig
from anynet.model.layers import Convolution

SHARED = Path(__file__).parents[2] / ".." / "shared"
needs_shared = pytest.mark.skipif(not SHARED.exists(), reason="the authors' weights and KITTI are not in ../shared")


HEADER = {"config": json.dumps(asdict(AnyNetConfig())), "metadata": "{}"}


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


def test_loading_weights_does_not_wait_for_pytorchs_compiler() -> None:
    names = sorted(file.stem for file in PACKAGED.glob("*.safetensors"))
    code = (
        f"import sys, anynet\nfor name in {names}: anynet.load_checkpoint(name)\nprint('torch._dynamo' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert names
    assert done.stdout == "False\n"


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
    metadata = load_metadata(PACKAGED / f"{name}.safetensors")
    assert all("recipe" in run for run in metadata.get("mean_of", [metadata]))


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
    with pytest.raises(AnyNetError, match=r"resnet.tar: expected names of the authors' tensors, got 'module.fc.w"):
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


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"residual_stages": {"candidate_radius": 2**63 - 1}}, "candidate_radius as an integer from 0 to 64"),
        ({"residual_stages": {"candidate_radius": 10**6}}, "candidate_radius as an integer from 0 to 64"),
        ({"features": {"channels": 3000}}, "channels as an integer from 1 to 64"),
        ({"features": {"channels": 64}}, "has shape .*, not "),  # possible, but not of these tensors
        ({"features": {"blocks": 60}}, "blocks as an integer from 1 to 5"),
        ({"features": {"layers": 10**7}}, "layers as an integer"),
        ({"first_stage": {"layers": 10**6}}, "layers as an integer"),
        ({"first_stage": {"range": [0, 10**9]}}, "range as"),
        ({"residual_stages": {"ranges": [[3], [-2, 2]]}}, "first <= last"),
        ({"residual_stages": {"ranges": [[-2, 2], [0, 2**64]]}}, "first <= last"),
        ({"residual_stages": {"channels": [0, 0]}}, "channels from 1 to 256"),
        ({"refinement": {"directions": [0.0]}}, "directions of distinct"),
        ({"input_scale": 2.5e300}, "input_scale from"),
        ({"depth": 3}, "got 'depth'"),
        ([1, 2], "config as a JSON object, got list"),
        (None, "config as a JSON object, got NoneType"),
    ],
)
def test_impossible_configurations_cost_neither_time_nor_memory(tmp_path: Path, config: object, message: str) -> None:
    path = tmp_path / "impossible.safetensors"
    save_file(AnyNet().state_dict(), path, {"config": json.dumps(config), "metadata": "{}"})
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, process_time()
    with pytest.raises(AnyNetError, match=f"impossible.safetensors: .*{message}"):
        load_checkpoint(path)
    assert process_time() - start < 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB


@pytest.mark.parametrize(
    "header", ["[" * 3000, "[" * 100_000, "{", "", '{"features": ' * 2000, '"' + "x" * 2**21 + '"']
)
def test_a_header_that_is_no_configuration(tmp_path: Path, header: str) -> None:
    path = tmp_path / "header.safetensors"
    save_file(AnyNet().state_dict(), path, {"config": header, "metadata": "{}"})
    with pytest.raises(AnyNetError, match=r"header.safetensors: its configuration is not AnyNet's"):
        load_checkpoint(path)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_weights_that_are_not_finite(saved: Path, value: float) -> None:
    model = load_checkpoint(saved)
    with torch.no_grad():
        model.refinement.expand.weight[3, 0, 1, 1] = value
    save_file(model.state_dict(), saved, HEADER)
    expected = r"weights.safetensors: expected finite weights, .* in refinement.expand.weight"
    with pytest.raises(AnyNetError, match=expected):
        load_checkpoint(saved)
    with pytest.raises(AnyNetError, match=expected):
        load_partial(saved, AnyNetConfig())
    with pytest.raises(AnyNetError, match=expected):
        save_checkpoint(saved, model)


def test_variances_below_zero(saved: Path) -> None:
    model = load_checkpoint(saved)
    model.features.down[1][0].norm.running_var[0] = -1
    save_file(model.state_dict(), saved, HEADER)
    with pytest.raises(AnyNetError, match=r"expected variances of at least 0, got -1 in features\..*running_var"):
        load_checkpoint(saved)


def test_weights_are_float32_whatever_the_default_is(saved: Path) -> None:
    image = np.zeros((16, 16, 3), np.uint8)
    torch.set_default_dtype(torch.float64)
    try:
        assert all(p.dtype == torch.float32 for p in load_checkpoint(saved).parameters())
        for weights in (saved, "default", "large"):
            estimate = Predictor(weights).predict(image, image, confidence=True, left_right=True)
            assert estimate.disparity.dtype == estimate.confidence.dtype == np.float32
    finally:
        torch.set_default_dtype(torch.float32)


def test_tensors_of_another_type_or_of_nobody(saved: Path) -> None:
    state = AnyNet().state_dict()
    name, variance = "refinement.expand.weight", "features.halve.norm.running_var"
    for change, message in (
        ({name: state[name].half()}, "refinement.expand.weight is torch.float16, not torch.float32"),
        ({name: state[name].to(torch.float8_e4m3fn)}, "refinement.expand.weight is torch.float8_e4m3fn, not"),
        ({variance: state[variance].to(torch.complex64)}, f"{variance} is torch.complex64, not torch.float32"),
        ({"more": torch.zeros(1)}, "the network has no more"),
    ):
        save_file({**state, **change}, saved, HEADER)
        with pytest.raises(AnyNetError, match=message):
            load_checkpoint(saved)
    del state[name]
    save_file(state, saved, HEADER)
    with pytest.raises(AnyNetError, match=r"refinement.expand.weight is missing"):
        load_checkpoint(saved)


@pytest.mark.parametrize("convert", [AnyNet.double, AnyNet.bfloat16])
def test_weights_of_other_types_are_stored_as_float32(saved: Path, convert: Callable[[AnyNet], AnyNet]) -> None:
    model = convert(AnyNet())
    save_checkpoint(saved, model)
    for name, value in load_checkpoint(saved).state_dict().items():
        torch.testing.assert_close(value, model.state_dict()[name].to(value.dtype), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda model: model.requires_grad_(False).refinement.expand.weight.fill_(torch.nan), "finite weights"),
        (lambda model: setattr(model, "refinement", torch.nn.Identity()), r"refinement\.\S+ is missing"),
    ],
)
def test_what_could_not_be_read_is_not_written(saved: Path, change: Callable[[AnyNet], object], message: str) -> None:
    model, before = AnyNet(), saved.read_bytes()
    change(model)
    with pytest.raises(AnyNetError, match=rf"weights\.safetensors: expected .*{message}"):
        save_checkpoint(saved, model)
    assert saved.read_bytes() == before


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"log": "x" * 2**20}, "expected metadata of at most 1048576 characters, got 1048587"),
        ({"names": {1}}, "set is not JSON serializable"),
        ([1], "expected metadata as a JSON object, got list"),
    ],
)
def test_metadata_that_could_not_be_read_is_not_written(saved: Path, metadata: object, message: str) -> None:
    with pytest.raises(AnyNetError, match=rf"cannot write .*weights\.safetensors: .*{message}"):
        save_checkpoint(saved, AnyNet(), metadata)  # type: ignore[arg-type]


def test_compiled_networks_are_written_by_their_own_names(tmp_path: Path) -> None:
    model = AnyNet()
    expected = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    model.features = torch.compile(model.features)  # type: ignore[assignment]
    save_checkpoint(tmp_path / "weights.safetensors", torch.compile(model))  # type: ignore[arg-type]
    loaded = load_checkpoint(tmp_path / "weights.safetensors").state_dict()
    assert loaded.keys() == expected.keys()
    assert all(torch.equal(tensor, expected[name]) for name, tensor in loaded.items())


def test_a_file_larger_than_the_limit(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "LIMIT", 1000)
    with pytest.raises(AnyNetError, match=r"weights.safetensors: expected a file of at most 1000 bytes, got \d+"):
        load_checkpoint(saved)


def test_a_loaded_network_does_not_change_with_its_file(saved: Path) -> None:
    model = load_checkpoint(saved)
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    saved.write_bytes(bytes(saved.stat().st_size))
    assert all(torch.equal(tensor, before[name]) for name, tensor in model.state_dict().items())


def test_partial_weights(tmp_path: Path) -> None:
    path = tmp_path / "wild.safetensors"
    save_checkpoint(path, wild())
    larger = AnyNetConfig(residual_stages=ResidualStagesConfig(channels=(8, 4)))
    stored, partial, fresh = load_checkpoint(path).state_dict(), load_partial(path, larger), AnyNet(larger)
    assert partial.config == larger
    for name, tensor in partial.state_dict().items():
        if stored[name].shape == tensor.shape:
            assert torch.equal(tensor, stored[name]), name
        else:
            assert name.startswith("residual_stages.0.network"), name
            assert tensor.std() < 5 * fresh.state_dict()[name].std() + 1e-6
    save_file({"fc": torch.zeros(3)}, path, {"config": json.dumps(asdict(larger)), "metadata": "{}"})
    with pytest.raises(AnyNetError, match="expected weights of a part of the network, got none"):
        load_partial(path, larger)


def d1_per_pair(weights: str, names: list[str]) -> np.ndarray:
    """[pairs, 4]: per cent of the non-occluded pixels wrong by more than 3 px and 5 %, on the authors' crop."""

    def crop(image: np.ndarray) -> np.ndarray:
        """The bottom right 368 x 1232, after black at the top and left where the image is smaller."""
        image = image[-368:, -1232:]
        missing = [(368 - image.shape[0], 0), (1232 - image.shape[1], 0)]
        return np.pad(image, missing + [(0, 0)] * (image.ndim - 2))

    def normalized(path: Path) -> torch.Tensor:
        rgb = crop(cv2.imread(str(path))[..., ::-1]) / 255
        return torch.from_numpy((rgb - MEAN) / STD).permute(2, 0, 1)[None].float()

    folder = SHARED / "data/kitti2015/training"
    model = load_checkpoint(SHARED / "checkpoints" / weights)
    rows = []
    for name in names:
        truth = crop(cv2.imread(str(folder / "disp_noc_0" / name), cv2.IMREAD_UNCHANGED)) / 256
        known = (truth > 0) & (truth < 192)
        with torch.inference_mode():
            estimates = model(normalized(folder / "image_2" / name), normalized(folder / "image_3" / name))
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


def test_tied_weights_are_stored_apart(tmp_path: Path) -> None:
    model = AnyNet()
    first, second = (stage.network[-1].conv for stage in model.residual_stages)
    second.weight = first.weight
    save_checkpoint(tmp_path / "tied.safetensors", model)
    assert len(torch.unique(first.weight)) > 1
    loaded = load_checkpoint(tmp_path / "tied.safetensors").state_dict()
    assert all(torch.equal(loaded[name], tensor) for name, tensor in model.state_dict().items())


@pytest.mark.parametrize("change", [lambda t: t.to("meta"), Tensor.to_sparse], ids=["meta", "sparse"])
def test_weights_without_values_in_memory_are_not_saved(tmp_path: Path, change: Callable[[Tensor], Tensor]) -> None:
    model = AnyNet()
    for module in model.modules():
        if isinstance(module, Convolution):
            module.weight = nn.Parameter(change(module.weight.detach()))
    with pytest.raises(AnyNetError, match=r"weight is no dense tensor on the CPU$"):
        save_checkpoint(tmp_path / "none.safetensors", model)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", [b"fx 1 fy 1", b"\x80\x04N.", b"PK\x03\x04"])
def test_a_file_that_holds_no_weights(tmp_path: Path, content: bytes) -> None:
    """Not what PyTorch says of it: its advice is to let the file run code."""
    path = tmp_path / "calib.txt"
    path.write_bytes(content)
    with pytest.raises(AnyNetError, match=r"calib.txt: expected weights, .safetensors or .* got another file$"):
        load_checkpoint(path)
