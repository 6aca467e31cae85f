from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from processes import completed

from anynet import AnyNetError
from anynet.export import export_as
from anynet.export.network import Request

from .cases import WEIGHTS, Pair


def test_it_is_the_predictors_for_images_of_any_size(small_weights: Path, pair: Pair, tmp_path: Path) -> None:
    path = tmp_path / "small.pt2"
    export_as("pt2", Request(small_weights, 40, 56, dynamic=True), path)
    program = torch.export.load(path).module()
    for rows, columns in ((83, 141), (17, 17), (64, 50)):
        part = Pair(*(np.ascontiguousarray(image[:rows, :columns]) for image in (pair.left, pair.right)))
        found = program(torch.from_numpy(part.left), torch.from_numpy(part.right))
        for one, other in zip(found, part.disparities(small_weights), strict=True):
            np.testing.assert_array_equal(one, other)
    load = f"import torch; torch.export.load({str(path)!r})"
    without, loaded = completed([[sys.executable, "-c", code] for code in (load, f"import anynet_ext; {load}")])
    assert "anynet" in without.stderr
    assert loaded.returncode == 0, loaded.stderr


def test_its_name_is_checked(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"expected a name that ends in .pt2"):
        export_as("pt2", Request("default", 40, 56), tmp_path / "network.pt")
    assert not list(tmp_path.iterdir())


def test_the_file_is_as_it_was_after_an_error(tmp_path: Path) -> None:
    """A limit on the size of files stands for the full disk, on which PyTorch's own writer aborts the process."""
    path = tmp_path / "network.pt2"
    path.write_bytes(b"before")
    program = f"""
import resource
from pathlib import Path
from anynet.export import export_as
from anynet.export.network import Request
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
try:
    export_as("pt2", Request("paper", 40, 56), Path({str(path)!r}))
except ValueError as error:
    print(error)
"""
    (result,) = completed([[sys.executable, "-c", program]])
    assert result.stdout == f"cannot write {path}: {os.strerror(errno.EFBIG)}\n", result.stderr
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("network.pt2", b"before")]


@pytest.mark.slow
@pytest.mark.parametrize("weights", WEIGHTS)
def test_packaged_weights(weights: str, pair: Pair, tmp_path: Path) -> None:
    export_as("pt2", Request(weights, *pair.left.shape[:2]), tmp_path / "network.pt2")
    found = torch.export.load(tmp_path / "network.pt2").module()(*map(torch.from_numpy, (pair.left, pair.right)))
    for one, other in zip(found, pair.disparities(weights), strict=True):
        np.testing.assert_array_equal(one, other)
