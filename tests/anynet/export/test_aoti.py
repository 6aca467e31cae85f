"""Packages of AOTInductor, in Python and in the example in C++."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from torch._inductor.package import load_package

import anynet_ext
from anynet import AnyNetError
from anynet.export import export_as
from anynet.export.network import Request
from anynet.io import read_disparity, write_image

from .cases import Pair

EXAMPLE = Path(__file__).parents[3] / "examples" / "cpp"


def test_it_is_for_one_size(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected images of one size for aoti"):
        export_as("aoti", Request("default", 40, 56, dynamic=True), tmp_path / "network.pt2")


@pytest.mark.parametrize("compiler", ["/none/c++", "false"])
def test_a_compiler_that_does_not_work(small_weights: Path, tmp_path: Path, compiler: str) -> None:
    chosen = torch._inductor.config.patch({"cpp.cxx": (compiler,)})
    with chosen, pytest.raises(AnyNetError, match=r"export: the C\+\+ compiler failed: [^\n]+\Z"):
        export_as("aoti", Request(small_weights, 17, 17, stages=1), tmp_path / "network.pt2")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def package(small_weights: Path, pair: Pair, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("aoti") / "small.pt2"
    export_as("aoti", Request(small_weights, *pair.left.shape[:2]), path)
    return path


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_the_whole_and_stage_by_stage(package: Path, small_weights: Path, pair: Pair) -> None:
    expected = pair.disparities(small_weights)
    values = {"left": torch.from_numpy(pair.left), "right": torch.from_numpy(pair.right)}
    for one, other in zip(load_package(str(package))(*values.values()), expected, strict=True):
        np.testing.assert_array_equal(one, other)
    for stage, disparity in enumerate(expected, 1):
        model = load_package(str(package), f"stage_{stage}")
        names = model.get_metadata()
        values |= zip(names["outputs"].split(), model(*[values[n] for n in names["inputs"].split()]), strict=True)
        np.testing.assert_array_equal(values[f"disparity_{stage}"], disparity)


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.skipif(not shutil.which("cmake"), reason="needs CMake, and OpenCV's and libtorch's C++ libraries")
def test_the_example_in_cpp(package: Path, small_weights: Path, pair: Pair, tmp_path: Path) -> None:
    configure = ["cmake", "-S", EXAMPLE, "-B", tmp_path, f"-DCMAKE_PREFIX_PATH={torch.utils.cmake_prefix_path}"]
    configured = subprocess.run([*configure, "-DCMAKE_BUILD_TYPE=Release"], check=False, capture_output=True, text=True)
    if "OpenCVConfig.cmake" in configured.stderr:
        pytest.skip("needs OpenCV for C++: apt-get install libopencv-dev")
    assert configured.returncode == 0, configured.stderr
    subprocess.run(["cmake", "--build", tmp_path], check=True, stdout=subprocess.DEVNULL)
    images = [tmp_path / "left.png", tmp_path / "right.png"]
    for path, image in zip(images, (pair.left, pair.right), strict=True):
        write_image(path, image)
    library, out = anynet_ext.build_info()["library"], tmp_path / "disparity.tiff"
    run = [tmp_path / "anytime", package, library, *images, out]
    expected = pair.disparities(small_weights)
    for budget, stage in (([], 4), (["0"], 1)):
        told = subprocess.run([*run, *budget], check=True, capture_output=True, text=True).stdout
        assert told.splitlines()[-1].startswith(f"stage {stage}: ")
        np.testing.assert_array_equal(read_disparity(out), expected[stage - 1])
    short = subprocess.run(
        [*run[:3], images[0], tmp_path / "none.png", out], check=False, capture_output=True, text=True
    )
    assert (short.returncode, short.stderr) == (1, f"anytime: {tmp_path / 'none.png'}: cannot be read\n")
