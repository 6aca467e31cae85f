"""Whatever the user gives: one line that says what is wrong, exit status 2, and nothing half-written."""

from __future__ import annotations

import errno
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from processes import completed

from anynet.errors import printable
from anynet.io import read_disparity, read_image, write_image

from .conftest import Run


def refused(run: Run, out: Path, message: str, *arguments: object) -> None:
    result = run("predict", *arguments, "--out", out)
    assert result.status == 2
    assert result.out == ""
    (line,) = result.err.splitlines()
    assert line.startswith("anynet: ")
    assert message in line
    assert not out.exists() or list(out.iterdir()) == []


def test_missing_file(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    missing = tmp_path / "none.png"
    message = f"cannot read {missing}: No such file or directory"
    refused(run, tmp_path / "out", message, missing, pair[1], "--weights", weights)
    refused(run, tmp_path / "out", message, pair[0], missing, "--weights", weights)


def test_what_is_no_file(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "loop.png").symlink_to("loop.png")
    for path, message in (
        (tmp_path / "pipe.png", "expected a file, got a pipe"),
        ("/dev/zero", "expected a file, got a device"),
        (tmp_path / "loop.png", "Too many levels of symbolic links"),
    ):
        message = f"cannot read {path}: {message}"
        refused(run, tmp_path / "out", message, path, pair[1], "--weights", weights)
        refused(run, tmp_path / "out", message, pair[0], path, "--weights", weights)


def test_truncated_png(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    data = pair[1].read_bytes()
    for length in (0, 20, len(data) // 2):
        pair[1].write_bytes(data[:length])
        refused(run, tmp_path / "out", f"cannot read {pair[1]}: ", *pair, "--weights", weights)


def test_unequal_sizes(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    write_image(pair[1], read_image(pair[1])[:, 1:])
    message = "expected two images of one size, got 64 x 48 and 63 x 48"
    refused(run, tmp_path / "out", message, *pair, "--weights", weights)


@pytest.mark.parametrize("kind", ["gray", "16 bit", "alpha"])
def test_other_images_are_converted(
    run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path, kind: str
) -> None:
    gray = [read_image(path)[..., 1] for path in pair]
    for path, image in zip(pair, gray, strict=True):
        write_image(path, np.repeat(image[..., None], 3, axis=2))
    arguments = ("predict", *pair, "--weights", weights, "--format", "npy", "--json", "--out")
    assert run(*arguments, tmp_path / "rgb").status == 0
    for path, image in zip(pair, gray, strict=True):
        other = {
            "gray": image,
            "16 bit": image.astype(np.uint16) * 257,
            "alpha": np.dstack([image, image, image, np.full_like(image, 9)]),
        }[kind]
        Image.fromarray(other).save(path)
    result = run(*arguments, tmp_path / "other")
    assert result.status == 0
    same = [np.load(tmp_path / folder / "left_disparity.npy") for folder in ("rgb", "other")]
    np.testing.assert_array_equal(*same)
    expected = [f"{path}: the alpha channel is ignored" for path in pair] if kind == "alpha" else []
    assert json.loads(result.out)["warnings"] == expected
    assert result.err.splitlines() == [f"anynet: left: warning: {warning}" for warning in expected]


def test_floating_point_images(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    deep = tmp_path / "deep.tiff"
    Image.fromarray(np.ones((48, 64), np.float32)).save(deep)
    refused(run, tmp_path / "out", "expected an image of 8 or 16 bits", deep, deep, "--weights", weights)


@pytest.mark.parametrize("size", [(1, 1), (3, 200), (15, 15), (200, 2)])
def test_images_smaller_than_the_stride(run: Run, weights: Path, tmp_path: Path, size: tuple[int, int]) -> None:
    path = tmp_path / "small.png"
    write_image(path, np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8))
    assert run("predict", path, path, "--out", tmp_path, "--weights", weights, "--all-stages").status == 0
    assert read_disparity(tmp_path / "small_disparity.png").shape == size


@pytest.mark.parametrize("content", [b"", b"not weights", b"\x08\0\0\0\0\0\0\0{}      ", b"PK\x03\x04 neither"])
def test_a_checkpoint_that_is_not_one(run: Run, pair: tuple[Path, Path], tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "weights"
    path.write_bytes(content)
    refused(run, tmp_path / "out", str(path), *pair, "--weights", path)


def test_a_missing_checkpoint(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    refused(run, tmp_path / "out", "expected a file of weights", *pair, "--weights", tmp_path / "none")


def test_a_calibration_lacking_a_field(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    calib = tmp_path / "calib.txt"
    calib.write_text("cam0=[100 0 30; 0 100 20; 0 0 1]\ndoffs=0\n")
    given = (*pair, "--weights", weights)
    refused(run, tmp_path / "out", f"{calib}: the calibration lacks baseline", *given, "--calib", calib)
    refused(run, tmp_path / "out", f"cannot read {tmp_path / 'none'}", *given, "--calib", tmp_path / "none")
    refused(run, tmp_path / "out", "the calibration lacks --baseline", *given, "--focal", 500)
    refused(run, tmp_path / "out", "the calibration lacks --focal and --baseline", *given, "--cx", 500)
    refused(run, tmp_path / "out", "expected baseline > 0", *given, "--focal", 500, "--baseline", -1)


def test_a_calibration_for_another_size(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    calib = tmp_path / "calib.txt"
    calib.write_text("cam0=[100 0 30; 0 100 20; 0 0 1]\ndoffs=0\nbaseline=100\nwidth=640\nheight=480\n")
    message = "expected images of 640 x 480 as the calibration says, got 64 x 48"
    refused(run, tmp_path / "out", message, *pair, "--weights", weights, "--calib", calib)


def test_options_that_cannot_be(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    given = (*pair, "--weights", weights)
    refused(run, tmp_path / "out", "exclude each other", *given, "--all-stages", "--budget-ms", 5)
    refused(run, tmp_path / "out", "--alpha) belongs to a calibration of raw cameras", *given, "--alpha", 0)
    for option in (("--max-depth", 5), ("--depth-format", "png")):
        refused(run, tmp_path / "out", "--depth-format and --max-depth belong to a calibration", *given, *option)
    refused(run, tmp_path / "out", "expected --stage from 1 to 4, got 5", *given, "--stage", 5)
    refused(run, tmp_path / "out", "expected input_scale from 0.0625 to 4, got 9", *given, "--input-scale", 9)


def test_an_output_folder_that_cannot_be_made(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = run("predict", *pair, "--out", tmp_path / "file", "--weights", weights)
    assert (result.status, result.err) == (2, f"anynet: cannot make the folder {tmp_path / 'file'}: File exists\n")


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "anynet", *map(str, arguments)]


def test_a_full_disk(pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    """A limit on the size of files stands for the full disk. The old results stay whole."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "left_disparity.pfm").write_text("old")

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    arguments = command("predict", *pair, "--out", out, "--weights", weights, "--format", "pfm")
    result = subprocess.run(arguments, preexec_fn=limit, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr == f"anynet: cannot write {out / 'left_disparity.pfm'}: {os.strerror(errno.EFBIG)}\n"
    assert [path.name for path in out.iterdir()] == ["left_disparity.pfm"]
    assert (out / "left_disparity.pfm").read_text() == "old"


@pytest.mark.slow
def test_a_really_full_disk(pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=8k", "tmpfs", str(out)], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no right to mount a small disk: {mounted.stderr.strip()}")
    try:
        arguments = command("predict", *pair, "--out", out, "--weights", weights, "--format", "pfm")
        result = subprocess.run(arguments, capture_output=True, text=True, check=False)
        assert result.returncode == 2
        assert result.stderr == f"anynet: cannot write {out / 'left_disparity.pfm'}: No space left on device\n"
        assert list(out.iterdir()) == []
    finally:
        subprocess.run(["umount", str(out)], check=True)


def test_an_instruction_set_that_cannot_be_used(pair: tuple[Path, Path], tmp_path: Path) -> None:
    predict = ["predict", *map(str, pair), "--out", str(tmp_path)]
    every = [["info"], predict, ["evaluate", "--data", "rendered:?count=1"]]
    code = f"""
import os, sys
os.environ["ANYNET_ISA"] = sys.argv[1]
from anynet.cli import main
print([main(arguments) for arguments in {every}])
"""
    sets = "avx3", "\x1b[31m"
    commands = [[sys.executable, "-c", code, isa] for isa in sets]
    for isa, result in zip(sets, completed(commands), strict=True):
        assert (result.returncode, result.stdout) == (0, "[2, 2, 2]\n")
        lines = result.stderr.splitlines()
        assert len(lines) == 3
        for line in lines:
            assert line.startswith(f"anynet: ANYNET_ISA={printable(isa)}: expected one of ")
            assert "baseline" in line


def test_a_single_pair_that_fails_is_an_object_too(
    run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path
) -> None:
    pair[1].write_bytes(b"damaged")
    result = run("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--json")
    assert result.status == 2
    report = json.loads(result.out)
    assert report == {"name": "left", "error": f"cannot read {pair[1]}: not an image of a known format"}
    assert result.err == f"anynet: {report['error']}\n"


def test_results_that_would_replace_images(
    run: Run, scene: tuple[np.ndarray, ...], weights: Path, tmp_path: Path
) -> None:
    folders = tmp_path / "lefts", tmp_path / "rights"
    for folder, image in zip(folders, scene, strict=True):
        folder.mkdir()
        for name in ("a", "a_color", "b"):
            write_image(folder / f"{name}.png", image)
    images = {path: path.read_bytes() for folder in folders for path in folder.iterdir()}
    out = tmp_path / "link"
    out.symlink_to(folders[0])  # by any name
    for command in (("predict",), ("stream", "--stage", 1)):
        result = run(*command, *folders, "--out", out, "--weights", weights)
        assert result.status == 2
        told = f"{out / 'a_color.png'}: is one of the files to read; choose another folder for the results"
        assert told in result.err
        assert {path: path.read_bytes() for path in images} == images
