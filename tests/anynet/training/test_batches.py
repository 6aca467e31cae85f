from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from planes import RECIPE, Planes

from anynet.errors import AnyNetError
from anynet.training.batches import batches, count_workers, telling_killed_workers
from anynet.training.distributed import Processes

CPU = torch.device("cpu")


def test_a_batch_that_does_not_divide_is_refused() -> None:
    with pytest.raises(AnyNetError, match="a batch of 4 does not divide among 3 processes"):
        batches(Planes(4), RECIPE, range(1), Processes(0, 3, CPU))


def test_what_the_right_crop_does_not_show_weighs_less() -> None:
    planes = Planes(4)
    recipe = replace(RECIPE, batch_size=1, occluded_weight=0.25)
    found = set()
    for _, _, disparity, weights in batches(planes, recipe, range(4), Processes(0, 1, CPU)):
        shift = int(disparity.max())
        known = (disparity > 0).float()
        assert torch.equal(weights[..., :shift], 0.25 * known[..., :shift])
        assert torch.equal(weights[..., shift:], known[..., shift:])
        found |= set(weights.unique().tolist())
    assert found == {0.0, 0.25, 1.0}
    for (*_, all_equal), (*_, weights) in zip(
        batches(planes, replace(recipe, occluded_weight=1.0), range(4), Processes(0, 1, CPU)),
        batches(planes, recipe, range(4), Processes(0, 1, CPU)),
        strict=True,
    ):
        assert torch.equal(all_equal, (weights > 0).float())


def test_what_is_far_can_weigh_less() -> None:
    sample = Planes(1)[0]
    disparity = np.where(np.arange(sample.disparity.shape[1]) % 2, np.float32(0.3), sample.disparity)
    far = replace(sample, disparity=disparity, valid=np.ones_like(sample.valid))
    recipe = replace(RECIPE, batch_size=1, augment=False, occluded_weight=0.5, far_weight=0.25)
    ((*_, found, weights),) = batches([far], recipe, range(1), Processes(0, 1, CPU))
    assert set(weights[found < 0.5].tolist()) <= {0.25, 0.125}
    assert set(weights[found > 0.5].tolist()) <= {1.0, 0.5}
    assert {0.25, 1.0} <= set(weights.unique().tolist())
    with pytest.raises(AnyNetError, match=r"far_weight must be in \[0, 1\], got 2"):
        replace(RECIPE, far_weight=2)
    with pytest.raises(AnyNetError, match=r"robust_scale must be positive or 0, got -1"):
        replace(RECIPE, robust_scale=-1)
    with pytest.raises(AnyNetError, match=r"smooth_below must be positive, got 0"):
        replace(RECIPE, smooth_below=0)


def test_the_processes_share_the_batch_of_one() -> None:
    whole, *parts = (
        list(batches(Planes(7), RECIPE, range(5, 8), Processes(rank, count, CPU)))
        for rank, count in [(0, 1), (0, 2), (1, 2)]
    )
    for one, *shares in zip(whole, *parts, strict=True):
        for tensor, *pieces in zip(one, *shares, strict=True):
            torch.testing.assert_close(torch.cat(pieces), tensor, rtol=0, atol=0)


@pytest.mark.parametrize("workers", [0, 1])
def test_a_damaged_sample_is_told_in_its_own_line(workers: int) -> None:
    class Damaged(Planes):
        def __getitem__(self, index):
            if index == 3:
                raise AnyNetError("a.png: damaged")
            return super().__getitem__(index)

    recipe = replace(RECIPE, batch_size=2, workers=workers)
    found = batches(Damaged(70), recipe, range(70), Processes(0, 1, CPU))  # more than are decoded beforehand
    with pytest.raises(AnyNetError, match=r"\Aa\.png: damaged\Z"):
        list(found)


def test_a_gpu_gets_its_share_of_the_cores_for_its_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(24)))

    def count(device: str, world_size: int = 1, workers: int | None = None) -> int:
        processes = Processes(0, world_size, torch.device(device))
        return count_workers(replace(RECIPE, workers=workers), processes)

    assert [count("cpu"), count("cuda"), count("cuda", 4), count("cuda", 100)] == [1, 16, 6, 1]
    assert [count("cpu", workers=3), count("cuda", workers=0)] == [3, 0]


@pytest.mark.parametrize(
    ("error", "told"),
    [
        ("DataLoader worker (pid 7) is killed by signal: Killed. ", "was killed (Killed), perhaps for lack of memory"),
        (
            "DataLoader worker (pid 7) is killed by signal: Bus error. It is possible that dataloader's workers are "
            "out of shared memory. Please try to raise your shared memory limit.",
            "was killed (Bus error), perhaps for lack of shared memory (/dev/shm; docker run --shm-size)",
        ),
        ("DataLoader worker (pid 7) is killed by signal: Segmentation fault. ", "was killed (Segmentation fault)"),
        ("DataLoader worker (pid(s) 7, 8) exited unexpectedly", "failed or was killed, perhaps for lack of memory"),
    ],
)
def test_what_ended_a_worker_is_told(error: str, told: str) -> None:
    with pytest.raises(AnyNetError) as caught, telling_killed_workers():
        raise RuntimeError(error)
    assert str(caught.value) == f"a worker {told}: go on with --resume and fewer --workers"
