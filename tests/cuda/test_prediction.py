"""What only a GPU can show of prediction, graphs, budgets, streams, devices, threads and forks; and of training."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from anynet import AnyNetError, Predictor, Worker
from anynet.device import HostCopy
from anynet.model import graphs
from anynet.training.distributed import Processes
from anynet.training.graphs import WARM_UP
from anynet.training.loop import _Run
from anynet.training.recipe import Recipe

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU and the CUDA build of torch"),
]

Pair = tuple[np.ndarray, np.ndarray]


def pair(height: int = 96, width: int = 208, seed: int = 0) -> Pair:
    """Texture at a disparity of 6 pixels."""
    random = torch.Generator().manual_seed(seed)
    texture = torch.rand(1, 3, height // 3 + 1, width // 3 + 3, generator=random)
    scene = 255 * F.interpolate(texture, (height, width + 6), mode="bicubic").clamp(0, 1)[0].permute(1, 2, 0)
    image = scene.to(torch.uint8).numpy()
    return image[:, :width].copy(), image[:, 6:].copy()


def on_gpu(images: Pair, device: str = "cuda") -> tuple[torch.Tensor, torch.Tensor]:
    left, right = (torch.from_numpy(image).to(device) for image in images)
    return left, right


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    return Predictor(device="cuda")


@pytest.mark.parametrize("weights", ["paper", "large", "kitti"])
def test_equals_the_cpu(weights: str) -> None:
    gpu, cpu = Predictor(weights, device="cuda"), Predictor(weights)
    for seed in (0, 1):  # captured, then replayed
        images = pair(seed=seed)
        options = {"confidence": True, "left_right": bool(seed)}
        for one, other in zip(gpu.stages(*images, **options), cpu.stages(*images, **options), strict=True):
            assert isinstance(one.disparity, np.ndarray)
            np.testing.assert_allclose(one.disparity, other.disparity, atol=1e-2)
            np.testing.assert_allclose(one.confidence, other.confidence, atol=1e-2)
            assert (one.occluded != other.occluded).mean() < 1e-3


@pytest.mark.parametrize("precision", ["bfloat16", "float16"])
@pytest.mark.parametrize("weights", ["paper", "large"])
def test_half_precision(weights: str, precision: str) -> None:
    if precision == "bfloat16" and torch.cuda.get_device_capability() < (8, 0):
        pytest.skip("needs compute capability 8.0")
    half, cpu = Predictor(weights, device="cuda", precision=precision), Predictor(weights)
    for seed in (0, 1):
        images = pair(seed=seed)
        for one, other in zip(half.stages(*images), cpu.stages(*images), strict=True):
            assert np.abs(one.disparity - other.disparity).mean() < (0.1 if precision == "bfloat16" else 0.02)


def test_repeats_bit_for_bit(predictor: Predictor) -> None:
    images = pair()
    first = predictor.predict(*images).disparity
    for _ in range(5):
        np.testing.assert_array_equal(predictor.predict(*images).disparity, first)


@pytest.mark.parametrize("input_scale", [None, 0.5])
@pytest.mark.parametrize("view", ["left", "right"])
def test_tensors_stay_there(view: str, input_scale: float | None) -> None:
    predictor = Predictor(device="cuda", input_scale=input_scale)
    images = pair()
    expected = predictor.predict(*images, view=view).disparity
    out = predictor.predict(*on_gpu(images), view=view).disparity
    assert isinstance(out, torch.Tensor)
    assert out.is_cuda
    assert np.abs(out.cpu().numpy() - expected).mean() < (1e-6 if input_scale is None else 0.1)
    assert torch.equal(torch.from_dlpack(out), out)


def test_sizes_in_any_order(predictor: Predictor) -> None:
    cpu = Predictor()
    for height, width in [(96, 208), (64, 100), (96, 208), (1, 1), (64, 100)]:
        images = pair(height, width, seed=height)
        np.testing.assert_allclose(predictor.predict(*images).disparity, cpu.predict(*images).disparity, atol=1e-2)


def test_frames_that_take_turns(predictor: Predictor) -> None:
    pairs = [pair(seed=seed) for seed in range(3)]
    expected = [[e.disparity for e in predictor.stages(*images)] for images in pairs]
    for step, estimates in enumerate(zip(*(predictor.stages(*images) for images in pairs), strict=True)):
        for estimate, stages in zip(estimates, expected, strict=True):
            np.testing.assert_array_equal(estimate.disparity, stages[step])


def test_few_sizes_are_kept() -> None:
    predictor = Predictor(device="cuda")
    for width in range(40, 40 + 2 * graphs.SIZES):
        predictor.predict(*pair(32, width))
    kept = torch.cuda.memory_allocated()
    for width in range(80, 80 + 2 * graphs.SIZES):
        predictor.predict(*pair(32, width))
    assert torch.cuda.memory_allocated() < 2 * kept


def test_budgets(predictor: Predictor) -> None:
    images = pair(375, 1242)
    whole = [predictor.predict(*images).elapsed_ms for _ in range(20)][-1]
    assert predictor.predict(*images, budget_ms=0).stage == 1
    assert predictor.predict(*images, budget_ms=10 * whole + 10).stage == 4
    assert predictor.predict(*images, stage=2, budget_ms=10 * whole + 10).stage == 2
    # Time of the GPU: what keeps it busy before the frame does not count.
    torch.cuda._sleep(200_000_000)
    assert predictor.predict(*on_gpu(images), budget_ms=10 * whole + 10).stage == 4


def test_side_stream(predictor: Predictor) -> None:
    """Images that come late on the current stream are waited for."""
    images = on_gpu(pair())
    expected = predictor.predict(*images).disparity
    late = [torch.zeros_like(image) for image in images]
    torch.cuda.synchronize()
    with torch.cuda.stream(torch.cuda.Stream()):
        torch.cuda._sleep(50_000_000)
        for empty, image in zip(late, images, strict=True):
            empty.copy_(image)
        out = predictor.predict(*late).disparity
    assert torch.equal(out, expected)


def test_threads_share_a_predictor(predictor: Predictor) -> None:
    pairs = [pair(seed=seed) for seed in range(4)]
    expected = [predictor.predict(*images).disparity for images in pairs]
    wrong: list[int] = []

    def work(index: int) -> None:
        with torch.cuda.stream(torch.cuda.Stream()):
            for _ in range(20):
                if not np.array_equal(predictor.predict(*pairs[index]).disparity, expected[index]):
                    wrong.append(index)

    threads = [threading.Thread(target=work, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_worker(predictor: Predictor) -> None:
    images = pair()
    expected = predictor.predict(*images).disparity
    with Worker(predictor) as worker:
        for given in (images, on_gpu(images)):
            worker.submit(*given)
            latest = worker.result(timeout=60)
            assert latest is not None
            assert type(latest.disparity) is type(given[0])
            assert np.array_equal(np.asarray(torch.as_tensor(latest.disparity).cpu()), expected)


def test_a_forked_child_is_told(predictor: Predictor) -> None:
    images = pair()
    predictor.predict(*images)
    child = os.fork()
    if child == 0:
        try:
            predictor.predict(*images)
        except AnyNetError as error:
            os._exit(0 if "fork" in str(error) else 2)
        os._exit(1)
    assert os.waitpid(child, 0)[1] == 0


def test_a_device_that_is_not_there() -> None:
    with pytest.raises(AnyNetError, match=r"device 'cuda:99': expected one of the \d+ GPUs here"):
        Predictor(device="cuda:99")
    with pytest.raises(AnyNetError, match="expected left as array, or tensor on cuda:0, got a tensor on cpu"):
        Predictor(device="cuda:0").predict(*on_gpu(pair(), "cpu"))


@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two GPUs")
def test_second_device(predictor: Predictor) -> None:
    images = pair()
    other = Predictor(device="cuda:1")
    assert torch.cuda.current_device() == 0
    out = other.predict(*on_gpu(images, "cuda:1")).disparity
    assert out.device == torch.device("cuda:1")
    np.testing.assert_array_equal(out.cpu(), predictor.predict(*images).disparity)
    with pytest.raises(AnyNetError, match="tensor on cuda:1, got a tensor on cuda:0"):
        other.predict(*on_gpu(images, "cuda:0"))


def test_command_line(tmp_path: Path) -> None:
    from anynet.cli import main
    from anynet.io.images import write_image

    for name, image in zip(("left.png", "right.png"), pair(), strict=True):
        write_image(tmp_path / name, image)
    files = [str(tmp_path / name) for name in ("left.png", "right.png")]
    assert main(["predict", *files, "--out", str(tmp_path / "out"), "--device", "cuda"]) == 0
    assert main(["predict", *files, "--out", str(tmp_path / "out"), "--device", "cuda:99"]) == 2


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("amp", [False, True])
def test_a_training_step_never_waits(tmp_path: Path, compiled: bool, amp: bool) -> None:
    if compiled and sys.platform != "linux":
        pytest.skip("torch.compile needs Triton")
    recipe = Recipe(steps=7, weights="default", learning_rate=3e-4, amp=amp, ema_decay=0.9)
    run = _Run(recipe, tmp_path, [], {}, Processes(0, 1, torch.device("cuda")))
    if compiled:
        run.parallel = torch.compile(run.model)
    torch.manual_seed(0)
    left, right = (torch.randint(0, 256, (2, 3, 64, 128), dtype=torch.uint8) for _ in range(2))
    batch = [left, right, torch.rand(2, 1, 64, 128) * 30, torch.ones(2, 1, 64, 128)]
    batch = [tensor.pin_memory() for tensor in batch]
    values = [HostCopy(run._update(batch)) for _ in range(WARM_UP + 1)]
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        values += [HostCopy(run._update(batch)) for _ in range(3)]
    finally:
        torch.cuda.set_sync_debug_mode("default")
    losses = torch.tensor([each.tolist() for each in values])
    assert losses.isfinite().all()
    assert losses[-1, :-1].sum() < losses[0, :-1].sum()


def test_a_captured_step_is_the_step(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(0)
    recipe = Recipe(steps=8, weights="paper", learning_rate=1e-6, ema_decay=0.5)  # so small that rounding stays small
    runs = [_Run(recipe, tmp_path, [], {}, Processes(0, 1, torch.device("cuda"))) for _ in range(2)]
    runs[0]._compute = runs[0]._computed
    before = [parameter.detach().clone() for parameter in runs[0].model.parameters()]
    for _ in range(WARM_UP + 3):
        images = torch.randint(0, 256, (2, 2, 3, 64, 128), dtype=torch.uint8, generator=generator)
        batch = [*images, torch.rand(2, 1, 64, 128, generator=generator) * 30, torch.ones(2, 1, 64, 128)]
        expected, found = (run._update(batch).cpu() for run in runs)
        torch.testing.assert_close(found, expected, rtol=2e-2, atol=0)  # cuDNN's gradients do not repeat
    for network in ("model", "average"):
        moved = [
            sum((now - then).abs().sum() for now, then in zip(getattr(run, network).parameters(), before, strict=True))
            for run in runs
        ]
        assert moved[0] > 0
        torch.testing.assert_close(moved[1], moved[0], rtol=0.1, atol=0)
