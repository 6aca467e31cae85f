from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from anynet import AnyNet, save_checkpoint
from anynet.cli import main
from anynet.io import write_image


@pytest.fixture(scope="package", autouse=True)
def one_thread() -> Iterator[None]:
    """For images as small as these a second thread is only in the way."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMP_NUM_THREADS", "1")  # for the processes that tests start
        yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory, wild_model: AnyNet) -> Path:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    save_checkpoint(path, wild_model)
    return path


@pytest.fixture(scope="session")
def scene() -> tuple[np.ndarray, np.ndarray]:
    """A small pair: a random texture, 4 pixels to the left in the right image."""
    coarse = np.random.default_rng(0).integers(0, 256, (12, 18, 3), dtype=np.uint8)
    texture = coarse.repeat(4, 0).repeat(4, 1)
    return texture[:, :64], texture[:, 4:68]


@pytest.fixture
def pair(tmp_path: Path, scene: tuple[np.ndarray, np.ndarray]) -> tuple[Path, Path]:
    paths = tmp_path / "left.png", tmp_path / "right.png"
    for path, image in zip(paths, scene, strict=True):
        write_image(path, image)
    return paths


@pytest.fixture
def folders(tmp_path: Path, scene: tuple[np.ndarray, np.ndarray]) -> tuple[Path, Path]:
    """Three pairs of the same names in two folders."""
    paths = tmp_path / "lefts", tmp_path / "rights"
    for folder, image in zip(paths, scene, strict=True):
        folder.mkdir()
        for name in "abc":
            write_image(folder / f"{name}.png", image)
    return paths


@dataclass
class Result:
    status: int
    out: str
    err: str


class Run:
    """Runs a command in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def __call__(self, *arguments: object) -> Result:
        self.capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        return Result(status, *self.capsys.readouterr())


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return Run(capsys)
