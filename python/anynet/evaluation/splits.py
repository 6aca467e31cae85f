"""Random splits of a data set into training and validation pairs, as the paper's five of KITTI."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np


def write_splits(names: Sequence[str], folder: Path, count: int = 5, share: float = 0.2, seed: int = 0) -> list[Path]:
    """Writes `count` files of names to validate on (split0.txt, ...), each a random share of them; the others train.

    Data sets take such a file as `split` (only these) and as `without` (all but these).
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for number, chosen in enumerate(draw_splits(len(names), count, share, seed)):
        files.append(folder / f"split{number}.txt")
        files[-1].write_text("".join(f"{name}\n" for name in sorted(names[i] for i in chosen)))
    return files


def draw_splits(pairs: int, count: int = 5, share: float = 0.2, seed: int = 0) -> list[list[int]]:
    """`count` times the indices of a random share of so many pairs, at least one: those to validate on."""
    rng = np.random.default_rng(seed)
    size = max(1, round(share * pairs))
    return [sorted(rng.permutation(pairs)[:size].tolist()) for _ in range(count)]
