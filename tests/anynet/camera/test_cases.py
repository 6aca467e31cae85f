"""Cases out of users' reports: files under ../shared/cases, pictures made from scikit-image's Motorcycle pair."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from anynet.cli import main
from anynet.io import read_depth, read_disparity

CASES = Path(__file__).parents[3] / ".." / "shared" / "cases" / "files"
pytestmark = [
    pytest.mark.skipif(not CASES.exists(), reason="the users' cases are not in ../shared/cases"),
    pytest.mark.slow,
]
MOTORCYCLE = {"focal": 994.978, "cx": 311.193, "cy": 254.877, "baseline": 0.193001, "doffs": 31.086}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cases") / "pictures"
    subprocess.run([sys.executable, str(CASES / "make_images.py"), str(folder)], check=True)
    return folder


class Predict:
    def __init__(self, pictures: Path, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.pictures, self.out, self.capsys = pictures, out, capsys

    def __call__(self, left: str, right: str, *arguments: object) -> tuple[int, dict, str]:
        pair = [str(self.pictures / image) for image in (left, right)]
        status = main(["predict", *pair, "--out", str(self.out), "--json", *map(str, arguments)])
        streams = self.capsys.readouterr()
        report = json.loads(streams.out) if status == 0 else {}
        assert status in (0, 2)
        if status == 0:
            for warning in report["warnings"]:  # in both places
                assert warning in streams.err
        return status, report, streams.err

    def plain(self, *files: str, **options: object) -> tuple[int, dict, str]:
        arguments = [argument for file in files for argument in ("--calib", CASES / file)]
        arguments += [
            argument for name, value in options.items() for argument in (f"--{name.replace('_', '-')}", value)
        ]
        return self("plain/left.png", "plain/right.png", *arguments)


@pytest.fixture
def predict(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Predict:
    return Predict(pictures, tmp_path / "out", capsys)


def check(report: dict, **changes: object) -> None:
    for name, value in {**MOTORCYCLE, **changes}.items():
        assert report["calibration"][name] == pytest.approx(value, rel=1e-4, abs=1e-3), name


def true_depth() -> np.ndarray:
    """The Motorcycle's, NaN where it is unknown."""
    truth = stereo_motorcycle()[2]
    depth = MOTORCYCLE["focal"] * MOTORCYCLE["baseline"] / (truth + MOTORCYCLE["doffs"])
    return np.where(np.isfinite(truth), depth, np.nan)


@pytest.mark.parametrize("file", ["unit/q_mm.yml", "unit/k_t_mm.xml", "unit/p_cm.yml"])
def test_units(predict: Predict, file: str) -> None:
    _, report, errors = predict.plain(file)
    assert "m is long" in errors
    assert "--calib-unit" in errors
    _, report, errors = predict.plain(file, calib_unit="cm" if "cm" in file else "mm")
    assert errors == ""
    check(report)
    depth, truth = read_depth(report["files"]["depth"]), true_depth()
    assert np.nanmedian(np.abs(depth - truth) / truth) < 0.02


@pytest.mark.parametrize(
    ("files", "changes"),
    [
        (["unit/q_m.yml"], {}),
        (["unit/q_m_phone.yml"], {"baseline": 0.0142}),
        (["raw/rectified_m.yml"], {}),
        (["formats/K.txt"], {"doffs": 0}),
        (["formats/camera_info_left.yaml", "formats/camera_info_right.yaml"], {}),
        (["formats/camera_info_right.yaml", "formats/camera_info_left.yaml"], {}),
        (["formats/orb_slam.yaml"], {"doffs": 0}),
        (["formats/map_beside_q.yml"], {}),
        (["formats/nested_map_beside_q.yml"], {}),
        (["formats/t_as_list.yml"], {"doffs": 0}),
        (["formats/filestorage.json"], {}),
        (["formats/middlebury.txt"], {}),
        (["formats/middlebury_bom.txt"], {}),
        (["formats/p_rect_101_103.txt"], {}),
        (["formats/kitti_no_labels.txt"], {}),
        (["formats/proj_mat_LR.xml"], {}),
        (["formats/whole_numbers.yml"], {"focal": 995, "cx": 311, "cy": 255, "doffs": 31.081, "baseline": 0.19305}),
    ],
)
def test_read_without_a_word(predict: Predict, files: list[str], changes: dict[str, float]) -> None:
    status, report, errors = predict.plain(*files)
    assert (status, errors) == (0, "")
    check(report, **changes)


@pytest.mark.parametrize("file", ["raw/raw_m.yml", "raw/raw_one_camera_m.yml"])
def test_raw_cameras_are_rectified(predict: Predict, file: str) -> None:
    _, report, _ = predict.plain(file)
    assert "rectified by the calibration of raw cameras" in report["notes"]
    assert report["calibration"]["baseline"] == pytest.approx(0.09308, abs=1e-5)
    assert report["calibration"]["doffs"] == 0


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("size/q_image_size.yml", "expected images of 1482 x 1000 as the calibration says, got 741 x 500"),
        ("size/q_width_height.yml", "expected images of 1482 x 1000"),
        ("size/p_imageSize.xml", "expected images of 1482 x 1000"),
        ("rig/vertical_q.yml", "one above the other"),
        ("rig/vertical_p.yml", "one above the other"),
        ("formats/camera_info_left.yaml", "the right camera's camera_info (as another --calib)"),
        ("formats/camera_info_right.yaml", "the left one's file is needed too"),
        ("formats/raw_pinhole_map.yaml", "of unrectified cameras"),
        ("formats/raw_kalibr.yaml", "expected images of 752 x 480"),
        ("formats/raw_factory.conf", "expected images of 1280 x 720"),
    ],
)
def test_refused(predict: Predict, file: str, message: str) -> None:
    status, _, errors = predict.plain(file)
    assert status == 2
    assert message in errors
    assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("size/q_centre_outside.yml", "the principal point lies outside the image"),
        ("rig/exchanged_q.yml", "camera 1 of the calibration is the right one"),
        ("rig/q_p_differ.yml", "P1, P2 and Q do not agree (doffs 0 against -24)"),
        ("range/no_depth.yml", "only disparities above 239.5 pixels have a depth"),
        ("raw/raw_mm_real_numbers.yml", "a baseline of 301.175 m is long"),
    ],
)
def test_told(predict: Predict, file: str, message: str) -> None:
    status, report, _ = predict.plain(file)
    assert status == 0
    assert any(message in warning for warning in report["warnings"])


@pytest.mark.parametrize(("name", "doffs", "cx"), [("exchanged", 0, 326.836), ("exchanged_doffs", 4.478, 324.597)])
def test_exchanged_cameras_are_the_same_by_q_and_p(predict: Predict, name: str, doffs: float, cx: float) -> None:
    for kind in "qp":
        _, report, _ = predict.plain(f"rig/{name}_{kind}.yml")
        check(report, focal=608.5, cx=cx, cy=243.923, doffs=doffs, baseline=0.118007)


def test_near(predict: Predict, pictures: Path) -> None:
    _, report, _ = predict("near/left.png", "near/right.png", "--calib", pictures / "near/calib.txt")
    assert any("(ndisp)" in warning and "--input-scale" in warning for warning in report["warnings"])
    assert any("matched corners have disparities above 192" in warning for warning in report["warnings"])
    scaled = ("--calib", pictures / "near/calib.txt", "--input-scale", 0.5)
    assert not any(
        "--input-scale" in warning for warning in predict("near/left.png", "near/right.png", *scaled)[1]["warnings"]
    )


def test_far_apart(predict: Predict) -> None:
    _, report, _ = predict("far_apart/left.png", "far_apart/right.png")
    assert any("disparities above 192" in warning for warning in report["warnings"])
    _, report, _ = predict(
        "far_apart/left.png", "far_apart/right.png", "--input-scale", 0.4, "--focal", 1000, "--baseline", 0.1
    )
    assert set(report["files"]) == {"disparity", "color", "depth", "cloud"}
    assert np.nanmedian(read_disparity(report["files"]["disparity"])) == pytest.approx(300, abs=3)


@pytest.mark.parametrize("cut", [40, 60])
def test_negative_disparities_get_the_uncut_pair_s_depth(predict: Predict, pictures: Path, cut: int) -> None:
    expected = true_depth()[:, cut:]
    names = f"negative/cut{cut}_left.png", f"negative/cut{cut}_right.png"
    _, report, errors = predict(*names, "--calib", pictures / f"negative/cut{cut}.txt")
    assert "swapped" not in errors
    depth = read_depth(report["files"]["depth"])
    known = np.isfinite(expected)
    wrong = ~(np.abs(depth - expected) <= 0.1 * expected)
    assert wrong[known].mean() < 0.25  # 0.17 of the uncut pair, 0.85 before


def test_one_picture_twice(predict: Predict) -> None:
    for name in ("one/side_by_side.png", "plain/left.png"):
        assert "left and right are the same picture" in predict(name, name)[2]


def test_demo_and_evaluate(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = [str(pictures / "plain" / f"{side}.png") for side in ("left", "right")]
    near = [str(pictures / "near" / f"{side}.png") for side in ("left", "right")]
    out = ["--out", str(tmp_path / "demo")]
    assert main(["demo", *near, "--calib", str(pictures / "plain/calib.txt"), *out]) == 2
    assert "expected images of 741 x 500" in capsys.readouterr().err
    for truth, message in (
        ("times64.png", "times the estimated ones"),
        ("negative.npy", "known disparities are negative"),
    ):
        assert main(["demo", *plain, "--truth", str(pictures / "truth" / truth), *out]) == 0
        assert message in capsys.readouterr().err
    scaled = ["--truth", str(pictures / "truth/times64.png"), "--truth-scale", "64"]
    assert main(["demo", *plain, *scaled, *out]) == 0
    assert capsys.readouterr().err == ""
    for name, message in (
        ("times64", "times the estimated"),
        ("negative", "negative"),
        ("depth_mm", "no pixel counts"),
    ):
        assert main(["evaluate", "--data", f"csv:{pictures / 'truth' / name}.csv"]) == 0
        assert message in capsys.readouterr().err
    assert main(["evaluate", "--data", f"csv:{pictures / 'truth'}/depth_mm.csv?scale=1000"]) == 0
    assert "nan" not in capsys.readouterr().out


def test_our_own_depth_is_read_by_evaluate(
    predict: Predict, pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calib = pictures / "plain/calib.txt"
    formats = [argument for kind in ("tiff", "npy", "png") for argument in ("--depth-format", kind)]
    _, report, _ = predict("plain/left.png", "plain/right.png", "--calib", calib, *formats)
    for kind in ("depth", "depth_npy", "depth_png"):
        table = tmp_path / "list.csv"
        row = ",".join(
            str(path)
            for path in (*(pictures / "plain" / f"{s}.png" for s in ("left", "right")), report["files"][kind], calib)
        )
        table.write_text(f"left,right,depth,calibration\n{row}\n")
        assert main(["evaluate", "--data", f"csv:{table}"]) == 0
        last = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| default")][-1]
        assert float(last.split("|")[6]) < 0.05  # EPE against itself
