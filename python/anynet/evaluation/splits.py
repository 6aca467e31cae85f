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
    rng = np.random.default_rng(seed)
    files = []
    for number in range(count):
        chosen = sorted(rng.permutation(list(names))[: round(share * len(names))])
        files.append(folder / f"split{number}.txt")
        files[-1].write_text("".join(f"{name}\n" for name in chosen))
    return files
