from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from anynet.camera import Calibration, read_calibration
from anynet.errors import AnyNetError
from anynet.io import read_depth, read_disparity, write_depth

SHARED = Path(__file__).parents[3] / ".." / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.exists(), reason="the real pairs are not in ../shared/data")

MIDDLEBURY = "cam0=[1000 0 300; 0 1000 250; 0 0 1]\ncam1=[1000 0 330; 0 1000 250; 0 0 1]\ndoffs=30\nbaseline=200\n"
KITTI = "P2: 700 0 600 35 0 700 170 0 0 0 1 0\nP3: 700 0 600 -343 0 700 170 0 0 0 1 0\n"


def file(folder: Path, text: str) -> Path:
    path = folder / "calib.txt"
    path.write_text(text)
    return path


def opencv(folder: Path, **matrices: object) -> Path:
    path = folder / "calib.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in matrices.items():
        storage.write(name, np.array(value, float))
    storage.release()
    return path


def camera(focal: float, cx: float, cy: float, shift: float = 0) -> np.ndarray:
    return np.array([[focal, 0, cx, focal * shift], [0, focal, cy, 0], [0, 0, 1, 0]], float)


def test_depth() -> None:
    calibration = Calibration(focal=100, baseline=0.5, doffs=2)
    disparity = np.array([[3, 0, -2, -5, np.nan]], np.float32)
    depth = calibration.depth(disparity)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, np.array([[10, 25, np.nan, np.nan, np.nan]], np.float32))


@pytest.mark.parametrize("doffs", [0.0, 31.0])
def test_every_depth_can_be_read_back(tmp_path: Path, doffs: float) -> None:
    """A sky of a millionth of a pixel is farther than `read_depth` takes."""
    calibration = Calibration(focal=700, baseline=0.5, doffs=doffs)
    disparity = np.append(10.0 ** np.arange(-8.0, 2), 3.6e-4).astype(np.float32)[None] - np.float32(doffs)
    depth = calibration.depth(disparity)
    assert np.nanmax(depth) > 1e4
    assert np.isnan(depth).any()
    write_depth(tmp_path / "depth.tiff", depth)
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.tiff"), depth)


def test_points() -> None:
    depth = np.array([[2, 2, 2], [4, 4, np.nan]], np.float32)
    points = Calibration(focal=2, baseline=1, cx=1, cy=0).points(depth)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points[0], [[-1, 0, 2], [0, 0, 2], [1, 0, 2]])
    np.testing.assert_array_equal(points[1, :2], [[-2, 2, 4], [0, 2, 4]])
    assert np.isnan(points[1, 2, 2])
    centered = Calibration(focal=2, baseline=1).points(depth)
    np.testing.assert_array_equal(centered[0, 1], [0, -0.5, 2])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"focal": 0.0, "baseline": 1.0}, "expected focal > 0, got 0"),
        ({"focal": 1.0, "baseline": -0.5}, "expected baseline > 0, got -0.5"),
        ({"focal": float("nan"), "baseline": 1.0}, "expected focal > 0, got nan"),
        ({"focal": 1.0, "baseline": 1.0, "cx": float("inf")}, "expected a finite cx, got inf"),
    ],
)
def test_impossible_values(values: dict[str, float], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        Calibration(**values)


def test_middlebury(tmp_path: Path) -> None:
    calibration = read_calibration(file(tmp_path, MIDDLEBURY + "width=640\nheight=480\n"))
    assert calibration == Calibration(1000, 0.2, 300, 250, 30, (640, 480))  # the file has millimeters


def test_kitti_object_and_raw(tmp_path: Path) -> None:
    expected = Calibration(700, 0.54, 600, 170, 0)
    assert read_calibration(file(tmp_path, KITTI)) == expected
    raw = "calib_time: 09-Jan-2012 14:00:15\nS_rect_02: 1.242e+03 3.75e+02\n" + KITTI.replace("P", "P_rect_0")
    calibration = read_calibration(file(tmp_path, raw))
    assert calibration == Calibration(700, 0.54, 600, 170, 0, (1242, 375))


def test_kitti_gray_pair(tmp_path: Path) -> None:
    gray = KITTI.replace("P2", "P0").replace("P3", "P1")
    assert read_calibration(file(tmp_path, gray)) == read_calibration(file(tmp_path, KITTI))
    color_wins = gray.replace("700", "500") + KITTI
    assert read_calibration(file(tmp_path, color_wins)).focal == 700


def test_opencv_q_is_that_of_stereo_rectify(tmp_path: Path) -> None:
    """From OpenCV's own calculation, for cameras with different principal points."""
    left, right = (camera(500, cx, 240)[:, :3] for cx in (320, 335))
    *_, q, _, _ = cv2.stereoRectify(
        left, np.zeros(5), right, np.zeros(5), (640, 480), np.eye(3), np.array([[-0.12], [0], [0]]), flags=0
    )
    calibration = read_calibration(opencv(tmp_path, Q=q))
    disparity = np.array([[10, 40]], np.float32)
    expected = cv2.reprojectImageTo3D(disparity, q)
    depth = calibration.depth(disparity)
    np.testing.assert_allclose(depth, expected[..., 2], rtol=1e-5)
    np.testing.assert_allclose(calibration.points(depth), expected, rtol=1e-4)
    assert calibration.baseline == pytest.approx(0.12)
    assert calibration.doffs != 0


@pytest.mark.parametrize(
    "matrices",
    [
        {"P1": camera(500, 320, 240), "P2": camera(500, 335, 240, -0.12)},
        {"K1": camera(500, 320, 240)[:, :3], "K2": camera(500, 335, 240)[:, :3], "T": [[-0.12], [0], [0]]},
        {"M1": camera(500, 320, 240)[:, :3], "M2": camera(500, 335, 240)[:, :3], "T": [[-0.12], [0], [0]]},
    ],
)
def test_opencv_matrices(tmp_path: Path, matrices: dict[str, object]) -> None:
    calibration = read_calibration(opencv(tmp_path, **matrices))
    assert tuple(calibration.values().values()) == (500, pytest.approx(0.12), 320, 240, 15, None)


def test_opencv_one_camera_matrix(tmp_path: Path) -> None:
    calibration = read_calibration(opencv(tmp_path, K=camera(500, 320, 240)[:, :3], T=[-0.12, 0, 0]))
    assert tuple(calibration.values().values()) == (500, pytest.approx(0.12), 320, 240, 0, None)


@pytest.mark.parametrize(("field", "option"), [("baseline", "baseline"), ("doffs", "doffs"), ("cam0", "focal")])
def test_middlebury_lacks_a_field(tmp_path: Path, field: str, option: str) -> None:
    lines = [line for line in MIDDLEBURY.splitlines() if not line.startswith((field, "cam1"))]
    path = file(tmp_path, "\n".join(lines))
    with pytest.raises(AnyNetError, match=rf"calib\.txt: the calibration lacks {field}: give --{option}"):
        read_calibration(path)
    assert getattr(read_calibration(path, replace={option: 7.5}), option) == 7.5


def test_middlebury_doffs_of_the_cameras(tmp_path: Path) -> None:
    assert read_calibration(file(tmp_path, MIDDLEBURY.replace("doffs=30\n", ""))).doffs == 30
    with pytest.warns(UserWarning, match="doffs is 20, but the cx of cam1 minus that of cam0 is 30"):
        read_calibration(file(tmp_path, MIDDLEBURY.replace("doffs=30", "doffs=20")))


@pytest.mark.parametrize(("text", "field"), [(KITTI.split("P3")[0], "P3"), ("P3" + KITTI.split("P3")[1], "P2")])
def test_kitti_lacks_a_field(tmp_path: Path, text: str, field: str) -> None:
    with pytest.raises(AnyNetError, match=rf"the calibration lacks {field}$"):
        read_calibration(file(tmp_path, text))


@pytest.mark.parametrize(
    ("matrices", "message"),
    [
        ({"P1": camera(500, 320, 240)}, "lacks P2"),
        ({"K": np.eye(3)}, "lacks T"),
        ({"T": np.zeros(3)}, "lacks Q, P1 and P2, or K and T .*; it has T"),
        ({"Q": np.eye(3)}, "expected Q to be a matrix of 4 x 4"),
        ({"Q": np.zeros((4, 4))}, "expected Q\\[3, 2\\]"),
    ],
)
def test_opencv_lacks_a_field(tmp_path: Path, matrices: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError, match=rf"calib\.yml: .*{message}"):
        read_calibration(opencv(tmp_path, **matrices))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a calibration of KITTI, Middlebury, .* give --focal and --baseline"),
        ("hello", "expected a calibration of KITTI, Middlebury, .* give --focal and --baseline"),
        (MIDDLEBURY.replace("200", "wide"), "expected baseline to be 1 numbers, got 'wide'"),
        (
            MIDDLEBURY.replace("0 1000 250", "0 900 250"),
            "expected square pixels of cam0, got focal lengths 1000 and 900",
        ),
        (MIDDLEBURY.replace("200", "-200"), "expected baseline > 0"),
        (KITTI.replace("600 35 0", "600 35"), "expected P2 to be 12 numbers, got 11"),
        ("%YAML:1.0\n---\n[broken: {", "damaged YAML in line 3"),
    ],
)
def test_damaged_files(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(AnyNetError, match=rf"calib\.txt: .*{message}"):
        read_calibration(file(tmp_path, text))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"cannot read .*: File name too long"):
        read_calibration("x" * 300)
    with pytest.raises(AnyNetError, match=r"cannot read .*: No such file"):
        read_calibration(tmp_path / "calib.txt")


def test_a_baseline_by_an_option_is_in_meters(tmp_path: Path) -> None:
    path = file(tmp_path, MIDDLEBURY)
    with pytest.warns(UserWarning, match=r"a baseline of 193 m is long: --baseline is in meters$"):
        read_calibration(path, replace={"baseline": 193})
    with pytest.warns(UserWarning, match=r"a baseline of 200 m is long: .* Say it with --calib-unit mm"):
        read_calibration(path, unit="m")


@needs_shared
def test_real_files() -> None:
    middlebury = read_calibration(SHARED / "middlebury2014Q/Motorcycle/calib.txt")
    assert middlebury == Calibration(999.421, 0.193001, 294.182, 252.932, 32.778, (741, 497))
    eth3d = read_calibration(SHARED / "eth3d/playground/calib.txt")
    assert eth3d.baseline == pytest.approx(0.0595549)
    raw = read_calibration(SHARED / "kitti2015/training/calib_cam_to_cam/000002.txt")
    assert raw.size == (1242, 375)
    assert raw.baseline == pytest.approx(0.54, abs=0.01)


@needs_shared
def test_kitti_object_depth() -> None:
    """Where disparity comes from depth, depth must come from disparity."""
    calibration = read_calibration(SHARED / "kitti_object/calib/000001.txt")
    depth = read_disparity(SHARED / "kitti_object/gt_depth_map/000001.png")  # the same format, in meters
    disparity = 721.5377 * (44.85728 + 339.5242) / 721.5377 / depth
    np.testing.assert_allclose(calibration.depth(disparity.astype(np.float32)), depth, rtol=1e-5)


def test_projections_that_are_none(tmp_path: Path) -> None:
    """A name with P_rect that is no camera's hides the others."""
    with pytest.raises(AnyNetError, match=r"calib.*lacks P_rect_0"):
        read_calibration(file(tmp_path, KITTI + "P_rect_x: 721.5377 0 609\n"))


def test_depth_of_other_sizes_and_of_what_is_unknown() -> None:
    calibration = Calibration(focal=1000, baseline=0.1, size=(4, 2))
    disparity = np.array([[10, np.inf, -np.inf, np.nan], [0, -1, 20, 40]], np.float32)
    nan = np.nan
    depth = calibration.depth(disparity)
    np.testing.assert_allclose(depth, [[10, nan, nan, nan], [nan, nan, 5, 2.5]])
    np.testing.assert_allclose(calibration.depth(disparity[1, 2:]), [5, 2.5])  # single pixels
    listed = json.loads(json.dumps(calibration.values()))
    assert Calibration(**listed).depth(disparity).shape == (2, 4)
    for compute in (calibration.depth, calibration.points):
        with pytest.raises(AnyNetError, match="expected images of 4 x 2 as the calibration says, got 2 x 1"):
            compute(disparity[::2, ::2])
