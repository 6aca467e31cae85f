from __future__ import annotations

import os
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
import pytest
import torch
from networks import with_weights_of
from processes import completed

from anynet import AnyNet, Estimate, Predictor, load_checkpoint, save_checkpoint
from anynet import predictor as predictor_module
from anynet.checkpoint import PACKAGED
from anynet.errors import AnyNetError
from anynet.model.config import MEAN, STD, RefinementConfig
from anynet.model.graphs import GraphedAnyNet


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory, wild_model: AnyNet) -> Path:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    save_checkpoint(path, wild_model)
    return path


@pytest.fixture(scope="module")
def large_weights(tmp_path_factory: pytest.TempPathFactory, wild_large_model: AnyNet) -> Path:
    path = tmp_path_factory.mktemp("weights") / "large.safetensors"
    save_checkpoint(path, wild_large_model)
    return path


@pytest.fixture(scope="module")
def predictor(weights: Path) -> Predictor:
    return Predictor(weights)


def pair(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Texture, shifted by 4 pixels."""
    image = np.random.default_rng(height * width).integers(0, 256, (height, width + 4, 3), dtype=np.uint8)
    return image[:, :-4].copy(), image[:, 4:].copy()


@pytest.fixture(scope="module")
def filling_weights(tmp_path_factory: pytest.TempPathFactory, wild_model: AnyNet) -> Path:
    filling = with_weights_of(wild_model, refinement=RefinementConfig(fill_occlusions=True))
    path = tmp_path_factory.mktemp("weights") / "filling.safetensors"
    save_checkpoint(path, filling)
    return path


@pytest.fixture(scope="module")
def candidate_weights(tmp_path_factory: pytest.TempPathFactory, wild_candidate_model: AnyNet) -> Path:
    path = tmp_path_factory.mktemp("weights") / "candidates.safetensors"
    save_checkpoint(path, wild_candidate_model)
    return path


@pytest.mark.parametrize(
    ("network", "input_scale"),
    [("weights", 1), ("large_weights", 2), ("large_weights", 1), ("filling_weights", 1), ("candidate_weights", 1)],
)
@pytest.mark.parametrize(("height", "width"), [(1, 1), (37, 61), (64, 128)])
def test_stages_are_the_networks(
    request: pytest.FixtureRequest, height: int, width: int, network: str, input_scale: int
) -> None:
    weights = request.getfixturevalue(network)
    predictor = Predictor(weights, input_scale=input_scale)
    left, right = pair(height, width)
    tensors = [torch.from_numpy((image / 255 - MEAN) / STD).permute(2, 0, 1)[None] for image in (left, right)]
    with torch.no_grad():  # in float64: in float32, these networks' rounding is as large on either side
        expected = load_checkpoint(weights, input_scale).double()(*tensors)
    estimates = list(predictor.stages(left, right))
    assert [e.stage for e in estimates] == list(range(1, 6 if network == "large_weights" else 5))
    for estimate, disparity in zip(estimates, expected, strict=True):
        assert estimate.disparity.dtype == np.float32
        np.testing.assert_allclose(estimate.disparity, disparity[0, 0].numpy(), atol=0.01)
        alone = predictor.predict(left, right, stage=estimate.stage)
        assert alone.stage == estimate.stage
        np.testing.assert_array_equal(alone.disparity, estimate.disparity)
    assert [e.elapsed_ms for e in estimates] == sorted(e.elapsed_ms for e in estimates)


@pytest.mark.parametrize(("input_scale", "shift"), [(0.5, 260), (0.37, 150), (1.5, 170), (2, 170), (2.5, 170)])
def test_input_scale(input_scale: float, shift: int) -> None:
    """Below 1 a packaged network reaches beyond 192 pixels; above 1 no less far than before."""
    noise = np.random.default_rng(0).integers(0, 256, (40, 180, 3), dtype=np.uint8)
    wide = np.kron(noise, np.ones((5, 5, 1), np.uint8))
    left, right = wide[:, :-shift], wide[:, shift:]
    predictor = Predictor("large", input_scale=input_scale)
    assert predictor.config.input_scale == input_scale
    for estimate in predictor.stages(left, right):
        assert estimate.disparity.shape == (200, 900 - shift)
        assert estimate.disparity.flags.writeable
    assert np.abs(np.median(estimate.disparity[50:150, shift + 50 : -50]) - shift) < 1
    np.testing.assert_array_equal(predictor.predict(left, right).disparity, estimate.disparity)


def test_a_shorter_reach_is_told() -> None:
    with pytest.warns(UserWarning, match=r"input_scale 1.5: these weights find disparities below 128 pixels then"):
        Predictor("default", input_scale=1.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Predictor("default", input_scale=0.5)
        Predictor("large", input_scale=3)


@pytest.mark.parametrize("input_scale", [1 / 16, 0.7, 1.3, 4])
def test_input_scale_of_tiny_images(weights: Path, input_scale: float) -> None:
    predictor = Predictor(weights, input_scale=input_scale)
    for height, width in (1, 1), (7, 30):
        assert predictor.predict(*pair(height, width)).disparity.shape == (height, width)


@pytest.mark.parametrize("input_scale", [0.5, 0.4999, 0.501, 0.7, 1.25])
def test_tensors_are_resized_as_arrays_are(input_scale: float) -> None:
    predictor, texture = Predictor(input_scale=input_scale), cv2.resize(pair(32, 72)[0], (214, 96))
    left, right = texture[:, :208].copy(), texture[:, 6:].copy()
    expected = predictor.predict(left, right).disparity
    out = predictor.predict(torch.from_numpy(left), torch.from_numpy(right)).disparity
    assert np.abs(out.numpy() - expected).mean() < (0.001 if round(208 * input_scale) == 104 else 0.02)


@pytest.mark.parametrize("input_scale", [0, -1, 5, float("nan")])
def test_input_scale_out_of_range(input_scale: float) -> None:
    with pytest.raises(AnyNetError, match=f"expected input_scale from 0.0625 to 4, got {input_scale}"):
        Predictor(input_scale=input_scale)


def test_results_belong_to_the_caller(predictor: Predictor) -> None:
    left, right = pair(32, 48)
    before = [left.copy(), right.copy()]
    first = predictor.predict(left, right).disparity
    kept = first.copy()
    predictor.predict(right, left)
    np.testing.assert_array_equal(first, kept)
    first[:] = 0  # writable
    np.testing.assert_array_equal(left, before[0])
    np.testing.assert_array_equal(right, before[1])


def test_any_layout_of_array(predictor: Predictor) -> None:
    left, right = pair(32, 48)
    expected = predictor.predict(left, right).disparity
    frozen = left.copy()
    frozen.flags.writeable = False
    mirrored = left[:, ::-1].copy()[:, ::-1]
    wider = np.concatenate([left, left], 1)[:, :48]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for image in (frozen, mirrored, wider, np.asfortranarray(left)):
            np.testing.assert_array_equal(predictor.predict(image, right).disparity, expected)
        for row, other in ((left[:1], right[:1]), (left[:, :1], right[:, :1])):
            expected = predictor.predict(row, other).disparity
            flipped = row[::-1, ::-1].copy()[::-1, ::-1]  # contiguous, with a negative stride
            np.testing.assert_array_equal(predictor.predict(flipped, other).disparity, expected)


@pytest.mark.parametrize("input_scale", [None, 0.7])
def test_tensors_may_be_changed_and_take_part_in_gradients(weights: Path, input_scale: float | None) -> None:
    left, right = map(torch.from_numpy, pair(32, 48))
    estimate = Predictor(weights, input_scale=input_scale).predict(left, right, confidence=True)
    factor = torch.ones(1, requires_grad=True)
    (factor * estimate.disparity * estimate.confidence)[~estimate.occluded].sum().backward()
    assert factor.grad.isfinite()
    for values in (estimate.disparity, estimate.confidence, estimate.occluded):
        values[0, 0] = 0


class Clockwork:
    """A graph whose stages take a given time, on a clock of its own."""

    def __init__(self, seconds: list[float]) -> None:
        self.seconds = seconds
        self.now = 0.0

    def stages(self, left: torch.Tensor, right: torch.Tensor) -> Iterator[object]:
        for seconds in self.seconds:
            self.now += seconds
            yield lambda out: out.zero_()


@pytest.fixture
def clockwork(weights: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Predictor, Clockwork]:
    predictor, clock = Predictor(weights), Clockwork([0.005, 0.002, 0.004, 0.003])
    monkeypatch.setattr(predictor, "_network", clock)
    monkeypatch.setattr(predictor_module, "perf_counter", lambda: clock.now)
    return predictor, clock


def test_a_budget_decides_the_stage(clockwork: tuple[Predictor, Clockwork]) -> None:
    predictor, _ = clockwork
    images = pair(16, 16)
    assert predictor.predict(*images).stage == 4  # learns
    stages = {
        budget: predictor.predict(*images, budget_ms=budget).stage for budget in (0, 4, 6.9, 7.1, 10.9, 11.1, 14.1)
    }
    assert stages == {0: 1, 4: 1, 6.9: 1, 7.1: 2, 10.9: 2, 11.1: 3, 14.1: 4}
    assert predictor.predict(*images, budget_ms=100, stage=2).stage == 2
    assert predictor.predict(*images, budget_ms=14.1).elapsed_ms == pytest.approx(14)


def test_the_first_frame_of_a_size_keeps_its_budget_too(clockwork: tuple[Predictor, Clockwork]) -> None:
    predictor, _ = clockwork
    assert predictor.predict(*pair(16, 16), budget_ms=9).stage == 1  # a stage unknown may take as long as all before
    assert predictor.predict(*pair(16, 32), budget_ms=11).stage == 2
    assert predictor.predict(*pair(16, 48), budget_ms=40).stage == 4


def test_the_table_is_kept_current(clockwork: tuple[Predictor, Clockwork]) -> None:
    predictor, clock = clockwork
    images = pair(16, 16)
    predictor.predict(*images)
    assert predictor.predict(*images, budget_ms=15).stage == 4
    clock.seconds[2] = 0.010  # the machine became slower
    late = [predictor.predict(*images, budget_ms=15).elapsed_ms > 15 for _ in range(300)]
    assert sum(late[:10]) <= 2
    assert sum(late[10:]) <= 3
    clock.seconds[2] = 0.004  # and faster again
    stages = [predictor.predict(*images, budget_ms=15).stage for _ in range(200)]
    assert stages[-50:] == [4] * 50


def test_one_slow_frame_is_forgotten(clockwork: tuple[Predictor, Clockwork]) -> None:
    predictor, clock = clockwork
    images = pair(16, 16)
    for _ in range(5):
        predictor.predict(*images)
    clock.seconds[3] = 0.5
    predictor.predict(*images)
    clock.seconds[3] = 0.003
    assert predictor.predict(*images, budget_ms=15).stage == 4


def test_threads_are_used_and_given_back(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    predictor = Predictor(weights, threads=3)
    real = predictor._network.stages

    def spy(*images: torch.Tensor) -> Iterator[object]:
        seen.append(torch.get_num_threads())
        return real(*images)

    monkeypatch.setattr(predictor._network, "stages", spy)
    before = torch.get_num_threads()
    predictor.predict(*pair(16, 16))
    assert seen == [3]
    assert torch.get_num_threads() == before


def test_a_forked_child_computes(predictor: Predictor) -> None:
    images = pair(32, 48)
    expected = predictor.predict(*images).disparity
    child = os.fork()
    if child == 0:
        signal.alarm(20)  # OpenMP would hang
        same = np.allclose(predictor.predict(*images).disparity, expected, atol=1e-3)
        os._exit(0 if same else 1)
    assert os.waitpid(child, 0)[1] == 0


def run_python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_frames_reuse_the_memory_of_those_before() -> None:
    """Page faults of one frame: as many as its volumes have pages, where freed memory goes back to the system."""
    code = """
import resource, numpy, anynet
predictor, image = anynet.Predictor(), numpy.zeros((368, 1232, 3), numpy.uint8)
for _ in range(3): predictor.predict(image, image)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(5): predictor.predict(image, image)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 2500  # of five frames; 9,000 without


def test_the_interpreter_may_exit_while_daemon_threads_compute() -> None:
    code = """
import threading, time, numpy, anynet
predictor, image = anynet.Predictor(), numpy.zeros((200, 400, 3), numpy.uint8)
def work():
    while True: predictor.predict(image, image)
for _ in range(3): threading.Thread(target=work, daemon=True).start()
time.sleep(0.5)
"""
    for done in completed([[sys.executable, "-c", code]] * 3):
        assert (done.returncode, done.stderr) == (0, "")


def test_a_predictor_can_be_pickled(predictor: Predictor) -> None:
    images = pair(32, 48)
    copy = pickle.loads(pickle.dumps(predictor))
    np.testing.assert_array_equal(copy.predict(*images).disparity, predictor.predict(*images).disparity)


def test_one_of_a_gpu_belongs_to_the_process_that_unpickles_it(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated: a generator cannot be pickled either, as a captured graph cannot."""
    original, images = Predictor(weights), pair(16, 16)
    original._network = graphed = GraphedAnyNet(original._network)
    original.device = torch.device("cuda", 0)
    graphed._free[16, 16, 3].append(part for part in ())
    content = pickle.dumps(original)
    assert len(graphed._free) == 1
    monkeypatch.setattr(os, "getpid", lambda: 1)
    with pytest.raises(AnyNetError, match="expected the process that made the predictor"):
        original.stages(*images)
    copy = pickle.loads(content)
    assert len(copy._network._free) == 0
    copy.stages(*images)


def test_the_confidence_model_is_that_of_the_weights_when_they_were_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images, model = pair(32, 48), (PACKAGED / "large.confidence.json").read_bytes()
    for name in ("before", "now"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "before")
    save_checkpoint("own.safetensors", load_checkpoint("large"))
    Path("own.confidence.json").write_bytes(model)
    predictor = Predictor("own.safetensors")
    expected = Predictor("large").predict(*images, confidence=True).confidence
    monkeypatch.chdir(tmp_path / "now")
    np.testing.assert_array_equal(predictor.predict(*images, confidence=True).confidence, expected)
    shutil.rmtree(tmp_path / "before")
    copy = pickle.loads(pickle.dumps(predictor))
    np.testing.assert_array_equal(copy.predict(*images, confidence=True).confidence, expected)


def test_a_damaged_confidence_model_is_told_when_it_is_asked_for(tmp_path: Path, wild_model: AnyNet) -> None:
    save_checkpoint(tmp_path / "own.safetensors", wild_model)
    (tmp_path / "own.confidence.json").write_text("{}")
    predictor = Predictor(tmp_path / "own.safetensors")
    assert predictor.predict(*pair(16, 16)).stage == 4
    with pytest.raises(AnyNetError, match=r"own\.confidence\.json: not a confidence model"):
        predictor.predict(*pair(16, 16), confidence=True)


@pytest.mark.slow
def test_memory_does_not_grow(predictor: Predictor) -> None:
    images = [pair(48, 64), pair(50, 70)]
    for i in range(500):
        predictor.predict(*images[i % 2])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = perf_counter()
    for i in range(10_000):
        predictor.predict(*images[i % 2])
        if perf_counter() - start > 300:
            pytest.fail(f"only {i} frames in 300 s")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2048  # KiB


@pytest.mark.parametrize(
    ("left", "message"),
    [
        ("image.png", "expected left as uint8 RGB array .* got str"),
        (np.zeros((16, 16), np.uint8), r"got uint8 \[16, 16\]"),
        (np.zeros((16, 16, 4), np.uint8), r"got uint8 \[16, 16, 4\]"),
        (np.zeros((16, 16, 3), np.uint16), r"got uint16 \[16, 16, 3\]"),
        (np.zeros((16, 15, 3), np.uint8), r"one size, got \[16, 15, 3\] and \[16, 16, 3\]"),
    ],
)
def test_wrong_images(predictor: Predictor, left: object, message: str) -> None:
    right = np.zeros((16, 16, 3), np.uint8)
    with pytest.raises(AnyNetError, match=message):
        predictor.predict(left, right)
    with pytest.raises(AnyNetError, match=message):
        next(predictor.stages(left, right))


def test_other_wrong_arguments(predictor: Predictor, weights: Path) -> None:
    images = pair(16, 16)
    for stage in (0, 2.5, True):
        with pytest.raises(AnyNetError, match=f"stage from 1 to 4, got {stage}"):
            predictor.predict(*images, stage=stage)
    assert predictor.predict(*images, stage=np.int64(2), budget_ms=np.float32(1e6)).stage == 2
    for none in (None, 3, b"paper"):
        with pytest.raises(AnyNetError, match="expected a file of weights or a packaged name"):
            Predictor(none)
    with pytest.raises(AnyNetError, match=r"expected precision 'float32', .*, got \['float32'\]"):
        Predictor(weights, precision=["float32"])
    with pytest.raises(AnyNetError, match="budget_ms >= 0, got -1"):
        predictor.predict(*images, budget_ms=-1)
    with pytest.raises(AnyNetError, match="budget_ms >= 0, got nan"):
        predictor.predict(*images, budget_ms=float("nan"))
    for stage in (2.5, True, "2"):
        with pytest.raises(AnyNetError, match=f"stage from 1 to 4, got {stage!r}"):
            predictor.predict(*images, stage=stage)  # type: ignore[arg-type]
    for budget in ("5", True):
        with pytest.raises(AnyNetError, match=f"budget_ms >= 0, got {budget!r}"):
            predictor.predict(*images, budget_ms=budget)  # type: ignore[arg-type]
    for threads in (0, 1.5, True, 1_000_000, 10**12):
        with pytest.raises(AnyNetError, match=f"threads as an integer from 1 to 256, got {threads!r}"):
            Predictor(weights, threads=threads)  # type: ignore[arg-type]
    empty = np.zeros((0, 16, 3), np.uint8)
    with pytest.raises(AnyNetError, match="one size"):
        predictor.predict(empty, empty)
    assert isinstance(predictor.predict(*images), Estimate)


@pytest.mark.parametrize("left_right", [False, True])
@pytest.mark.parametrize("input_scale", [1, 0.6, 2.5])
def test_confidence_changes_no_disparity(input_scale: float, left_right: bool) -> None:
    predictor = Predictor(input_scale=input_scale)
    left, right = pair(50, 90)
    plain = list(predictor.stages(left, right))
    judged = list(predictor.stages(left, right, confidence=True, left_right=left_right))
    for before, after in zip(plain, judged, strict=True):
        assert before.confidence is None
        assert before.occluded is None
        np.testing.assert_array_equal(before.disparity, after.disparity)
        assert after.confidence is not None
        assert after.occluded is not None
        assert (after.confidence.dtype, after.confidence.shape) == (np.float32, (50, 90))
        assert (after.occluded.dtype, after.occluded.shape) == (np.bool_, (50, 90))
        alone = predictor.predict(left, right, stage=after.stage, confidence=True, left_right=left_right)
        np.testing.assert_array_equal(alone.confidence, after.confidence)
        np.testing.assert_array_equal(alone.occluded, after.occluded)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("input_scale", [1, 0.6])
def test_the_callers_autocast_changes_nothing(input_scale: float, dtype: torch.dtype) -> None:
    predictor, images = Predictor("paper", input_scale=input_scale), pair(40, 60)
    for given in (images, tuple(map(torch.from_numpy, images))):
        expected = predictor.predict(*given, confidence=True, left_right=True)
        with torch.autocast("cpu", dtype):
            estimate = predictor.predict(*given, confidence=True, left_right=True)
        for name in ("disparity", "confidence", "occluded"):
            np.testing.assert_array_equal(getattr(estimate, name), getattr(expected, name))


@pytest.mark.parametrize("input_scale", [1, 0.6])
def test_the_right_view_is_the_left_one_of_mirrored_images(input_scale: float) -> None:
    predictor = Predictor("default", input_scale=input_scale)
    left, right = pair(50, 90)
    options = {"confidence": True, "left_right": True}
    seen = predictor.predict(left, right, view="right", **options)
    mirrored = predictor.predict(right[:, ::-1], left[:, ::-1], **options)
    np.testing.assert_allclose(seen.disparity, mirrored.disparity[:, ::-1], atol=1e-3)
    np.testing.assert_allclose(seen.confidence, mirrored.confidence[:, ::-1], atol=1e-3)
    assert (seen.occluded == mirrored.occluded[:, ::-1]).mean() > 0.99
    assert np.abs(np.median(predictor.predict(left, right, view="right").disparity[:, :-8]) - 4) < 1


def test_wrong_options_of_confidence(predictor: Predictor) -> None:
    images = pair(16, 16)
    for method in (predictor.predict, predictor.stages):
        for name in ("confidence", "left_right"):
            for value in (1, "yes", None):
                with pytest.raises(AnyNetError, match=f"expected {name} as True or False, got {value!r}"):
                    method(*images, **{name: value})
        with pytest.raises(AnyNetError, match="expected left_right together with confidence"):
            method(*images, left_right=True)
        for view in ("top", True, None):
            with pytest.raises(AnyNetError, match=f"expected view as 'left' or 'right', got {view!r}"):
                method(*images, view=view)


@pytest.mark.slow
def test_it_computes_in_spawned_processes(predictor: Predictor) -> None:
    left, right = pair(32, 48)
    expected = predictor.predict(left, right).disparity
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        np.testing.assert_array_equal(pool.submit(predictor.predict, left, right).result().disparity, expected)
    joblib = pytest.importorskip("joblib")
    tasks = (joblib.delayed(predictor.predict)(left, right) for _ in range(2))
    for estimate in joblib.Parallel(n_jobs=2)(tasks):
        np.testing.assert_array_equal(estimate.disparity, expected)
