from __future__ import annotations

from pathlib import Path

from anynet.evaluation.splits import write_splits


def test_splits_share_the_names(tmp_path: Path) -> None:
    names = [f"{i:06d}_10" for i in range(35)]
    splits = [path.read_text().split() for path in write_splits(names, tmp_path)]
    assert len({tuple(split) for split in splits}) == 5
    assert all(len(split) == 7 and set(split) < set(names) for split in splits)
