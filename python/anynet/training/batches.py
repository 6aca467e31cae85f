"""The stream of training batches: a function of (seed, step), so that a run can stop and go on anywhere."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from anynet.data import StereoSample
from anynet.data.augment import augment, random_crop
from anynet.errors import AnyNetError
from anynet.training.distributed import Processes
from anynet.training.recipe import Recipe

MOST_WORKERS = 16  # unless asked for more: each keeps some batches ready
# Of the death of a worker, by its signal's name; None: not known.
_CAUSES = {
    None: ", perhaps for lack of memory",
    "Killed": ", perhaps for lack of memory",
    "Bus error": ", perhaps for lack of shared memory (/dev/shm; docker run --shm-size)",
}
FAR = 0.5  # pixels of disparity: `Recipe.far_weight` is for less

Item = tuple[Tensor, Tensor, Tensor, Tensor]


class _Crops(Dataset["Item | AnyNetError"]):
    """Draw number i of a run: epoch after epoch, each in an order of its own, augmented by a generator of its own."""

    def __init__(self, samples: Sequence[StereoSample], recipe: Recipe) -> None:
        # So few are decoded once; workers share the memory.
        self._samples = list(samples) if len(samples) <= 64 else samples
        self._recipe = recipe
        self._epoch = -1
        self._order = np.empty(0, np.int64)

    def __getitem__(self, draw: int) -> Item | AnyNetError:
        """A damaged file's error as a value: raised by a worker, it would come with its traceback as text."""
        try:
            return self._item(draw)
        except AnyNetError as error:
            return error

    def _item(self, draw: int) -> Item:
        recipe = self._recipe
        epoch, place = divmod(draw, len(self._samples))
        if epoch != self._epoch:
            self._epoch = epoch
            self._order = np.random.default_rng((recipe.seed, 0, epoch)).permutation(len(self._samples))
        rng = np.random.default_rng((recipe.seed, 1, draw))
        sample = self._samples[int(self._order[place])]
        if recipe.augment:
            sample = augment(sample, recipe.crop_size, rng, perturb=recipe.perturb)
        else:
            sample = random_crop(sample, recipe.crop_size, rng)
        assert sample.noc is not None  # crops say what they show
        disparity = np.where(sample.valid, sample.disparity, np.float32(0))
        weights = np.where(sample.noc, np.float32(1), np.float32(recipe.occluded_weight) * sample.valid)
        weights[disparity < FAR] *= recipe.far_weight
        return (
            torch.from_numpy(np.ascontiguousarray(sample.left.transpose(2, 0, 1))),
            torch.from_numpy(np.ascontiguousarray(sample.right.transpose(2, 0, 1))),
            torch.from_numpy(disparity[None]),
            torch.from_numpy(weights[None]),
        )


class _BatchSampler:
    """The draws of this process, step by step. All processes together make the batch that one process would."""

    def __init__(self, steps: range, batch: int, processes: Processes) -> None:
        self._steps, self._batch, self._processes = steps, batch, processes

    def __iter__(self) -> Iterator[range]:
        share = self._batch // self._processes.world_size
        for step in self._steps:
            start = step * self._batch + self._processes.rank * share
            yield range(start, start + share)

    def __len__(self) -> int:
        return len(self._steps)


def _collated(items: list[Item | AnyNetError]) -> list[Tensor] | AnyNetError:
    failed = next((item for item in items if isinstance(item, AnyNetError)), None)
    return default_collate(items) if failed is None else failed


def _raising(loader: DataLoader[Item | AnyNetError]) -> Iterator[list[Tensor]]:
    for batch in loader:
        if isinstance(batch, AnyNetError):
            raise batch
        yield batch


@contextmanager
def telling_killed_workers() -> Iterator[None]:
    """PyTorch tells of them wherever the process is, not only where it waits for data.

    Raises:
        AnyNetError: if a process that prepares data ended, mostly killed by the kernel or somebody.
    """
    try:
        yield
    except RuntimeError as error:
        end = re.match(
            r"DataLoader worker \(pid.*(?:killed by signal: (?P<signal>[^.]*)|exited unexpectedly)", str(error)
        )
        if end is None:
            raise
        name = end["signal"]
        how, cause = f"was killed ({name})" if name else "failed or was killed", _CAUSES.get(name, "")
        raise AnyNetError(f"a worker {how}{cause}: go on with --resume and fewer --workers") from None


def count_workers(recipe: Recipe, processes: Processes) -> int:
    """The recipe's; else one beside a CPU that trains, and this process's share of the cores beside a GPU."""
    if recipe.workers is not None:
        return recipe.workers
    if processes.device.type == "cpu":
        return 1
    return max(1, min(MOST_WORKERS, len(os.sched_getaffinity(0)) // processes.world_size))


def batches(
    samples: Sequence[StereoSample], recipe: Recipe, steps: range, processes: Processes
) -> Iterator[list[Tensor]]:
    """This process's part of the batches of `steps`.

    Each is left, right uint8 [B,3,h,w], disparity float32 [B,1,h,w] (0 where unknown), and the pixels' weights in the
    loss, float32 [B,1,h,w]: 0 where unknown, `recipe.occluded_weight` where the right crop does not show them, else 1;
    times `recipe.far_weight` where they are farther than FAR.

    Raises:
        AnyNetError: if the batch does not divide among the processes, or, later, if a sample cannot be read.
    """
    if recipe.batch_size % processes.world_size:
        raise AnyNetError(f"a batch of {recipe.batch_size} does not divide among {processes.world_size} processes")
    workers = count_workers(recipe, processes)
    loader = DataLoader(
        _Crops(samples, recipe),
        collate_fn=_collated,
        batch_sampler=_BatchSampler(steps, recipe.batch_size, processes),  # type: ignore[arg-type]
        num_workers=workers,
        prefetch_factor=4 if workers else None,
        pin_memory=processes.device.type == "cuda",
    )
    return _raising(loader)
