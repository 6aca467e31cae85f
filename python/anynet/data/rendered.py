"""Rendered pairs as data sets: made on demand, or stored in a folder, one memory-mapped file per pair."""

from __future__ import annotations

import io
import json
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.data.files import files_in
from anynet.errors import AnyNetError
from anynet.io.files import make_folder, read_text, telling_damage, write_atomically
from anynet.samples import MAX_DISPARITY, Dataset, RenderedSample
from anynet.synthetic import render

_MOST = 10**9
SCALE = 256  # stored disparities are uint16, in 1/256 pixel


class Rendered(Dataset):
    """`count` pairs rendered when asked for, from the seeds `seed`, `seed` + 1, ..."""

    def __init__(self, count: int, seed: int = 0, height: int = 384, width: int = 768) -> None:
        if not (1 <= count <= _MOST and 0 <= seed <= 2**62 and 64 <= min(height, width) <= max(height, width) <= 16384):
            raise AnyNetError(
                f"rendered pairs: expected 1 to {_MOST} of 64 x 64 to 16384 x 16384, got {count} of {width} x {height} "
                f"from seed {seed}"
            )
        self.name = "rendered"
        self._count, self._seed, self._size = count, seed, (height, width)

    def __len__(self) -> int:
        return self._count

    def load(self, index: int) -> RenderedSample:
        return render(self._seed + index, *self._size)


def _record(height: int, width: int) -> np.dtype[Any]:
    image, plane = (height, width, 3), (2, height, width)
    return np.dtype(
        [("left", "u1", image), ("right", "u1", image), ("disparity", "<u2", plane), ("occluded", "?", plane)]
    )


def _store(path: Path, sample: RenderedSample) -> None:
    record = np.zeros((), _record(*sample.disparity.shape))
    record["left"], record["right"] = sample.left, sample.right
    limit = np.iinfo(np.uint16).max
    for view, disparity in enumerate((sample.disparity, sample.right_disparity)):
        record["disparity"][view] = np.minimum(np.rint(disparity * SCALE), limit)
    record["occluded"] = sample.occluded, sample.right_occluded
    content = io.BytesIO()
    np.save(content, record)
    write_atomically(path, content.getvalue())


class RenderedFolder(Dataset):
    """The pairs that `anynet render` wrote; images and disparities are read where they are used."""

    def __init__(self, root: str | Path) -> None:
        self.name = "rendered"
        self._root = Path(root)
        self._files = files_in(self._root, "*.npy")
        if not self._files:
            raise AnyNetError(f"{root}: expected files NNNNNNN.npy written by `anynet render`, found none")

    def __len__(self) -> int:
        return len(self._files)

    def load(self, index: int) -> RenderedSample:
        path = self._files[index]
        with telling_damage(path, "not a pair that `anynet render` wrote"):
            record: NDArray[Any] = np.load(path, mmap_mode="r")
            if record.ndim or record.dtype != _record(*record.dtype["disparity"].shape[1:]):
                raise ValueError(f"got {record.dtype} {list(record.shape)}")
            disparity, right_disparity = np.multiply(record["disparity"], np.float32(1 / SCALE), dtype=np.float32)
            occluded, right_occluded = record["occluded"]
        return RenderedSample(
            left=record["left"],
            right=record["right"],
            disparity=disparity,
            valid=disparity < MAX_DISPARITY,
            noc=~occluded,
            name=path.stem,
            right_disparity=right_disparity,
            occluded=occluded,
            right_occluded=right_occluded,
        )


def _render_to(path: Path, seed: int, height: int, width: int) -> None:
    cv2.setNumThreads(1)  # the processes share the cores
    _store(path, render(seed, height, width))


def write_rendered(
    root: Path, count: int, seed: int = 0, height: int = 384, width: int = 768, workers: int = 1
) -> Iterator[int]:
    """Renders pairs `seed` ... `seed` + `count` - 1 into a folder, yielding how many are there; files present are kept.

    Raises AnyNetError if the folder holds pairs of another size, or cannot be written to, or a process is killed.
    """
    make_folder(root)
    about = root / "render.json"
    settings = {"height": height, "width": width}
    if about.exists() and (stored := read_text(about).strip()) != json.dumps(settings):
        raise AnyNetError(f"{root}: holds pairs rendered with {stored[:100]!r}, asked for {json.dumps(settings)}")
    write_atomically(about, json.dumps(settings).encode())
    wanted = {root / f"{number:07d}.npy": number for number in range(seed, seed + count)}
    missing = {path: number for path, number in wanted.items() if not path.exists()}
    done = count - len(missing)
    yield done
    # Not forked: OpenCV's threads do not survive it.
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        try:
            tasks = [pool.submit(_render_to, path, number, height, width) for path, number in missing.items()]
            for task in as_completed(tasks):
                task.result()
                done += 1
                yield done
        except BrokenProcessPool:
            raise AnyNetError(
                f"{root}: a worker was killed, perhaps for lack of memory: go on with fewer --workers"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)
