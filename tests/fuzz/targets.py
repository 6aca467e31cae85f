"""What is fuzzed: one line each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import corpus
import operators


@dataclass(frozen=True)
class Reader:
    """Reads files with damage; may raise AnyNetError and nothing else."""

    call: Callable[[Path], Any]
    ending: str
    corpus: corpus.Corpus


@dataclass(frozen=True)
class Calls:
    """Makes the call of a seed, once prepared; returns whether the arguments were accepted."""

    prepare: Callable[[], object]
    call: Callable[[str], bool]


def _of(module: str, name: str, *more: Any) -> Callable[[Any], Any]:
    """A function that is imported when it is first needed."""
    return lambda path: getattr(import_module(module), name)(path, *more)


_image = _of("anynet.io.images", "read_image")
_disparity = _of("anynet.io.disparity", "read_disparity")
_calibration = _of("anynet.camera.read", "read_calibration")
_checkpoint = _of("anynet.checkpoint", "load_checkpoint")


def _with(sound: Callable[[], dict[str, bytes]]) -> Callable[[Path], Any]:
    """Reads a calibration of several files: the damaged one, and sound ones beside it."""

    def read(path: Path) -> Any:
        others = [path.with_name(name) for name in sound()]
        for other in others:
            if not other.exists():
                other.write_bytes(sound()[other.name])
        return _calibration([path, *others])

    return read


def _frames(path: Path) -> None:
    """Reads a recording to its end."""
    with import_module("anynet.streams").Recording(path) as recording:
        for _ in recording.frames():
            pass


def _bag(path: Path) -> None:
    """Reads a bag of ROS 2, a folder, with these metadata."""
    folder = Path(f"{path}.bag2")
    if not folder.exists():
        folder.mkdir()
        for name, data in corpus.bagged().items():
            (folder / name).write_bytes(data)
    (folder / "metadata.yaml").write_bytes(path.read_bytes())
    _frames(folder)


TARGETS: dict[str, Reader | Calls] = {
    "image-png": Reader(_image, ".png", corpus.png),
    "image-jpeg": Reader(_image, ".jpg", corpus.jpeg),
    "image-tiff": Reader(_image, ".tiff", corpus.tiff),
    "image-webp": Reader(_image, ".webp", corpus.webp),
    "image-gif": Reader(_image, ".gif", corpus.gif),
    "image-ppm": Reader(_image, ".ppm", corpus.ppm),
    "image-others": Reader(_image, ".bmp", corpus.others),
    "disparity-png": Reader(_disparity, ".png", corpus.disparity_png),
    "disparity-tiff": Reader(_disparity, ".tiff", corpus.disparity_tiff),
    "disparity-pfm": Reader(_disparity, ".pfm", corpus.pfm),
    "disparity-npy": Reader(_disparity, ".npy", corpus.npy),
    "disparity-npz": Reader(_disparity, ".npz", corpus.npz),
    "depth-png": Reader(_of("anynet.io.depth", "read_depth"), ".png", corpus.depth_png),
    "csv": Reader(_of("anynet.data.custom", "table"), ".csv", corpus.csv),
    "split": Reader(lambda path: _of("anynet.data.files", "names_in", path.parent)(path), ".txt", corpus.split),
    "rendered": Reader(
        lambda path: import_module("anynet.data.rendered").RenderedFolder(path.parent)[0], ".npy", corpus.rendered
    ),
    "recipe": Reader(lambda path: import_module("anynet.training.recipe").Recipe.load(path), ".json", corpus.recipe),
    "calibration-kitti": Reader(_calibration, ".txt", corpus.kitti_calibration),
    "calibration-middlebury": Reader(_calibration, ".txt", corpus.middlebury_calibration),
    "calibration-yaml": Reader(_calibration, ".yml", corpus.opencv_calibration(".yml")),
    "calibration-xml": Reader(_calibration, ".xml", corpus.opencv_calibration(".xml")),
    "calibration-json": Reader(_calibration, ".json", corpus.json_calibrations),
    "calibration-robots": Reader(_calibration, ".yaml", corpus.robots_calibrations),
    "calibration-zed": Reader(_calibration, ".conf", corpus.zed_calibration),
    "calibration-numbers": Reader(_calibration, ".txt", corpus.numbers_calibration),
    "calibration-ros": Reader(_with(corpus.ros_right), ".yaml", corpus.ros_left),
    "calibration-euroc": Reader(_with(corpus.euroc_right), ".yaml", corpus.euroc_left),
    "calibration-vins": Reader(_with(corpus.vins_cameras), ".yaml", corpus.vins),
    "recording-bag": Reader(_frames, ".bag", corpus.recording(".bag")),
    "recording-mcap": Reader(_frames, ".mcap", corpus.recording(".mcap")),
    "recording-db3": Reader(_frames, ".db3", corpus.recording(".db3")),
    "recording-metadata": Reader(_bag, ".yaml", corpus.metadata),
    "confidence": Reader(
        lambda path: import_module("anynet.model.confidence").ConfidenceModel.read(path, 4), ".json", corpus.confidence
    ),
    "checkpoint-baseline": Reader(
        _of("anynet.baselines.model", "load_baseline"), ".safetensors", corpus.baseline_checkpoint
    ),
    "checkpoint-safetensors": Reader(_checkpoint, ".safetensors", corpus.safetensors),
    "checkpoint-tar": Reader(_checkpoint, ".tar", corpus.pickled),
    "operators": Calls(operators.operators, operators.call),
}
