"""Every format of docs/calibration.md: its fields, its unit, and what is said where they are missing."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from anynet.camera import Calibration, PairPreparation, StereoRig, read_calibration
from anynet.camera.formats import FORMATS
from anynet.cli.calibration import CameraOptions
from anynet.errors import AnyNetError

DOCS = Path(__file__).parents[3] / "docs" / "calibration.md"


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text(text)
    return path


def read_rig(*paths: Path, **options: object) -> StereoRig:
    rig = read_calibration(paths, **options)
    assert isinstance(rig, StereoRig)
    return rig


def read(*paths: Path, **options: object) -> Calibration:
    calibration = read_calibration(paths, **options)
    assert isinstance(calibration, Calibration)
    return calibration


def test_every_format_is_documented() -> None:
    table = DOCS.read_text()
    for entry in FORMATS:
        assert f"| {entry.name} |" in table, entry.name


def matrix(name: str, values: object) -> str:
    array = np.asarray(values, float)
    rows, columns = array.shape
    data = ", ".join(map(str, array.ravel()))
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [{data}]\n"


K1 = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
ROWS = [[0, 400, 240, 0], [0, 0, 1, 0]]
K2 = [[510, 0, 330], [0, 510, 235], [0, 0, 1]]
R = cv2.Rodrigues(np.array([0.01, 0.02, -0.01]))[0]
T = [[-0.12], [0.001], [0.002]]
D = [[-0.2, 0.05, 0.001, -0.001, 0.0]]


@pytest.mark.parametrize(
    "names",
    [
        ("K1", "D1", "K2", "D2", "R", "T"),
        ("M1", "D1", "M2", "D2", "R", "T"),
        ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
        (
            "camera_matrix_left",
            "dist_coeffs_left",
            "camera_matrix_right",
            "dist_coeffs_right",
            "rotation",
            "translation",
        ),
        ("left_K", "left_D", "right_K", "right_D", "stereo_R", "stereo_T"),
        ("cameraMatrixL", "distCoeffsL", "cameraMatrixR", "distCoeffsR", "Rot", "Trans"),
        ("mtxL", "distL", "mtxR", "distR", "R", "T"),
        ("intrinsic0", "distortion0", "intrinsic1", "distortion1", "rotation_matrix", "translation_vector"),
    ],
)
def test_raw_cameras_by_opencv_in_many_names(tmp_path: Path, names: tuple[str, ...]) -> None:
    text = "%YAML:1.0\n---\n" + "".join(map(matrix, names, [K1, D, K2, D, R, T]))
    rig = read_rig(write(tmp_path, "rig.yml", text))
    np.testing.assert_allclose(rig.left.matrix, K1)
    np.testing.assert_allclose(rig.right.matrix, K2)
    np.testing.assert_allclose(rig.left.distortion, D[0])
    np.testing.assert_allclose(rig.rotation, R, atol=1e-9)
    np.testing.assert_allclose(rig.translation, np.ravel(T))


def test_intrinsics_and_extrinsics_in_two_files_or_a_folder(tmp_path: Path) -> None:
    header = "%YAML:1.0\n---\n"
    first = write(
        tmp_path / "c", "intrinsics.yml", header + "".join(map(matrix, ["M1", "D1", "M2", "D2"], [K1, D, K2, D]))
    )
    second = write(tmp_path / "c", "extrinsics.yml", header + matrix("R", R) + matrix("T", T))
    assert read_rig(first, second).baseline == pytest.approx(0.12, abs=1e-4)
    assert read_rig(tmp_path / "c").baseline == pytest.approx(0.12, abs=1e-4)
    with pytest.raises(AnyNetError, match=r"unrectified cameras .* lacks R and T; give the file that has them"):
        read_calibration(first)


def test_left_and_right_as_maps_and_lists_in_json(tmp_path: Path) -> None:
    rig = {"left": {"K": K1, "D": D}, "right": {"K": K2, "D": D}, "stereo": {"R": R.tolist(), "T": [-120, 1, 2]}}
    rig["image_size"] = {"width": 640, "height": 480}  # type: ignore[assignment]
    path = write(tmp_path, "rig.json", json.dumps(rig))
    found = read_rig(path, unit="mm")
    assert (found.size, found.baseline) == ((640, 480), pytest.approx(0.12, abs=1e-4))


def test_a_file_that_tells_its_unit(tmp_path: Path) -> None:
    rig = {"unit": "mm", "K1": K1, "K2": K1, "T": [-120, 0, 0]}
    assert read(write(tmp_path, "rig.json", json.dumps(rig))).baseline == pytest.approx(0.12)

    assert read(write(tmp_path, "rig.json", json.dumps({**rig, "unit": "feet"}))).baseline == pytest.approx(36.576)
    other = write(tmp_path, "rig.json", json.dumps({**rig, "unit": "cubits"}))
    with pytest.raises(AnyNetError, match=r"expected a unit of m, dm, cm, .*, got 'cubit'"):
        read(other)
    assert read(other, unit="mm").baseline == pytest.approx(0.12)


@pytest.mark.parametrize("flow", [None, False, True])
@pytest.mark.parametrize("first", ["D1", "K1", "P1", "T", "unit"])
def test_yaml_by_any_program(tmp_path: Path, first: str, flow: bool | None) -> None:
    """Without a header, matrices as lists, in any order, over lines or in braces: nothing of it is lost."""
    rig = {"K1": K1, "K2": K1, "D1": [0.1, 0, 0, 0], "D2": [0.1, 0, 0, 0], "R": np.eye(3).tolist(), "T": [-12.0, 0, 0]}
    rig |= {"unit": "cm", "model": "fisheye", "image_size": [640, 480]}
    if first == "P1":
        rig |= {"P1": [[400, 0, 300, 0], *ROWS], "P2": [[400, 0, 300, -4800], *ROWS]}
    text = yaml.safe_dump({first: rig.pop(first), **rig}, default_flow_style=flow, sort_keys=False)
    found = read_calibration(write(tmp_path, "rig.yaml", text))
    assert found.baseline == pytest.approx(0.12)
    assert found.size == (640, 480)
    raw = found.rig if isinstance(found, Calibration) else found
    assert raw is not None
    assert raw.left.model == "fisheye"


def test_four_coefficients_of_no_model_are_told(tmp_path: Path) -> None:
    rig = {"K1": K1, "K2": K1, "R": np.eye(3).tolist(), "T": [-0.1, 0, 0], "width": 640, "height": 480}
    four, five = [0.1, 0.2, 0.01, 0.02], [0.1, 0.2, 0.01, 0.02, 0.3]
    path = write(tmp_path, "rig.json", json.dumps({**rig, "D1": four, "D2": four}))
    with pytest.warns(UserWarning, match="4 distortion coefficients are taken as k1, k2, p1, p2 of a pinhole camera"):
        assert read_rig(path).left.model == "pinhole"
    for more in ({"D1": five, "D2": five}, {"D1": four, "D2": four, "model": "pinhole"}):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read_rig(write(tmp_path, "rig.json", json.dumps({**rig, **more})))


def middlebury(tmp_path: Path, focal: float, cy: float) -> Path:
    cameras = "cam0=[1000 0 300; 0 1000 200; 0 0 1]\ncam1=[{0} 0 320; 0 {0} {1}; 0 0 1]\nbaseline=100\n"
    return write(tmp_path, "calib.txt", cameras.format(focal, cy))


def realsense(tmp_path: Path, focal: float, cy: float) -> Path:
    left = {"fx": 1000.0, "fy": 1000.0, "ppx": 300.0, "ppy": 200.0}
    right = {"fx": focal, "fy": focal, "ppx": 320.0, "ppy": cy}
    return write(tmp_path, "rs.json", json.dumps({"infrared1": left, "infrared2": right, "baseline": 100}))


def opencv(tmp_path: Path, focal: float, cy: float) -> Path:
    right = [[focal, 0, 320], [0, focal, cy], [0, 0, 1]]
    return write(tmp_path, "rig.json", json.dumps({"K1": [[1000, 0, 300], [0, 1000, 200], [0, 0, 1]], "K2": right}))


@pytest.mark.parametrize("written", [middlebury, realsense, opencv])
def test_rectified_cameras_that_disagree(tmp_path: Path, written: Callable[[Path, float, float], Path]) -> None:
    assert read_calibration(written(tmp_path, 1000, 200), replace={"baseline": 0.1}).doffs == 20
    with pytest.raises(AnyNetError, match="expected one focal length of both rectified cameras, got 1000 and 1200"):
        read_calibration(written(tmp_path, 1200, 200), replace={"baseline": 0.1})
    with pytest.warns(UserWarning, match="the two cameras' rows do not agree: cy is 200 and 220"):
        read_calibration(written(tmp_path, 1000, 220), replace={"baseline": 0.1})


def test_fisheye_by_its_name(tmp_path: Path) -> None:
    rig = {"model": "fisheye", "K1": K1, "K2": K1, "D1": [0.1, 0, 0, 0], "D2": [0.1, 0, 0, 0], "R": np.eye(3).tolist()}
    found = read_rig(write(tmp_path, "rig.json", json.dumps({**rig, "T": [-0.1, 0, 0], "width": 640, "height": 480})))
    assert found.left.model == "fisheye"
    assert found.rectify().calibration.baseline == pytest.approx(0.1)


def test_simple_stereo(tmp_path: Path) -> None:
    rig = {
        "res1": [640, 480], "res2": [640, 480], "intrinsic1": K1, "intrinsic2": K2, "distCoeffs1": D, "distCoeffs2": D,
        "R": R.tolist(), "T": T, "F": np.eye(3).tolist(), "E": np.eye(3).tolist(), "reprojectionError": 0.2,
    }  # fmt: skip
    found = read_rig(write(tmp_path, "rig.json", json.dumps(rig)))
    assert (found.size, found.baseline) == ((640, 480), pytest.approx(0.12, abs=1e-4))


@pytest.mark.parametrize(
    "size",
    [
        "image_size: [640, 480]",
        "imageSize: [640, 480]",
        "width: 640\nheight: 480",
        "image_width: 640\nimage_height: 480",
        "image_shape: [480, 640]",
        "resolution: {width: 640, height: 480}",
        "calibration: {frame_size: [640, 480]}",
    ],
)
def test_sizes(tmp_path: Path, size: str) -> None:
    text = "%YAML:1.0\n---\nboard_size: [9, 6]\n" + matrix("K", K1) + "T: [-0.1, 0, 0]\n" + size + "\n"
    assert read(write(tmp_path, "c.yml", text)).size == (640, 480)


ROS = """image_width: 640
image_height: 480
camera_name: {name}
camera_matrix: {{rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}}
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: {count}, data: [{distortion}]}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [480, 0, 325, {along}, 0, 480, 238, 0, 0, 0, 1, 0]}}
"""
MESSAGE = """header:
  stamp: {{sec: 1, nanosec: 2}}
  frame_id: camera
height: 480
width: 640
distortion_model: plumb_bob
{d}:
- -0.1
- 0.0
- 0.0
- 0.0
- 0.0
{k}: [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]
{r}: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
{p}: [480.0, 0.0, 325.0, {along}, 0.0, 480.0, 238.0, 0.0, 0.0, 0.0, 1.0, 0.0]
---
"""


@pytest.mark.parametrize("kind", ["file", "ros1", "ros2"])
def test_ros(tmp_path: Path, kind: str) -> None:
    paths = []
    for name, along in (("left", 0.0), ("right", -48.0)):
        if kind == "file":
            text = ROS.format(name=name, along=along, model="plumb_bob", count=5, distortion="-0.1, 0, 0, 0, 0")
        else:
            letters = "dkrp" if kind == "ros2" else "DKRP"
            text = MESSAGE.format(along=along, **dict(zip("dkrp", letters, strict=True)))
        paths.append(write(tmp_path / "c", f"{name}.yaml", text))
    expected = Calibration(480, 0.1, 325, 238, 0, (640, 480))
    assert read(*paths) == read(*reversed(paths)) == read(tmp_path / "c") == expected
    rig = read(*paths).rig
    assert rig is not None
    assert rig.translation == pytest.approx([-0.1, 0, 0])
    assert read(paths[0], replace={"baseline": 0.1}) == expected
    with pytest.raises(AnyNetError, match=r"lacks the right camera's camera_info .* give --baseline"):
        read(paths[0])
    with pytest.raises(AnyNetError, match="of the right camera alone"):
        read(paths[1])
    with pytest.raises(AnyNetError, match="was each camera calibrated alone"):
        read(paths[0], paths[0])


def test_ros_models(tmp_path: Path) -> None:
    for model, distortion, kind in (
        ("equidistant", "0.1, 0, 0, 0", "fisheye"),
        ("rational_polynomial", "0.1, 0, 0, 0, 0, 0, 0, 0", "pinhole"),
    ):
        count = distortion.count(",") + 1
        texts = [ROS.format(name="", along=x, model=model, count=count, distortion=distortion) for x in (0, -48)]
        paths = [write(tmp_path, f"{number}.yaml", text) for number, text in enumerate(texts)]
        rig = read(*paths).rig
        assert rig is not None
        assert (rig.left.model, rig.left.distortion.size) == (kind, distortion.count(",") + 1)
    with pytest.raises(AnyNetError, match="expected cameras of the models"):
        read(write(tmp_path, "x.yaml", ROS.format(name="x", along=0, model="omni", count=1, distortion="1")))


KALIBR = """cam0:
  camera_model: {model}
  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]
  distortion_model: {distortion}
  intrinsics: [455.1, 454.3, 366.0, 247.7]
  resolution: [752, 480]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: {model}
  distortion_coeffs: [-0.28, 0.07, -0.0001, 0.00003]
  distortion_model: {distortion}
  intrinsics: [454.6, 453.4, 378.9, 254.9]
  resolution: [752, 480]
"""


def test_kalibr(tmp_path: Path) -> None:
    rig = read_rig(write(tmp_path, "camchain.yaml", KALIBR.format(model="pinhole", distortion="radtan")))
    assert (rig.size, rig.left.model, rig.baseline) == ((752, 480), "pinhole", pytest.approx(0.11))
    rig = read_rig(write(tmp_path, "camchain.yaml", KALIBR.format(model="pinhole", distortion="equidistant")))
    assert rig.left.model == "fisheye"
    with pytest.raises(AnyNetError, match="expected cameras of the models"):
        read_rig(write(tmp_path, "camchain.yaml", KALIBR.format(model="ds", distortion="none")))
    alone = KALIBR.split("cam1:")[0].format(model="pinhole", distortion="radtan")
    with pytest.raises(AnyNetError, match="the calibration lacks cam1"):
        read_rig(write(tmp_path, "camchain.yaml", alone))


EUROC = """sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, {x}, 0.0, 1.0, 0.0, 0.02, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.76e-05]
"""


def test_euroc(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"cam{i}", "sensor.yaml", EUROC.format(x=x)) for i, x in enumerate((0.05, 0.16))]
    for rig in (read_rig(*paths), read_rig(tmp_path)):
        assert rig.translation == pytest.approx([-0.11, 0, 0])
    with pytest.raises(AnyNetError, match="of one raw camera"):
        read_calibration(paths[0])
    with pytest.warns(UserWarning, match="camera 1 of the calibration is the right one"):
        assert read_rig(*reversed(paths)).translation == pytest.approx([-0.11, 0, 0])


def test_orb_slam2_with_its_own_rectification(tmp_path: Path) -> None:
    text = "%YAML:1.0\nCamera.fx: 435.2\nCamera.fy: 435.2\nCamera.cx: 367.4\nCamera.cy: 252.2\nCamera.bf: 47.9\n"
    for side, along in (("LEFT", 0.0), ("RIGHT", -47.9)):
        text += f"{side}.height: 480\n{side}.width: 752\n" + matrix(f"{side}.D", D) + matrix(f"{side}.K", K1)
        text += matrix(f"{side}.R", np.eye(3)) + matrix(
            f"{side}.P", [[435.2, 0, 367.4, along], [0, 435.2, 252.2, 0], [0, 0, 1, 0]]
        )
    path = write(tmp_path, "EuRoC.yaml", text.replace("data: [", "data:["))  # as in the original
    rig = read_rig(path)
    assert (rig.size, rig.baseline) == ((752, 480), pytest.approx(47.9 / 435.2))
    for baseline, other in ((47.9 / 435.2, rig), (0.2, read_calibration(path, replace={"baseline": 0.2}))):
        rectified = Calibration(435.2, baseline, 367.4, 252.2, 0, (752, 480))
        assert (other.rectified, other.baseline) == (rectified, pytest.approx(baseline))


def test_orb_slam3(tmp_path: Path) -> None:
    text = '%YAML:1.0\nCamera.type: "{type}"\nCamera.width: 752\nCamera.height: 480\n'
    for camera in ("Camera1", "Camera2"):
        text += "".join(f"{camera}.{k}: {v}\n" for k, v in {"fx": 458.6, "fy": 457.2, "cx": 367.2, "cy": 248.3}.items())
        text += "".join(f"{camera}.{k}: 0.01\n" for k in ("k1", "k2", "p1", "p2", "k3", "k4"))
    pose = np.eye(4)
    pose[0, 3] = 0.11
    text += matrix("Stereo.T_c1_c2", pose)
    rig = read_rig(write(tmp_path, "a.yaml", text.format(type="PinHole")))
    assert (rig.size, rig.left.model) == ((752, 480), "pinhole")
    assert rig.translation == pytest.approx([-0.11, 0, 0])
    assert read_rig(write(tmp_path, "a.yaml", text.format(type="KannalaBrandt8"))).left.model == "fisheye"
    one = "%YAML:1.0\nCamera.type: PinHole\nCamera1.fx: 700\nCamera1.fy: 700\nCamera1.cx: 600\nCamera1.cy: 180\n"
    assert read(write(tmp_path, "b.yaml", one + "Stereo.b: 0.54\n")) == Calibration(700, 0.54, 600, 180)
    with pytest.raises(AnyNetError, match=r"lacks Camera\.bf or Stereo\.b: give --baseline"):
        read(write(tmp_path, "b.yaml", one))
    with pytest.raises(AnyNetError, match="of unrectified cameras"):
        read(write(tmp_path, "b.yaml", one + "Camera1.k1: -0.3\nStereo.b: 0.54\n"))


PINHOLE = """%YAML:1.0
---
model_type: PINHOLE
camera_name: {name}
image_width: 752
image_height: 480
distortion_parameters:
   k1: -0.29
   k2: 0.08
   p1: 0.0
   p2: 0.0
projection_parameters:
   fx: 461.1
   fy: 459.7
   cx: 362.6
   cy: 248.5
"""
KANNALA = """%YAML:1.0
---
model_type: KANNALA_BRANDT
camera_name: {name}
image_width: 752
image_height: 480
projection_parameters:
   k2: 0.01
   k3: 0.0
   k4: 0.0
   k5: 0.0
   mu: 461.1
   mv: 459.7
   u0: 362.6
   v0: 248.5
"""


@pytest.mark.parametrize(("text", "model"), [(PINHOLE, "pinhole"), (KANNALA, "fisheye")])
def test_vins(tmp_path: Path, text: str, model: str) -> None:
    cameras = [write(tmp_path, f"cam{i}.yaml", text.format(name=f"cam{i}")) for i in (0, 1)]
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = 0.11
    body = "%YAML:1.0\n---\ncam0_calib: cam0.yaml\ncam1_calib: cam1.yaml\n"
    body += "".join(matrix(f"body_T_cam{i}", pose) for i, pose in enumerate(poses))
    config = write(tmp_path, "stereo.yaml", body)
    for rig in (read_rig(*cameras, config), read_rig(config), read_rig(tmp_path)):
        assert (rig.size, rig.left.model) == ((752, 480), model)
        assert rig.translation == pytest.approx([-0.11, 0, 0])
    with pytest.raises(AnyNetError, match=r"of unrectified cameras .* body_T_cam0 and body_T_cam1"):
        read_calibration(cameras)
    # Named, they are in the settings' order, whatever that of the options or of the folder.
    cameras[1].write_text(text.format(name="cam1").replace("461.1", "500.1"))
    config.write_text(
        body.replace("cam0.yaml", "second").replace("cam1.yaml", "cam0.yaml").replace("second", "cam1.yaml")
    )
    for rig in (read_rig(*cameras, config), read_rig(config), read_rig(tmp_path)):
        assert (rig.left.matrix[0, 0], rig.right.matrix[0, 0]) == (500.1, 461.1)
    other = write(tmp_path, "other.yaml", text.format(name="other"))
    with pytest.raises(
        AnyNetError, match=r"expected the cameras cam1.yaml and cam0.yaml that .*, got cam1.yaml and other.yaml"
    ):
        read_calibration([cameras[1], other, config])


def test_vins_with_cameras_elsewhere_and_renamed(tmp_path: Path) -> None:
    texts = [PINHOLE.format(name="cam").replace("461.1", focal) for focal in ("460", "500")]
    inner = [write(tmp_path / f"cam{i}", "calib.yaml", text) for i, text in enumerate(texts)]
    renamed = [write(tmp_path, f"{side}.yaml", text) for side, text in zip(("left", "right"), texts, strict=True)]
    body = "%YAML:1.0\n---\ncam0_calib: ./cam0/calib.yaml\ncam1_calib: cam1/calib.yaml\n"
    for i, x in enumerate((0, 0.11)):
        body += matrix(f"body_T_cam{i}", [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    config = write(tmp_path, "vins.yaml", body)
    for order in ([0, 1], [1, 0]):
        rig = read_rig(*(inner[i] for i in order), config)
        assert (rig.left.matrix[0, 0], rig.right.matrix[0, 0]) == (460, 500)
    away = tmp_path / "away"  # where the names of the files do not tell them apart
    away.mkdir()
    with pytest.warns(UserWarning, match=r"expected the cameras .* that the settings name, got .*: the first is"):
        rig = read_rig(*inner, write(away, "vins.yaml", body))
    assert (rig.left.matrix[0, 0], rig.right.matrix[0, 0]) == (460, 500)
    body = body.replace("./cam0/calib", "cam0").replace("cam1/calib", "cam1")
    for text, cameras in ((body, renamed), (body.replace("_calib: cam", "_calib: /other/cam"), inner)):
        config.write_text(text)
        with pytest.warns(UserWarning, match=r"expected the cameras .* that the settings name, got .*: the first is"):
            rig = read_rig(*cameras, config)
        assert (rig.left.matrix[0, 0], rig.right.matrix[0, 0]) == (460, 500)


def test_zed(tmp_path: Path) -> None:
    text = ""
    for side in ("LEFT", "RIGHT"):
        for name, focal in (("HD", 700.0), ("VGA", 350.0)):
            text += (
                f"[{side}_CAM_{name}]\nfx={focal}\nfy={focal}\ncx={focal * 0.9}\ncy={focal / 2}\nk1=-0.17\nk2=0.02\n"
            )
    text += "[STEREO]\nBaseline=119.9\nTY=0.1\nTZ=0.2\n"
    text += "".join(f"CV_{name}=0.02\nRX_{name}=-0.003\nRZ_{name}=-0.001\n" for name in ("HD", "VGA"))
    path = write(tmp_path, "SN1234.conf", text)
    rig = read_rig(path, size=(672, 376))
    assert (rig.size, rig.left.matrix[0, 0]) == ((672, 376), 350)
    np.testing.assert_allclose(rig.translation, [-0.1199, -0.0001, -0.0002], atol=1e-9)
    np.testing.assert_allclose(cv2.Rodrigues(rig.rotation)[0].ravel(), [-0.003, 0.02, -0.001], atol=1e-9)
    with pytest.raises(AnyNetError, match=r"sizes HD \(1280 x 720\), VGA \(672 x 376\), got 640 x 480"):
        read_rig(path, size=(640, 480))


@pytest.mark.parametrize(
    ("line", "instead", "lacking"),
    [
        ("TY=0.1\nTZ=0.2\nCV_HD=0.02\nRX_HD=-0.003\nRZ_HD=-0.001\n", "", "RX_HD of STEREO"),
        ("CV_HD", "CV_2K", "CV_HD of STEREO"),
        ("RZ_HD=-0.001\n", "", "RZ_HD of STEREO"),
        ("cy=351\nk1=-0.17\nk2=0.02\n", "cy=351\n", "k1 of RIGHT_CAM_HD"),
        ("cy=350\nk1=-0.17\nk2=0.02\n", "cy=350\n[LEFT_DISTO]\nk1=-0.17\n", "k2 of LEFT_DISTO"),
    ],
)
def test_zed_cut_off(tmp_path: Path, line: str, instead: str, lacking: str) -> None:
    text = "[STEREO]\nBaseline=119.9\nTY=0.1\nTZ=0.2\nCV_HD=0.02\nRX_HD=-0.003\nRZ_HD=-0.001\n"
    for side, cy in (("LEFT", 350), ("RIGHT", 351)):
        text += f"[{side}_CAM_HD]\nfx=700\nfy=700\ncx=630\ncy={cy}\nk1=-0.17\nk2=0.02\n"
    assert line in text
    with pytest.raises(AnyNetError, match=f"the calibration lacks {lacking}"):
        read_rig(write(tmp_path, "SN1234.conf", text.replace(line, instead)))
    shared = text.replace("k1=-0.17\nk2=0.02\n", "") + "".join(
        f"[{side}_DISTO]\nk1=-0.17\nk2=0.02\n" for side in ("LEFT", "RIGHT")
    )
    unnamed = text.replace("_HD=", "=").replace("TY=0.1\nTZ=0.2\n", "")
    for whole in (text, shared, unnamed):
        rig = read_rig(write(tmp_path, "SN1234.conf", whole))
        np.testing.assert_allclose(rig.right.distortion, [-0.17, 0.02, 0, 0, 0])
        np.testing.assert_allclose(cv2.Rodrigues(rig.rotation)[0].ravel(), [-0.003, 0.02, -0.001], atol=1e-9)


def depthai(**changes: object) -> str:
    def camera(x: float, target: int) -> dict[str, object]:
        return {
            "cameraType": 0, "width": 1280, "height": 800, "intrinsicMatrix": [[800, 0, 640], [0, 800, 400], [0, 0, 1]],
            "distortionCoeff": [0.1] + [0.0] * 13,
            "extrinsics": {
                "rotationMatrix": np.eye(3).tolist(), "translation": {"x": x, "y": 0, "z": 0}, "toCameraSocket": target,
            },
        }  # fmt: skip

    # The left camera leads to the right one, that to the color camera in the middle.
    cameras = [[0, camera(0, -1)], [1, camera(-7.5, 2)], [2, camera(3.75, 0)]]
    stereo = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    return json.dumps({"boardName": "OAK-D", "cameraData": cameras, "stereoRectificationData": stereo, **changes})


def test_depthai(tmp_path: Path) -> None:
    rig = read_rig(write(tmp_path, "oak.json", depthai()))
    assert (rig.size, rig.left.distortion.size) == ((1280, 800), 14)
    np.testing.assert_allclose(rig.translation, [-0.075, 0, 0], atol=1e-12)
    first = read_rig(write(tmp_path, "oak.json", depthai(stereoRectificationData={"leftCameraSocket": 0})))
    np.testing.assert_allclose(first.translation, [-0.0375, 0, 0], atol=1e-12)
    for sockets in ((-1, -1), (0, -1), (float("nan"), 2), (1, float("inf")), (None, None)):  # -1: the device's choice
        stereo = dict(zip(("leftCameraSocket", "rightCameraSocket"), sockets, strict=True))
        usual = read_rig(write(tmp_path, "oak.json", depthai(stereoRectificationData=stereo)))
        np.testing.assert_allclose(usual.translation, [-0.075, 0, 0], atol=1e-12)
    with pytest.raises(AnyNetError, match="lacks the camera on socket 7"):
        read_rig(write(tmp_path, "oak.json", depthai(stereoRectificationData={"leftCameraSocket": 7})))


def depthai_chain(**steps: tuple[float, int]) -> str:
    """`_1=(x, target)`: socket 1's extrinsics; the other cameras lead nowhere."""
    tree = json.loads(depthai())
    for socket, camera in tree["cameraData"]:
        x, target = steps.get(f"_{socket}", (0, -1))
        camera["extrinsics"] |= {"translation": {"x": x, "y": 0, "z": 0}, "toCameraSocket": target}
    return json.dumps(tree)


@pytest.mark.parametrize(
    "steps",
    [
        {"_1": (-7.5, 2), "_2": (7.5, 1)},
        {"_1": (-7.5, 2)},
        {"_2": (7.5, 1)},
        {"_1": (-3.75, 0), "_2": (3.75, 0)},
        {"_1": (-3.75, 0), "_2": (3.75, 0), "_0": (3.75, 1)},
        {"_1": (-3.75, 3), "_2": (3.75, 3)},
    ],
)
def test_depthai_chains_that_meet(tmp_path: Path, steps: dict[str, tuple[float, int]]) -> None:
    rig = read_rig(write(tmp_path, "oak.json", depthai_chain(**steps)))
    np.testing.assert_allclose(rig.translation, [-0.075, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ({"_1": (-7.5, 0)}, "chains that do not meet: 1 to 0 and 2$"),
        ({"_1": (-3.75, 0), "_2": (3.75, 3)}, "chains that do not meet: 1 to 0 and 2 to 3$"),
        ({}, "chains that do not meet: 1 and 2$"),
        ({"_1": (-7.5, 2), "_2": (5, 1)}, "in a circle that tell two, (7.5 and 5|5 and 7.5) away"),
        ({"_1": (-7.5, 2), "_2": (-7.5, 1)}, "in a circle that tell two, 7.5 and 7.5 away"),
    ],
)
def test_depthai_chains_that_do_not(tmp_path: Path, steps: dict[str, tuple[float, int]], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        read_rig(write(tmp_path, "oak.json", depthai_chain(**steps)))


def test_depthai_models(tmp_path: Path) -> None:
    def kind(told: object) -> Path:
        return write(tmp_path, "oak.json", depthai().replace('"cameraType": 0', f'"cameraType": {json.dumps(told)}'))

    for told, model in ((0, "pinhole"), ("Perspective", "pinhole"), ("", "pinhole"), (None, "pinhole"),
                        (1, "fisheye"), ("Fisheye", "fisheye")):  # fmt: skip
        assert read_rig(kind(told)).left.model == model
    for other in (2, 3, "Equirectangular", "RadialDivision", [1]):
        with pytest.raises(AnyNetError, match=r"expected cameras of the models .*, got cameraType .* on socket 1:"):
            read_rig(kind(other))


def test_realsense(tmp_path: Path) -> None:
    intrinsics = {"width": 848, "height": 480, "fx": 420.0, "fy": 420.0, "ppx": 422.0, "ppy": 240.0, "coeffs": [0] * 5}
    device: dict[str, object] = {"infrared1": intrinsics, "infrared2": {**intrinsics, "ppx": 423.0}}
    device["color"] = {**intrinsics, "fx": 600.0}
    expected = Calibration(420, 0.05, 422, 240, 1, (848, 480))
    extrinsics = {"rotation": np.eye(3).ravel().tolist(), "translation": [-0.05, 0, 0]}
    for more in ({"extrinsics": extrinsics}, {"baseline": 50.0}, {"baseline_m": 0.05}):
        assert read(write(tmp_path, "rs.json", json.dumps({**device, **more}))) == expected
    with pytest.raises(AnyNetError, match=r"lacks extrinsics \(translation\) or baseline: give --baseline"):
        read(write(tmp_path, "rs.json", json.dumps(device)))
    others = {
        "infra1_to_accel": {"translation": [-0.0055, 0.016, 0.0117]},
        "depth_to_infra1": {"translation": [0, 0, 0]},
    }
    places = {**others, "infrared1_to_infrared2": extrinsics, "baseline_uncertainty": 0.001}
    assert read(write(tmp_path, "rs.json", json.dumps({**device, "extrinsics": places}))) == expected
    places = {"a": extrinsics, "b": {"translation": [-0.09, 0, 0]}}
    path = write(tmp_path, "rs.json", json.dumps({**device, "extrinsics": places}))
    with pytest.raises(
        AnyNetError,
        match=r"lacks one place of the right infrared camera \(it has .*a.* 0\.05, .* 0\.09\): give --baseline",
    ):
        read(path)
    assert read(path, replace={"baseline": 0.05}) == expected
    device["infrared2"] = {**intrinsics, "width": 1280, "height": 720}
    with pytest.raises(AnyNetError, match=r"one width and height of both cameras, got \(848, 480\) and \(1280, 720\)"):
        read(write(tmp_path, "rs.json", json.dumps(device)))
    device["infrared2"] = {**intrinsics, "coeffs": [0.1, 0, 0, 0, 0]}
    with pytest.warns(UserWarning, match="the right camera has distortion"):
        read(write(tmp_path, "rs.json", json.dumps({**device, "baseline": 50.0})))


@pytest.mark.parametrize(
    "name",
    ["Stereo Baseline", "baseline_in_mm", "baselineInMm", "baseline [mm]", "depth_baseline", "infra_baseline",
     "ir_stereo_baseline", "left_right_baseline", "baseline_cm"],
)  # fmt: skip
def test_realsense_with_names_of_the_baseline(tmp_path: Path, name: str) -> None:
    camera = {"fx": 420.0, "fy": 420.0, "ppx": 422.0, "ppy": 240.0}
    told = {name: 5 if "cm" in name else 50, "baseline_uncertainty": 0.4, "baselineError": 1, "baseline_unit": "mm"}
    told |= {"baseline_date": "2024-01-02", "baseline_vector": [0.05, 0, 0], "baseline_id": 7, "baseline_in": 2}
    device = {"infra1": camera, "infra2": camera, **told, "color_baseline": 15}
    assert read(write(tmp_path, "rs.json", json.dumps(device))).baseline == pytest.approx(0.05)


@pytest.mark.parametrize("other", ["RGBCamera", "rgbcam", "COLORCAM", "colorintrinsics"])
@pytest.mark.parametrize("sensor", ["IMUExtrinsics", "imuextrinsics", "IMUPose", "motionmodule", "infra1_to_RGBCamera"])
def test_realsense_with_other_cameras_and_sensors(tmp_path: Path, other: str, sensor: str) -> None:
    camera = {"fx": 420.0, "fy": 420.0, "ppx": 422.0, "ppy": 240.0}
    place, elsewhere = {"translation": [0.05, 0, 0]}, {"translation": [0.01, 0, 0]}
    pair = {other: {**camera, "fx": 600.0}, "left": camera, "right": camera, sensor: elsewhere}
    assert read(write(tmp_path, "rs.json", json.dumps({**pair, "extrinsics": place}))) == Calibration(
        420, 0.05, 422, 240
    )
    with pytest.raises(AnyNetError, match="lacks extrinsics"):
        read(write(tmp_path, "rs.json", json.dumps(pair)))


@pytest.mark.parametrize("outer", ["d455_with_imu", "color_and_depth", "rgbd", "right_arm"])
def test_realsense_within_the_map_of_a_device(tmp_path: Path, outer: str) -> None:
    camera = {"fx": 420.0, "fy": 420.0, "ppx": 422.0, "ppy": 240.0}
    place = {"translation": [0.05, 0, 0]}
    for right in ({**camera, "pose": place}, {**camera, "extrinsics": place}, {"intrinsics": camera, "pose": place}):
        pair = {"color": {**camera, "fx": 600.0}, "infra1": camera, "infra2": {**right, "ppx": 422.0}}
        motion = {"imu": {"extrinsics": {"translation": [0.01, 0, 0]}}, "pose": {"translation": [1, 2, 3]}}
        for device in ({outer: pair | motion}, pair | motion):
            assert read(write(tmp_path, "rs.json", json.dumps(device))) == Calibration(420, 0.05, 422, 240)


def test_opencv_with_the_pose_of_each_camera(tmp_path: Path) -> None:
    """R X + T of the world's X; what `stereoCalibrate` gives is the right one's seen from the left one."""
    turns = [cv2.Rodrigues(np.array(turn))[0] for turn in ([0.1, 0.2, 0.3], [0.1, 0.21, 0.3])]
    places = np.array([[-1.0, 0.1, 0.2], [-1.12, 0.1, 0.2]])

    def file(*names: str, **more: object) -> Path:
        cameras: dict[str, object] = {
            name: {"K": K1, "dist": D, "R": turn.tolist(), "t": place.tolist()}
            for name, turn, place in zip(names, turns, places, strict=True)
        }
        return write(tmp_path, "rig.json", json.dumps({**cameras, "image_size": [640, 480], **more}))

    for names in (("left", "right"), ("cam0", "cam1"), ("cam1", "cam2")):
        rig = read_rig(file(*names))
        np.testing.assert_allclose(rig.rotation, turns[1] @ turns[0].T, atol=1e-9)
        np.testing.assert_allclose(rig.translation, places[1] - rig.rotation @ places[0], atol=1e-9)
    alone = {"left": {"K": K1, "dist": D, "R": np.eye(3).tolist(), "t": [-0.5, 0, 0]}, "right": {"K": K1, "dist": D}}
    with pytest.raises(AnyNetError, match="expected t of both cameras, or once of the rig"):
        read_rig(write(tmp_path, "alone.json", json.dumps(alone)))


@pytest.mark.parametrize("names", [("left", "right"), ("cam0", "cam1"), ("camera0", "camera1"), ("0", "1"), ("L", "R")])
def test_opencv_with_one_pose_beside_or_in_the_cameras(tmp_path: Path, names: tuple[str, str]) -> None:
    """In the right camera's map, or outside of both, where theirs are what rectifies; or R outside, T inside."""
    camera, upright = {"K": K1, "dist": D}, {"R": np.eye(3).tolist()}
    pose = {"R": R.tolist(), "T": T}
    for first, second, more in (
        (camera, camera | pose, {}),
        (camera, camera | {"extrinsics": pose}, {}),
        (camera | upright, camera | upright, {"rotation": pose["R"], "translation": T}),
        (camera | upright, camera | upright, {"stereo": pose}),
        (camera | {"T": [0, 0, 0]}, camera | {"T": T}, {"rotation": pose["R"]}),
    ):
        rig = read_rig(write(tmp_path, "rig.json", json.dumps(dict(zip(names, (first, second), strict=True)) | more)))
        np.testing.assert_allclose(rig.rotation, R, atol=1e-9)
        np.testing.assert_allclose(rig.translation, np.ravel(T))
    rectified = {names[0]: {"K": K1}, names[1]: {"K": K1, "T": [-0.12, 0, 0]}}
    path = write(tmp_path, "rig.json", json.dumps(rectified))
    assert read(path).baseline == pytest.approx(0.12)
    assert read(path, replace={"baseline": 0.2}).baseline == 0.2


@pytest.mark.parametrize("other", ["imu", "lidar", "color", "base_link", "cam3", "world", "imu_extrinsics"])
@pytest.mark.parametrize("names", [("left", "right"), ("cam0", "cam1")])
def test_opencv_with_the_pose_of_another_sensor(tmp_path: Path, names: tuple[str, str], other: str) -> None:
    camera, upright = {"K": K1, "dist": D}, {"R": np.eye(3).tolist(), "T": [0, 0, 0]}
    pose = {"R": R.tolist(), "T": T}
    elsewhere = {other: {"R": np.eye(3).tolist(), "T": [0.3, 0, 1]}}
    for first, second, more in (
        (camera | upright, camera | pose, {}),
        (camera, camera | pose, {}),
        (camera, camera, pose),
        (camera, camera, {"stereo": pose}),
    ):
        cameras = dict(zip(names, (first, second), strict=True))
        for fields in ({**elsewhere, **cameras, **more}, {**cameras, **more, **elsewhere}):
            rig = read_rig(write(tmp_path, "rig.json", json.dumps(fields)))
            np.testing.assert_allclose(rig.rotation, R, atol=1e-9)
            np.testing.assert_allclose(rig.translation, np.ravel(T))


def test_opencv_with_three_cameras(tmp_path: Path) -> None:
    """The first two are the pair."""
    camera, upright = {"K": K1, "dist": D}, {"R": np.eye(3).tolist()}
    fields = {f"cam{i}": camera | upright | {"T": [-0.1 * i * (i + 1), 0, 0]} for i in range(3)}
    np.testing.assert_allclose(
        read_rig(write(tmp_path, "rig.json", json.dumps(fields))).translation, [-0.2, 0, 0], atol=1e-12
    )


@pytest.mark.parametrize("name", ["to_right", "right", "left_to_right"])
def test_opencv_with_the_pose_of_the_right_camera_below_the_left_one(tmp_path: Path, name: str) -> None:
    camera = {"K": K1, "dist": D}
    fields = {"left": camera | {name: {"R": R.tolist(), "T": T}}, "right": camera}
    rig = read_rig(write(tmp_path, "rig.json", json.dumps(fields)))
    np.testing.assert_allclose(rig.rotation, R, atol=1e-9)
    np.testing.assert_allclose(rig.translation, np.ravel(T))


RAW = {"K1": K1, "D1": D[0][:4], "K2": K1, "D2": D[0][:4], "R": np.eye(3).tolist(), "T": [-0.1, 0, 0]}
RECTIFIED = {"P1": [[480, 0, 325, 0], [0, 480, 238, 0], ROWS[1]], "P2": [[480, 0, 325, -48], [0, 480, 238, 0], ROWS[1]]}


@pytest.mark.parametrize(
    "more",
    [
        {"xi1": 1.2, "xi2": 1.2},
        {"xi_left": 1.2, "xi_right": 1.2},
        {"model": "pinhole", "xi": 1.2},
        {"left": {"xi": 1.2}, "right": {"xi": 1.2}},
        {"sensor": {"model": "OV9281"}, "right": {"model": "omnidir"}},
        *({name: "omnidirectional"} for name in ("model1", "left_model", "camera_model_left", "lensModel", "type")),
        *({name: "Omnidirectional camera"} for name in ("lens", "projection_model", "distortion_type")),
        *({"model": name} for name in ("ds", "double_sphere", "Double Sphere", "eucm", "FOV", "f-theta", "fisheye62")),
        *({"model": name} for name in ("equisolid", "stereographic", "catadioptric", "cylindrical", "unified model")),
    ],
)
def test_opencv_with_lenses_of_other_models(tmp_path: Path, more: dict[str, object]) -> None:
    path = write(tmp_path, "rig.json", json.dumps({**RAW, **more}))
    with pytest.raises(AnyNetError, match="expected cameras of the models pinhole"):
        read_rig(path)
    path.write_text(json.dumps({**RAW, **more, **RECTIFIED}))
    with pytest.warns(UserWarning, match="the raw cameras are left out: expected cameras of the models pinhole"):
        calibration = read(path)
    assert calibration == Calibration(480, 0.1, 325, 238)
    assert calibration.rig is None
    path.write_text(json.dumps({**RAW, **more, **RECTIFIED, "images": "raw"}))
    with pytest.raises(AnyNetError, match="expected cameras of the models pinhole"):
        read(path)


@pytest.mark.parametrize(
    ("more", "model"),
    [
        *(({"model": name}, "fisheye") for name in ("kb4", "KB8", "Kannala-Brandt", "cv2.fisheye", "equidistant")),
        *(({name: "fisheye"}, "fisheye") for name in ("model_left", "cam0_model", "lens_type", "distortionModel")),
        ({"is_fisheye": True}, "fisheye"),
        ({"camera_model": "pinhole", "distortion_model": "equidistant"}, "fisheye"),
        *(({"model": name}, "pinhole") for name in ("OmniVision OV9281", "DS-2CD2042", "Brown-Conrady", "radtan")),
        *(({"lens": name}, "pinhole") for name in ("aspherical 6mm", "spherical 6mm", "M12 FOV 78", "Meiji")),
        ({"type": "stereo", "lens": {"fov": 78}}, "pinhole"),
        *(
            ({"distortion_model": "radtan", name: "fisheye"}, "pinhole")
            for name in ("lens", "camera_type", "projection")
        ),
        *(({name: text}, "pinhole") for name in ("type", "lens") for text in ("ds", "fov", "stereographic")),
        *(({"model": name}, "pinhole") for name in ("oCam", "oCam-1CGN-U")),
        ({"model": "fisheye", "lens": "stereographic"}, "fisheye"),
        ({"left_images": "raw"}, "pinhole"),
    ],
)
def test_opencv_with_names_of_cameras_and_lenses(tmp_path: Path, more: dict[str, object], model: str) -> None:
    found = read_rig(write(tmp_path, "rig.json", json.dumps({**RAW, **more})))
    assert (found.left.model, found.right.model) == (model, model)


@pytest.mark.parametrize("more", [{"model": "fisheye"}, {"model": "omnidirectional"}, {"xi": 1.2}])
def test_opencv_with_a_further_camera_of_another_model(tmp_path: Path, more: dict[str, object]) -> None:
    camera = {"K": K1, "D": D[0][:4], "model": "radtan"}
    fields = {"left": camera, "right": camera, "R": R.tolist(), "T": T, "tracking": {"K": K1, "D": D, **more}}
    assert read_rig(write(tmp_path, "rig.json", json.dumps(fields))).left.model == "pinhole"


def test_opencv_with_folders_called_raw(tmp_path: Path) -> None:
    """Only files of ours say so, by `images`."""
    path = write(tmp_path, "rig.json", json.dumps({**RAW, "left_images": "raw", "images_right": "raw", **RECTIFIED}))
    with pytest.warns(UserWarning, match="4 distortion coefficients"):
        assert read(path).baseline == pytest.approx(0.1)


def test_opencv_with_raw_cameras_that_are_not_usable(tmp_path: Path) -> None:
    for wrong, message in (
        ({"D1": [1, 2, 3]}, "expected 4, 5, 8, 12, 14 distortion coefficients"),
        ({"K2": None}, "the calibration lacks K2 beside K1"),
        ({"R": np.zeros((3, 3)).tolist()}, "expected a rotation between the cameras"),
    ):
        rig = {name: value for name, value in {**RAW, **wrong}.items() if value is not None}
        with pytest.raises(AnyNetError, match=message):
            read_calibration(write(tmp_path, "rig.json", json.dumps(rig)))
        with pytest.warns(UserWarning, match=f"the raw cameras are left out: {message}"):
            assert read(write(tmp_path, "rig.json", json.dumps({**rig, **RECTIFIED}))).baseline == pytest.approx(0.1)


def test_raw_cameras_in_one_place_beside_rectified_values(tmp_path: Path) -> None:
    rig = {**RAW, **RECTIFIED, "P2": RECTIFIED["P1"], "T": [0, 0, 0]}
    calibration = read(write(tmp_path, "rig.json", json.dumps(rig)), replace={"baseline": 0.12})
    assert (calibration.baseline, calibration.rig) == (0.12, None)


def test_skewed_pixels_are_refused(tmp_path: Path) -> None:
    skewed = [[500, 3, 320], [0, 500, 240], [0, 0, 1]]
    rig = {"K1": skewed, "D1": D, "K2": skewed, "D2": D, "R": np.eye(3).tolist(), "T": [-0.1, 0, 0]}
    with pytest.raises(AnyNetError, match="expected a camera matrix without skew, got 3"):
        read_rig(write(tmp_path, "rig.json", json.dumps(rig)))
    for more in ({"D1": [0] * 4, "D2": [0] * 4}, {"D1": [0] * 4, "D2": [0] * 4, "T": None}):  # as of a rectified pair
        path = write(tmp_path, "rig.json", json.dumps({k: v for k, v in {**rig, **more}.items() if v is not None}))
        with pytest.raises(AnyNetError, match=r"expected a camera matrix without skew, got 3"):
            read_calibration(path, replace={"baseline": 0.1})
    device = depthai().replace("[800, 0, 640]", "[800, 2, 640]")
    with pytest.raises(AnyNetError, match="expected a camera matrix without skew, got 2"):
        read_rig(write(tmp_path, "oak.json", device))


def test_skewed_pixels_beside_rectified_values(tmp_path: Path) -> None:
    """They are of the raw images alone."""
    paths = [
        write(
            tmp_path,
            f"{along}.yaml",
            ROS.format(name="", along=along, model="equidistant", count=4, distortion="0.1, 0, 0, 0"),
        )
        for along in (0, -48)
    ]
    for path in paths:
        path.write_text(path.read_text().replace("[500, 0, 320", "[500, 0.3, 320"))
    skewed = [[500, 0.3, 320], [0, 500, 240], [0, 0, 1]]
    rig = {"K1": skewed, "D1": D, "K2": skewed, "D2": D, "R": R.tolist(), "T": T, "image_size": [640, 480]}
    rig |= {"P1": [[480, 0, 325, 0], *ROWS], "P2": [[480, 0, 325, -48], *ROWS]}
    rig["P1"][1] = rig["P2"][1] = [0, 480, 238, 0]  # type: ignore[index]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        both = read(*paths), read(write(tmp_path, "rig.json", json.dumps(rig)))
    for calibration in both:
        assert calibration == Calibration(480, 0.1, 325, 238, 0, (640, 480))
        image = np.zeros((480, 640, 3), np.uint8)
        with pytest.raises(AnyNetError, match=r"expected a camera matrix without skew, got 0\.3"):
            PairPreparation(calibration, raw=True)(image, image)
    with pytest.raises(AnyNetError, match=r"expected a camera matrix without skew, got 0\.3"):
        read_calibration(write(tmp_path, "ours.json", json.dumps({**rig, "images": "raw"})))


def test_kitti_pairs(tmp_path: Path) -> None:
    def line(name: str, x: float) -> str:
        return f"{name}: 700 0 600 {-700 * x} 0 700 170 0 0 0 1 0\n"

    text = line("P0", 0) + line("P1", 0.537) + line("P2", -0.06) + line("P3", 0.4727)
    path = write(tmp_path, "calib.txt", text)
    assert read(path).baseline == pytest.approx(0.5327)
    assert "color pair" in read(path).origin
    for image in ("image_0/1.png", "image_00/data/1.png"):
        assert read(path, image=tmp_path / image).baseline == pytest.approx(0.537)
    assert read(path, image=tmp_path / "image_2/1.png").baseline == pytest.approx(0.5327)
    assert "gray pair" in read(path, pair="gray").origin
    other = write(tmp_path, "middlebury.txt", "cam0=[100 0 30; 0 100 20; 0 0 1]\ndoffs=0\nbaseline=100\n")
    with pytest.raises(AnyNetError, match=r"pair \(--calib-pair\) belongs to KITTI's .*, got one of Middlebury"):
        read(other, pair="gray")


def test_kitti_raw_cameras(tmp_path: Path) -> None:
    text = "calib_time: 09-Jan-2012 13:57:47\n"
    for number, x in ((2, -0.06), (3, 0.47)):
        text += (
            f"S_0{number}: 1392 512\nK_0{number}: 960 0 696 0 957 224 0 0 1\nD_0{number}: -0.37 0.2 0.001 0.002 -0.07\n"
        )
        text += f"R_0{number}: 1 0 0 0 1 0 0 0 1\nT_0{number}: {-x} 0 0\nS_rect_0{number}: 1242 375\n"
        text += f"P_rect_0{number}: 721 0 609 {-721 * x} 0 721 172 0 0 0 1 0\n"
    calibration = read(write(tmp_path, "calib_cam_to_cam.txt", text))
    assert (calibration.size, calibration.baseline) == ((1242, 375), pytest.approx(0.53))
    assert calibration.rig is not None
    assert (calibration.rig.size, calibration.rig.baseline) == ((1392, 512), pytest.approx(0.53))
    wider = read(tmp_path / "calib_cam_to_cam.txt", replace={"baseline": 0.6})
    assert wider.rig is not None
    assert wider.baseline == 0.6
    assert wider.rig.baseline == pytest.approx(0.6)
    options = CameraOptions(calib=[tmp_path / "calib_cam_to_cam.txt"], raw=True, focal=700.0)
    with pytest.raises(AnyNetError, match="--raw: --focal cannot replace values of rectified images"):
        options.read()


def kitti_raw(*numbers: int) -> str:
    return "".join(
        f"S_0{number}: 1392 512\nK_0{number}: 960 0 696 0 957 224 0 0 1\nD_0{number}: -0.37 0.2 0.001 0.002 -0.07\n"
        f"R_0{number}: 1 0 0 0 1 0 0 0 1\nT_0{number}: {0.53 * (2 - number)} 0 0\n"
        for number in numbers
    )


def test_kitti_without_rectified_images(tmp_path: Path) -> None:
    rig = read_calibration(
        write(tmp_path, "calib_cam_to_cam.txt", "calib_time: today\ncorner_dist: 0.1\n" + kitti_raw(2, 3))
    )
    assert isinstance(rig, StereoRig)
    assert (rig.size, rig.baseline) == ((1392, 512), pytest.approx(0.53))
    text = kitti_raw(2, 3).replace("T_03", "T_04")
    with pytest.raises(AnyNetError, match=r"lacks P_rect_02 and P_rect_03 of rectified images; .*by, T_03$"):
        read(write(tmp_path, "calib_cam_to_cam.txt", text))
    with pytest.raises(AnyNetError, match=r"lacks P_rect_02 and P_rect_03 .*by, K_03, D_03, R_03, T_03, S_03$"):
        read(write(tmp_path, "calib_cam_to_cam.txt", kitti_raw(2)))


def test_kitti_says_what_of_the_raw_cameras_is_missing(tmp_path: Path) -> None:
    text = kitti_raw(2, 3).replace("D_03", "D_04")
    text += "P_rect_02: 721 0 609 0 0 721 172 0 0 0 1 0\nP_rect_03: 721 0 609 -382 0 721 172 0 0 0 1 0\n"
    calibration = read(write(tmp_path, "calib_cam_to_cam.txt", text))
    assert calibration.rig is None
    with pytest.raises(AnyNetError, match=r"\(--raw\), got none \(KITTI, color pair .*; of the raw .* lacks D_03\)"):
        PairPreparation(calibration, raw=True)


KARLSRUHE = """calib_time: 07-Sep-2009 12:00:00
corner_dist: 1.0e-01
roi: 20 1363 40 430
K1: 904 0 681 0 905 257 0 0 1
D1: -0.379 0.186 -0.0006 0.0003 -0.051
K2: 902 0 692 0 903 244 0 0 1
D2: -0.377 0.18 0.0002 -0.0004 -0.047
R: 1 0 0 0 1 0 0 0 1
T: -0.57 0.005 0.006
P1: 645.2 0 656 0 0 645.2 234.1 0 0 0 1 0
P1_roi: 645.2 0 636 0 0 645.2 194.1 0 0 0 1 0
P2: 645.2 0 656 -367.8 0 645.2 234.1 0 0 0 1 0
P2_roi: 645.2 0 636 -367.8 0 645.2 194.1 0 0 0 1 0
"""


def test_karlsruhe(tmp_path: Path) -> None:
    def without(*names: str) -> Path:
        lines = [line for line in KARLSRUHE.splitlines() if line.partition(":")[0] not in names]
        return write(tmp_path, "calib.txt", "\n".join(lines) + "\n")

    calibration = read(without())
    assert calibration == Calibration(645.2, 367.8 / 645.2, 636, 194.1, 0, (1344, 391))
    assert calibration.rig is not None
    assert calibration.rig.left.distorted
    assert calibration.rig.baseline == pytest.approx(0.57, abs=1e-3)
    assert read(without("P1_roi")) == Calibration(645.2, 367.8 / 645.2, 656, 234.1, 0)
    assert read(without("K2", "D2")).rig is None
    assert read(without("K1", "K2")).size == (1344, 391)
    assert isinstance(read_calibration(without("P1", "P1_roi", "P2", "P2_roi")), StereoRig)
    message = r"lacks P1_roi and P2_roi of rectified images; of the raw cameras, to rectify by, D2, T$"
    with pytest.raises(AnyNetError, match=message):
        read(without("P1", "P2_roi", "D2", "T"))
    path = write(tmp_path, "calib.txt", KARLSRUHE.replace("1363", "3"))
    with pytest.raises(AnyNetError, match="expected roi as first and last column, first and last row, got 20 3 40 430"):
        read(path)


@pytest.mark.parametrize(
    "text", ["994.978 0 311.193 0 994.978 254.877 0 0 1\n", "994.978 0 311.193\n0 994.978 254.877\n0 0 1\n"]
)
def test_k_txt(tmp_path: Path, text: str) -> None:
    assert read(write(tmp_path, "K.txt", text + "0.193\n")) == Calibration(994.978, 0.193, 311.193, 254.877)
    with pytest.raises(AnyNetError, match="lacks the baseline as its tenth number: give --baseline"):
        read(write(tmp_path, "K.txt", text))


MIDDLEBURY = "cam0=[994.978 0 311.193; 0 994.978 254.877; 0 0 1]\ndoffs=31.086\nbaseline=193.001\n"
K_TXT = "994.978 0 311.193 0 994.978 254.877 0 0 1\n0.193001\n"


@pytest.mark.parametrize(
    ("text", "doffs"),
    [
        (MIDDLEBURY.replace("31.086", "31.086  # pixels"), 31.086),
        (MIDDLEBURY.replace(" ", "\t").replace("\n", "\r\n"), 31.086),
        (MIDDLEBURY.replace(".", ","), 31.086),
        (K_TXT.replace(" ", ", "), 0),
        (K_TXT.replace("0.193001", "0.193001 // meters"), 0),
        (K_TXT.replace(".", ","), 0),
        ("# K\n[[994.978, 0, 311.193],\n [0, 994.978, 254.877],\n [0, 0, 1]]\n0.193001\n", 0),
        ("P2: 994,978 0 311,193 0 0 994,978 254,877 0 0 0 1 0\n"
         "P3: 994,978 0 311,193 -192,031749 0 994,978 254,877 0 0 0 1 0\n", 0),
        ("// rectified\n" + json.dumps({"K": [[994.978, 0, 311.193], [0, 994.978, 254.877], [0, 0, 1]],
                                       "T": [-193.001, 0, 0], "unit": "Millimetres"}), 0),
    ],
)  # fmt: skip
def test_separators_and_comments(tmp_path: Path, text: str, doffs: float) -> None:
    calibration = read(write(tmp_path, "calib.txt", text))
    assert calibration.baseline == pytest.approx(0.193001, abs=1e-6)
    assert (calibration.focal, calibration.cx, calibration.cy) == (994.978, 311.193, 254.877)
    assert calibration.doffs == doffs


def test_a_file_for_each_camera(tmp_path: Path) -> None:
    """The same names in both files are the two cameras'; what a rig has once must be the same."""

    def camera(focal: int) -> str:
        return f"K: [[{focal}, 0, 322], [0, {focal}, 238], [0, 0, 1]]\nD: [-0.{focal}, 0.09, 0, 0, 0]\n"

    pose = "R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [-0.12, 0, 0]\n"
    left, right = write(tmp_path, "left.yml", camera(520)), write(tmp_path, "right.yml", camera(514) + pose)
    alone, stereo = write(tmp_path, "right_alone.yml", camera(514)), write(tmp_path, "stereo.yml", pose)
    for files in ([left, right], [right, left], [left, alone, stereo]):
        rig = read_calibration(files)
        assert isinstance(rig, StereoRig)
        assert (rig.left.matrix[0, 0], rig.right.matrix[0, 0]) == (520, 514)
        assert (rig.left.distortion[0], rig.right.distortion[0]) == (-0.520, -0.514)
        assert rig.baseline == 0.12
    other = write(tmp_path, "left_too.yml", camera(520) + pose.replace("0.12", "0.13"))
    with pytest.raises(AnyNetError, match=r"expected T once, got different ones in left_too.yml and right.yml"):
        read_calibration([other, right])
    with pytest.raises(
        AnyNetError, match=r"expected K once, got different ones in left.yml and right.yml and third.yml"
    ):
        read_calibration([left, right, write(tmp_path, "third.yml", camera(500))])


def test_kalibr_in_two_files(tmp_path: Path) -> None:
    camera = "  camera_model: pinhole\n  intrinsics: [461, 460, 363, 248]\n  distortion_model: radtan\n"
    camera += "  distortion_coeffs: [-0.28, 0.07, 0, 0]\n  resolution: [752, 480]\n"
    pose = "  T_cn_cnm1: [[1, 0, 0, -0.11], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    first, second = write(tmp_path, "a.yaml", "cam0:\n" + camera), write(tmp_path, "b.yaml", "cam1:\n" + camera + pose)
    for files in ([first, second], [second, first]):
        rig = read_calibration(files)
        assert isinstance(rig, StereoRig)
        assert (rig.baseline, rig.size) == (pytest.approx(0.11), (752, 480))
    with pytest.raises(AnyNetError, match="lacks cam1"):
        read_calibration(first)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "calib.txt"
    path.write_bytes("cam0=[900 0 300; 0 900 250; 0 0 1]\ndoffs=3\nbaseline=100\n".encode(encoding))
    assert read(path) == Calibration(900, 0.1, 300, 250, 3)


def test_a_folder_of_several_calibrations(tmp_path: Path) -> None:
    for name in "ab":
        write(tmp_path, f"{name}.txt", "cam0=[900 0 300; 0 900 250; 0 0 1]\ndoffs=3\nbaseline=100\n")
    with pytest.raises(AnyNetError, match=r"expected the files of one calibration, got a\.txt, b\.txt; name those"):
        read_calibration(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(AnyNetError, match="expected calibration files in the folder"):
        read_calibration(tmp_path / "empty")


_INFRARED = {"fx": 420.0, "fy": 420.0, "ppx": 422.0, "ppy": 240.0}


@pytest.mark.parametrize(
    ("told", "meters"),
    [
        ({"baseline_in_meters": 4.0}, 4.0),
        ({"baseline_m": 1.2}, 1.2),
        ({"baseline_mm": 0.5}, 0.0005),
        ({"baseline": 12.0, "unit": "cm"}, 0.12),
        ({"translation": [-12.0, 0, 0], "unit": "cm"}, 0.12),
    ],
)
def test_realsense_in_the_unit_that_is_told(tmp_path: Path, told: dict[str, object], meters: float) -> None:
    path = write(tmp_path, "rs.json", json.dumps({"left": _INFRARED, "right": _INFRARED, **told}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # such baselines are unusual
        assert read(path).baseline == pytest.approx(meters)


@pytest.mark.parametrize("names", [("ir-1", "ir-2"), ("Infrared 1", "Infrared 2"), ("infra_1", "infra_2")])
def test_realsense_by_names_of_the_right_camera(tmp_path: Path, names: tuple[str, str]) -> None:
    cameras = {names[0]: _INFRARED, names[1]: {**_INFRARED, "ppx": 430.0}}
    assert read(write(tmp_path, "rs.json", json.dumps({**cameras, "baseline": 50}))).doffs == 8


def test_realsense_that_is_no_rectified_pair(tmp_path: Path) -> None:
    def file(cameras: dict[str, object], **more: object) -> Path:
        return write(tmp_path, "rs.json", json.dumps({**cameras, **more}))

    unnamed: dict[str, object] = {"cam0": _INFRARED, "cam1": {**_INFRARED, "ppx": 430.0}}
    with pytest.raises(AnyNetError, match="expected one of the cameras to be called right or infra2, got cam0, cam1"):
        read(file(unnamed, baseline=50))
    pair: dict[str, object] = {"left": _INFRARED, "right": _INFRARED}
    with pytest.raises(AnyNetError, match="the baseline is vertical"):
        read(file(pair, translation=[0, 0.05, 0]))
    with pytest.raises(AnyNetError, match=r"expected the translation of a rectified camera, along x, got 0 0 0\.05"):
        read(file(pair, translation=[0, 0, 0.05]))
    turn = cv2.Rodrigues(np.array([0, 0.17, 0]))[0].ravel().tolist()
    with pytest.warns(UserWarning, match="turned against the other"):
        read(file(pair, extrinsics={"rotation": turn, "translation": [-0.05, 0, 0]}))


def test_opencv_with_a_rotation_and_no_translation(tmp_path: Path) -> None:
    def file(turn: float) -> Path:
        rotation = cv2.Rodrigues(np.array([0, turn, 0], float))[0]
        return write(
            tmp_path, "turned.yaml", "%YAML:1.0\n" + matrix("K1", K1) + matrix("K2", K1) + matrix("R", rotation)
        )

    with pytest.raises(AnyNetError, match=r"unrectified cameras \(they are turned.*\): the calibration lacks T;"):
        read(file(0.02), replace={"baseline": 0.1})
    assert read(file(0), replace={"baseline": 0.1}).baseline == 0.1


def test_projections_are_those_of_a_rectified_pair(tmp_path: Path) -> None:
    left, right = np.array([[500, 0, 320, 0], *ROWS], float), np.array([[500, 0, 320, -50], *ROWS], float)
    left[1, 1] = right[1, 1] = 500

    def file(*projections: object) -> Path:
        named = zip(("P1", "P2"), projections, strict=True)
        return write(tmp_path, "projections.yaml", "%YAML:1.0\n" + "".join(matrix(*entry) for entry in named))

    assert read(file(left, right)) == read(file(2 * left, 3 * right)) == Calibration(500, 0.1, 320, 240)
    behind = right.copy()
    behind[2, 3] = 0.03
    with pytest.raises(AnyNetError, match=r"stand side by side, got one 0\.03 m behind the other"):
        read(file(left, behind))
    turned = right.copy()
    turned[2] = 0.1, 0, 1, 0
    with pytest.raises(AnyNetError, match=r"last row begins with 0 0 1, got 0\.1 0 1"):
        read(file(left, turned))


def test_cameras_of_two_sizes(tmp_path: Path) -> None:
    text = "%YAML:1.0\n" + matrix("K1", K1) + matrix("K2", K2) + matrix("T", T)
    named = text + "image_size_left: [640, 480]\nimage_size_right: [1280, 960]\n"
    camera = {"K": K1, "width": 640, "height": 480}
    inside = json.dumps({"left": camera, "right": {**camera, "width": 1280}, "T": [-0.1, 0, 0]})
    for name, content in (("named.yaml", named), ("inside.json", inside)):
        with pytest.raises(
            AnyNetError, match=r"expected one width and height of both cameras, got .640, 480. and .1280,"
        ):
            read_calibration([write(tmp_path, name, content)])


def test_coefficients_are_no_matrices(tmp_path: Path) -> None:
    camera = {"fx": 500, "fy": 500, "cx": 320, "cy": 240, "k1": -0.3, "k2": 0.1, "p1": 0.001, "p2": 0.002}
    q = [[1, 0, 0, -320], [0, 1, 0, -240], [0, 0, 0, 500], [0, 0, 10, 0]]
    for fields in ({"left": camera, "right": camera}, camera):
        path = write(tmp_path, "q.json", json.dumps({**fields, "Q": q}))
        assert read(path) == Calibration(500, 0.1, 320, 240)
