from __future__ import annotations

import numpy as np
import pytest
import torch

from anynet import AnyNetError, Predictor, device
from anynet.device import HostCopy, find_device, find_precision
from anynet.model.deploy import DeployedAnyNet


@pytest.fixture
def gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine with two, the second one current."""
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(device, "build_info", lambda: {"cuda_operators": "yes"})
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)


@pytest.fixture
def predictor_on_gpu() -> Predictor:
    """One that only believes to be on a GPU."""
    predictor = Predictor()
    predictor.device = torch.device("cuda:0")
    return predictor


@pytest.mark.parametrize(
    ("name", "found"),
    [("cpu", "cpu"), ("auto", "cuda:0"), ("cuda", "cuda:1"), ("cuda:0", "cuda:0"), ("cuda:1", "cuda:1")],
)
def test_finds_a_device(gpus: None, name: str, found: str) -> None:
    assert find_device(name) == torch.device(found)


def test_a_gpu_too_many(gpus: None) -> None:
    with pytest.raises(AnyNetError, match=r"^device 'cuda:2': expected one of the 2 GPUs here, cuda:0 to cuda:1$"):
        find_device("cuda:2")


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:-1", "CPU", "mps", "", "cpu:0", None, 0])
def test_other_names(name: str) -> None:
    with pytest.raises(AnyNetError, match=r"^expected device 'cpu', 'cuda', 'cuda:N' or 'auto', got "):
        find_device(name)


def test_finds_a_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    gpu, cpu = torch.device("cuda:0"), torch.device("cpu")
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (7, 5))
    for name, device_of in (("float32", cpu), ("float32", gpu), ("float16", gpu)):
        assert find_precision(name, device_of) == getattr(torch, name)
    with pytest.raises(AnyNetError, match=r"^precision 'bfloat16': expected compute capability 8.0 or newer, got 7.5$"):
        find_precision("bfloat16", gpu)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda _: (8, 7))
    assert find_precision("bfloat16", gpu) == torch.bfloat16
    with pytest.raises(AnyNetError, match=r"^precision 'float16' is for a GPU: expected 'float32' on the CPU$"):
        Predictor(precision="float16")
    with pytest.raises(AnyNetError, match=r"^expected precision 'float32', 'bfloat16' or 'float16', got 'half'$"):
        find_precision("half", gpu)


def test_a_copy_on_the_host_is_what_it_was_when_it_was_made() -> None:
    assert HostCopy(torch.tensor([1.5, 2.5])).tolist() == [1.5, 2.5]


def test_what_is_missing_is_told(gpus: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(AnyNetError, match=r"^device 'cuda': PyTorch sees no GPU: look at nvidia-smi and CUDA_VISIBLE"):
        find_device("cuda")
    monkeypatch.setattr(device, "build_info", lambda: {"cuda_operators": "not built"})
    with pytest.raises(
        AnyNetError, match=r"^device 'cuda:1': AnyNet's CUDA operators are not built: .* ANYNET_CUDA=ON$"
    ):
        find_device("cuda:1")
    monkeypatch.setattr(torch.version, "cuda", None)
    with pytest.raises(AnyNetError, match=r"^device 'cuda': PyTorch .* is a build without CUDA: install one with CUDA"):
        Predictor(device="cuda")
    assert find_device("auto") == torch.device("cpu")


def test_a_gpu_that_fails_is_told_in_one_line(gpus: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("CUDA error: out of memory\nCompile with ...")

    monkeypatch.setattr(DeployedAnyNet, "to", fail)
    with pytest.raises(AnyNetError, match=r"^device 'cuda': CUDA error: out of memory Compile with ...$"):
        Predictor(device="cuda")
    monkeypatch.setattr(torch.cuda, "current_device", fail)
    with pytest.raises(AnyNetError, match=r"^device 'cuda': CUDA error: out of memory Compile with ...$"):
        find_device("cuda")


def test_a_process_forked_off_a_gpus_is_told(predictor_on_gpu: Predictor) -> None:
    predictor_on_gpu._process -= 1
    image = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(AnyNetError, match=r"^predict: expected the process that made the predictor: CUDA does not"):
        predictor_on_gpu.predict(image, image)


@pytest.mark.parametrize("view", ["left", "right"])
@pytest.mark.parametrize("input_scale", [None, 0.5])
def test_tensors_stay_tensors(view: str, input_scale: float | None) -> None:
    """On the CPU as on a GPU."""
    predictor = Predictor("paper", input_scale=input_scale)
    scene = np.random.default_rng(0).integers(0, 256, (40, 100, 3), dtype=np.uint8).repeat(4, 0).repeat(4, 1)
    images = scene[:, :-4].copy(), scene[:, 4:].copy()
    arrays = predictor.predict(*images, view=view, confidence=True)
    tensors = predictor.predict(*(torch.from_numpy(image) for image in images), view=view, confidence=True)
    for name, most in (("disparity", 1.0), ("confidence", 0.05), ("occluded", 0.02)):
        one, other = getattr(arrays, name), getattr(tensors, name)
        assert isinstance(one, np.ndarray)
        assert isinstance(other, torch.Tensor)
        assert other.shape == one.shape
        difference = np.abs(np.from_dlpack(other).astype(np.float32) - one)  # resized by another library
        assert difference.max() == 0 if input_scale is None else difference.mean() < most


def test_wrong_tensors() -> None:
    predictor, image, array = Predictor(), torch.zeros(8, 8, 3, dtype=torch.uint8), np.zeros((8, 8, 3), np.uint8)
    for left, right, message in (
        (image.float(), image, r"expected left as uint8 RGB array \[H, W, 3\], got torch.float32 \[8, 8, 3\]"),
        (image, image[0], r"expected right as uint8 RGB array \[H, W, 3\], got torch.uint8 \[8, 3\]"),
        (image, image[:4], r"expected two images of one size, got \[8, 8, 3\] and \[4, 8, 3\]"),
        (image, array, "expected two arrays or two tensors, got one of each"),
        (image.to("meta"), image, "expected left as array, or tensor on cpu, got a tensor on meta"),
    ):
        with pytest.raises(AnyNetError, match=f"^{message}$"):
            predictor.predict(left, right)
