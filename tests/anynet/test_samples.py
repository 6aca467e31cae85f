from __future__ import annotations

import numpy as np
import pytest

from anynet.samples import Concatenation, Dataset, StereoSample


class Numbered(Dataset):
    """Samples named after their numbers."""

    name = "numbered"

    def __len__(self) -> int:
        return 5

    def load(self, index: int) -> StereoSample:
        image = np.zeros((1, 1, 3), np.uint8)
        return StereoSample(image, image, np.zeros((1, 1), np.float32), np.ones((1, 1), bool), name=str(index))


def names(dataset: Dataset) -> list[str]:
    return [sample.name for sample in dataset]


def test_a_dataset_is_a_sequence() -> None:
    dataset = Numbered()
    assert names(dataset) == ["0", "1", "2", "3", "4"]
    assert dataset[-1].name == "4"
    for index in (5, -6):
        with pytest.raises(IndexError, match=f"numbered: no sample {index}, there are 5"):
            dataset[index]


def test_slices_read_nothing_and_keep_the_name() -> None:
    part = Numbered()[1::2]
    assert part.name == "numbered"
    assert names(part) == ["1", "3"]
    assert names(part[::-1]) == ["3", "1"]


def test_concatenation_has_chosen_samples_in_order() -> None:
    dataset = Numbered()
    both = Concatenation("both", [(dataset, 3), (dataset[2:], 0), (dataset, 3)])
    assert len(both) == 3
    assert names(both) == ["3", "2", "3"]
