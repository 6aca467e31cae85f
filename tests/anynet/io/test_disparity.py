from __future__ import annotations

import resource
import struct
import time
import warnings
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from anynet.errors import AnyNetError
from anynet.io import read_disparity, read_pair, write_depth, write_disparity

NAN = np.float32(np.nan)
SHARED = Path(__file__).parents[3] / ".." / "shared" / "data"
MAP = np.array([[0.5, NAN, 3.25], [200.125, 1 / 256, 70]], np.float32)  # exact in every format


@pytest.mark.parametrize("ending", ["png", "pfm", "npy"])
def test_round_trip(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"map.{ending}"
    write_disparity(path, MAP)
    read = read_disparity(path)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, MAP)


def test_png_is_kittis(tmp_path: Path) -> None:
    write_disparity(tmp_path / "map.png", np.array([[0, 0.001, -3, NAN, 1.002, 255.99]], np.float32))
    levels = cv2.imread(str(tmp_path / "map.png"), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    np.testing.assert_array_equal(levels, [[1, 1, 1, 0, 257, 65533]])  # 0 would mean unknown


def test_png_has_an_end(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"holds disparities below 256 pixels, got 300\.0; use pfm or npy"):
        write_disparity(tmp_path / "map.png", np.full((2, 2), 300, np.float32))
    assert list(tmp_path.iterdir()) == []


def test_png_of_8_bits_needs_its_scale(tmp_path: Path) -> None:
    path = tmp_path / "middlebury.png"
    Image.fromarray(np.array([[0, 3, 255]], np.uint8)).save(path)
    np.testing.assert_array_equal(read_disparity(path, scale=3), [[NAN, 1, 85]])
    with pytest.raises(AnyNetError, match="expected KITTI's 16 bits per pixel, got 8 bits"):
        read_disparity(path)


def test_png_of_colors_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "color.png"
    Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(path)
    with pytest.raises(AnyNetError, match="expected one channel of disparity, got an image of mode RGB"):
        read_disparity(path)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("scale", ["1", "0.00392157"])  # Middlebury's files have odd scales; the values are pixels
def test_pfm_byte_order_rows_and_scale(tmp_path: Path, order: str, scale: str) -> None:
    path = tmp_path / "map.pfm"
    sign = "-" if order == "<" else ""
    samples = struct.pack(f"{order}6f", 4, 5, float("inf"), 1, 2, 3)  # the bottom row comes first
    path.write_bytes(f"Pf\n3 2\n{sign}{scale}\n".encode() + samples)
    np.testing.assert_array_equal(read_disparity(path), [[1, 2, 3], [4, 5, NAN]])


def test_pfm_samples_may_look_like_blanks(tmp_path: Path) -> None:
    path = tmp_path / "map.pfm"
    value = struct.unpack("<f", b"\n\n \n")[0]
    path.write_bytes(b"Pf\n2 1\n-1\n" + 2 * b"\n\n \n")
    np.testing.assert_array_equal(read_disparity(path), np.full((1, 2), value, np.float32))


def test_pfm_is_what_opencv_and_pillow_read(tmp_path: Path) -> None:
    path = tmp_path / "map.pfm"
    write_disparity(path, MAP)
    expected = np.where(np.isnan(MAP), np.inf, MAP)
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), expected)
    np.testing.assert_array_equal(np.asarray(Image.open(path)), expected)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a PFM file"),
        (b"P5\n2 2\n255\nabcd", "expected a PFM file of one channel"),
        (b"Pf\n2 x\n-1\n", "not a PFM file"),
        (b"Pf\n2 2\n-1", "not a PFM file"),
        (b"PF\n1 1\n-1\n" + 12 * b"x", r"expected a PFM file of one channel \(Pf\), got 'PF'"),
        (b"Pf\n2 2\n-1\n" + 15 * b"x", "expected 16 bytes for 2 x 2 pixels, got 15"),
    ],
)
def test_damaged_pfm(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "bad.pfm"
    path.write_bytes(data)
    with pytest.raises(AnyNetError, match=message):
        read_disparity(path)


def test_npz_of_one_array(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    np.savez_compressed(path, np.where(np.isnan(MAP), np.inf, MAP).astype(np.float64))
    np.testing.assert_array_equal(read_disparity(path), MAP)


def test_unsuitable_numpy_files(tmp_path: Path) -> None:
    cases = {
        "two.npz": "expected one array, got",
        "three.npy": r"expected numbers of shape \[H, W\], got float64 \[2, 3, 4\]",
        "complex.npy": "got complex128",
        "objects.npy": r"expected numbers of shape \[H, W\], got object",
        "text.npy": "not a NumPy file of plain numbers",
        "text.npz": "not a NumPy file of plain numbers",
    }
    np.savez(tmp_path / "two.npz", a=MAP, b=MAP)
    np.save(tmp_path / "three.npy", np.zeros((2, 3, 4)))
    np.save(tmp_path / "complex.npy", np.zeros((2, 3), complex))
    np.save(tmp_path / "objects.npy", np.array([[print]]), allow_pickle=True)
    (tmp_path / "text.npy").write_text("text")
    (tmp_path / "text.npz").write_text("PK text")
    for name, message in cases.items():
        with pytest.raises(AnyNetError, match=message):
            read_disparity(tmp_path / name)


@pytest.mark.parametrize("ending", ["png", "pfm", "npy", "npz"])
def test_a_file_cut_anywhere_is_told(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"map.{ending}"
    if ending == "npz":
        np.savez_compressed(path, MAP)
    else:
        write_disparity(path, MAP)
    data = path.read_bytes()
    for length in range(len(data) - 1):
        path.write_bytes(data[:length])
        try:
            read = read_disparity(path)
        except AnyNetError:
            continue
        np.testing.assert_array_equal(read, MAP)  # only checksums behind the pixels were cut off
        assert ending == "png"
        assert length > len(data) - 24


def test_a_compressed_array_damaged_anywhere_is_told(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    np.savez_compressed(path, np.arange(64, dtype=np.float32).reshape(8, 8))
    data = path.read_bytes()
    refused = []
    for place in range(len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        try:
            read_disparity(path)
        except AnyNetError as error:
            refused.append(str(error))
    assert len(refused) > len(data) // 2  # there are names, dates and rights too
    assert all("map.npz" in message and "\n" not in message for message in refused)


def test_unknown_endings(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected a disparity map in a"):
        read_disparity(tmp_path / "map.flo")
    with pytest.raises(AnyNetError, match="expected a name ending in"):
        write_disparity(tmp_path / "map.flo", MAP)


def test_depth_is_a_float_tiff(tmp_path: Path) -> None:
    path = tmp_path / "depth.tiff"
    write_depth(path, MAP)
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, MAP)


@pytest.mark.skipif(not SHARED.exists(), reason="the real pairs are not in ../shared/data")
def test_real_files() -> None:
    kitti = read_disparity(SHARED / "kitti2015/training/disp_noc_0/000002_10.png")
    assert kitti.shape == (375, 1242)
    assert 0.1 < np.isfinite(kitti).mean() < 0.4
    assert 3 < np.nanmin(kitti) < np.nanmax(kitti) < 192


@pytest.mark.skipif(not SHARED.exists(), reason="the real pairs are not in ../shared/data")
@pytest.mark.parametrize(
    ("folder", "left", "right", "truth"),
    [
        ("middlebury2014Q/Motorcycle", "im0.png", "im1.png", "disp0GT.pfm"),
        ("eth3d/playground", "im0.png", "im1.png", "disp0.pfm"),
        ("motorcycle", "motorcycle_left.png", "motorcycle_right.png", "motorcycle_disp.npz"),
    ],
)
def test_real_disparities_lead_to_the_same_color(folder: str, left: str, right: str, truth: str) -> None:
    images = read_pair(SHARED / folder / left, SHARED / folder / right)
    disparity = read_disparity(SHARED / folder / truth)

    def difference(shift: np.ndarray) -> float:
        rows, columns = np.nonzero(np.isfinite(shift))
        there = np.clip(np.round(columns - shift[rows, columns]).astype(int), 0, shift.shape[1] - 1)
        return float(np.median(np.abs(images[0][rows, columns].astype(int) - images[1][rows, there])))

    assert difference(disparity) < 0.9 * difference(disparity[::-1])  # the rows are not upside down


def test_our_own_depth_is_read(tmp_path: Path) -> None:
    write_depth(tmp_path / "depth.tiff", MAP)
    np.testing.assert_array_equal(read_disparity(tmp_path / "depth.tiff"), MAP)
    Image.fromarray(np.ones((2, 2), np.uint8)).save(tmp_path / "bytes.tiff")
    with pytest.raises(AnyNetError, match=r"bytes\.tiff: expected a TIFF of 32-bit floating point, got .* mode L"):
        read_disparity(tmp_path / "bytes.tiff")


def test_lenient_pfm(tmp_path: Path) -> None:
    path = tmp_path / "map.pfm"
    samples = MAP[::-1].tobytes()
    for header, end in (
        (b"Pf\n3 2\n-1\n", b"\n"),
        (b"Pf\n3 2\n-1\n", b"\r\n"),
        (b"Pf\n3 2\n-1 \n", b""),
        (b"Pf\n# by a script\n3 2\n# and more\n-1\n", b""),
        (b"Pf\r\n3 2\r\n-1\r\n", b""),
        (b"Pf 3 2 -1\n", b""),
    ):
        path.write_bytes(header + samples + end)
        np.testing.assert_array_equal(read_disparity(path), MAP)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"Pf\n0 5\n-1\n", "expected at least one pixel, got 0 x 5"),
        (b"Pf\n-2 -3\n-1\n" + bytes(24), "not a PFM file"),
        (b"Pf\n100000 100000\n-1\n", "expected at most 67108864 pixels, got 100000 x 100000"),
        (b"Pf\n" + b"9" * 5000 + b" 2\n-1\n", "not a PFM file"),
        (b"Pf\n1 1\nnan\nabcd", "not a PFM file"),
        (b"Pf\n1 1\n0\nabcd", "expected a scale that tells the byte order"),
        (b"Pf\n1 1\n1e999\nabcd", "expected a scale that tells the byte order"),
        (b"Pf\n1 1\n-e\nabcd", "not a PFM file"),
        (b"Pf" + b" " * 100_000 + b"1 1\n-1\nabcd", "not a PFM file"),
        (b"Pf" + b"#\n" * 100_000, "not a PFM file"),
    ],
)
def test_absurd_pfm(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "bad.pfm"
    path.write_bytes(data)
    start = time.process_time()
    with pytest.raises(AnyNetError, match=rf"bad\.pfm: {message}"):
        read_disparity(path)
    assert time.process_time() - start < 1


def _npy(descr: str, shape: str, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY" + version + struct.pack("<H", len(header) + 1) + header + b"\n" + data


@pytest.mark.parametrize(
    "data",
    [
        _npy("'<f4'", "(90000, 90000)"),
        _npy("'<f4'", "(8000, 8000)", bytes(100)),
        _npy("'<f4'", f"({2**62}, {2**62})"),
        _npy("'<f4'", "(-1, 4)", bytes(16)),
        _npy("'<f4'", "(2, 2)", bytes(17)),
        _npy("'<f16'", "(1, 1)", bytes(16)),
        _npy("'<f4'", "(0, 5)"),
        _npy("'<f4'", "(True, 1)", bytes(4)),
        _npy("'<f4'", "(1, 2", bytes(8)),
        _npy("'|O'", "(1, 1)", bytes(8)),
        _npy("[('a', '<f4')]", "(1, 1)", bytes(4)),
        _npy("'<f4'", "(" * 5000, bytes(8)),
        _npy("'<f4'", "-" * 5000 + "1", bytes(8)),
        _npy("'<f4'", "(" + "9" * 5000 + ", 1)", bytes(8)),
        _npy("'<f4'", "(1, 1)", bytes(4), version=b"\x09\x00"),
        _npy("3", "(1, 1)", bytes(4)),
        _npy("'<f4\0'", "(1, 1)", bytes(4)),
    ],
)
def test_damaged_and_lying_arrays(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "map.npy").write_bytes(data)
    with zipfile.ZipFile(tmp_path / "map.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("map.npy", data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for name in ("map.npy", "map.npz"):
        if name == "map.npy" and b"True" in data:
            continue  # NumPy takes it for 1
        with pytest.raises(AnyNetError, match=rf"{name}[^\n]*$"):
            read_disparity(tmp_path / name)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # KB


def test_archives_that_are_bombs(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    for method, message in (
        (zipfile.ZIP_DEFLATED, "expected at most 67108864 pixels"),
        (zipfile.ZIP_BZIP2, "expected an array stored or deflated"),
        (zipfile.ZIP_LZMA, "expected an array stored or deflated"),
    ):
        with zipfile.ZipFile(path, "w", method) as archive, archive.open("map.npy", "w", force_zip64=True) as member:
            member.write(_npy("'<f8'", "(20000, 10000)"))
            for _ in range(16):
                member.write(bytes(2**20))
        with pytest.raises(AnyNetError, match=message):
            read_disparity(path)
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(1500):
            archive.writestr(f"{number}.npy", b"")
    with pytest.raises(AnyNetError, match=r"bomb\.npz: expected an archive of one array, got more than 1000"):
        read_disparity(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("notes.txt", b"a member that is no array")
    with pytest.raises(AnyNetError, match=r"bomb\.npz: not a NumPy file"):
        read_disparity(path)
    assert time.process_time() - start < 3
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KB


@pytest.mark.parametrize("ending", ["pfm", "npy", "npz"])
def test_values_that_mean_something_else(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"map.{ending}"

    def write(value: float) -> None:
        values = np.array([[1, value, NAN]], np.float32)
        if ending == "npz":
            np.savez(path, values)
        else:
            write_disparity(path, values)

    write(3e6)  # such as the other byte order gives
    with pytest.raises(AnyNetError, match=rf"map\.{ending}: expected values up to 1e\+06, got 3e\+06"):
        read_disparity(path)
    write(-3)
    with pytest.warns(UserWarning, match=rf"map\.{ending}: 1 of 2 known values are negative"):
        assert read_disparity(path)[0, 1] == -3


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf")])
def test_impossible_scales(tmp_path: Path, scale: float) -> None:
    write_disparity(tmp_path / "map.png", MAP)
    with pytest.raises(AnyNetError, match=r"map\.png: expected scale > 0"):
        read_disparity(tmp_path / "map.png", scale)


def test_doubles_beyond_floats_are_unknown(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.array([[1e300, 2.0]]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(read_disparity(tmp_path / "map.npy"), [[NAN, 2]])
