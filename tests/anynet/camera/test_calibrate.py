"""Calibration against cameras that are known: calculated corners here, rendered boards in the slow tests."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from anynet.camera import Camera, StereoRig, read_calibration
from anynet.camera.boards import Board, View, find_view
from anynet.camera.calibrate import calibrate
from anynet.camera.write import write_rig
from anynet.cli import main
from anynet.errors import AnyNetError
from anynet.io import read_image, write_image
from anynet.streams import Capture

from . import rendering

BOARD = Board(9, 6, 0.025)


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    none = np.zeros(3)
    if camera.model == "fisheye":
        return cv2.fisheye.projectPoints(points[:, None], none, none, camera.matrix, camera.distortion)[0][:, 0]
    return cv2.projectPoints(points, none, none, camera.matrix, camera.distortion)[0][:, 0]


def calculated(rig: StereoRig, count: int = 15, noise: float = 0.03) -> list[View]:
    rng = np.random.default_rng(2)
    middle = BOARD.points.mean(axis=0)
    views = []
    for number, (rotation, translation) in enumerate(rendering.poses(count, middle)):
        left = BOARD.points @ rotation.T + translation
        right = left @ rig.rotation.T + rig.translation
        seen = [
            (project(camera, points.astype(np.float64)) + rng.normal(0, noise, (len(left), 2))).astype(np.float32)
            for camera, points in ((rig.left, left), (rig.right, right))
        ]
        views.append(View(f"view {number}", BOARD.points, *seen))
    return views


def models() -> list[tuple[str, StereoRig]]:
    pinhole = rendering.rig()
    cameras = pinhole.left, pinhole.right
    rational = [Camera(camera.matrix, np.array([-0.28, 0.09, 0, 0, 0, 0.02, 0, 0])) for camera in cameras]
    fisheye = [Camera(camera.matrix, np.array([0.02, -0.01, 0.003, 0]), "fisheye") for camera in cameras]
    return [
        ("pinhole", pinhole),
        ("rational", replace(pinhole, left=rational[0], right=rational[1])),
        ("fisheye", replace(pinhole, left=fisheye[0], right=fisheye[1])),
    ]


@pytest.mark.parametrize(("model", "rig"), models(), ids=[name for name, _ in models()])
def test_known_cameras_are_found(model: str, rig: StereoRig) -> None:
    result = calibrate(calculated(rig), rendering.SIZE, model)
    for found, true in ((result.rig.left, rig.left), (result.rig.right, rig.right)):
        assert found.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=0.005)
        assert found.matrix[1, 1] == pytest.approx(true.matrix[1, 1], rel=0.005)
        np.testing.assert_allclose(found.matrix[:2, 2], true.matrix[:2, 2], atol=2)
        assert found.model == true.model
    assert result.rig.baseline == pytest.approx(rig.baseline, rel=0.005)
    assert result.vertical < 0.2
    assert result.reprojection < 0.1
    assert result.left_out == ()


def test_bad_views_are_left_out_and_named() -> None:
    views = calculated(rendering.rig())
    views[4] = replace(views[4], right=views[5].right)  # a pair of two moments
    views[9] = replace(views[9], left=views[9].left + np.float32(3) * np.sin(np.arange(54))[:, None].astype(np.float32))
    result = calibrate(views, rendering.SIZE)
    assert {name for name, _ in result.left_out} == {"view 4", "view 9"}
    assert all("pixels off" in why for _, why in result.left_out)
    assert len(result.views) == 13
    assert result.vertical < 0.2


def test_too_few_views() -> None:
    with pytest.raises(AnyNetError, match="expected at least 5 views of the board that agree, got 4"):
        calibrate(calculated(rendering.rig(), 4), rendering.SIZE)
    with pytest.raises(AnyNetError, match="expected a model of pinhole, rational, fisheye, got omni"):
        calibrate(calculated(rendering.rig(), 5), rendering.SIZE, "omni")


@pytest.mark.parametrize(("model", "rig"), models(), ids=[name for name, _ in models()])
def test_the_file_gives_the_rig_back(tmp_path: Path, model: str, rig: StereoRig) -> None:
    write_rig(tmp_path / "rig.yaml", rig, {"reprojection_error": 0.1})
    found = read_calibration(tmp_path / "rig.yaml")
    assert isinstance(found, StereoRig)
    assert found.size == rig.size
    for mine, true in ((found.left, rig.left), (found.right, rig.right)):
        np.testing.assert_array_equal(mine.matrix, true.matrix)
        np.testing.assert_array_equal(mine.distortion, true.distortion)
        assert mine.model == true.model
    np.testing.assert_allclose(found.rotation, rig.rotation, atol=1e-12)
    np.testing.assert_array_equal(found.translation, rig.translation)
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)  # OpenCV reads it, too
    np.testing.assert_array_equal(storage.getNode("K1").mat(), rig.left.matrix)
    np.testing.assert_allclose(storage.getNode("P2").mat(), rig.rectify().projections[1])
    assert storage.getNode("image_width").real() == 640


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((2, 6, 0.02), "expected a board of 3 x 3"),
        ((9, 6, 0.0), "expected a square"),
        ((9, 6, 25.0), "is it in millimeters"),
        ((9, 6, 0.02, 0.03), "expected markers smaller than the squares"),
        ((9, 6, 0.02, 0.01, "9X9"), "expected a dictionary of"),
    ],
)
def test_impossible_boards(values: tuple[int, int, float], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        Board(*values)


def test_no_board() -> None:
    flat = np.full((200, 300, 3), 100, np.uint8)
    assert find_view(BOARD, "a", flat, flat) == "no board in the left and the right image"


def save(folder: Path, images: list) -> None:
    for side in ("left", "right"):
        (folder / side).mkdir()
    for number, pair in enumerate(images):
        for side, image in zip(("left", "right"), pair, strict=True):
            write_image(folder / side / f"{number:02}.png", image)


def check_result(report: dict, count: int) -> None:
    true = rendering.rig()
    assert report["views"] >= count
    assert report["focal"] == pytest.approx([true.left.matrix[0, 0], true.right.matrix[0, 0]], rel=0.005)
    assert report["baseline"] == pytest.approx(true.baseline, rel=0.005)
    assert report["vertical_error"] < 0.2
    rectified = report["calibration"]
    assert rectified["focal"] == pytest.approx(true.rectify().calibration.focal, rel=0.005)
    assert rectified["size"] == list(rendering.SIZE)


@pytest.mark.slow
def test_rendered_chessboards(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From pictures to the file, from the file to rectified pictures; with a bad pair and one without a board."""
    texture, scale, _ = rendering.chessboard(9, 6, 0.025)
    middle = np.array([texture.shape[1], texture.shape[0], 0]) / scale / 2
    images = rendering.pairs(texture, scale, middle, 16)
    images.append((images[0][0], images[1][1]))
    images.append((np.full_like(images[0][0], 90), images[1][1]))
    save(tmp_path, images)
    out = tmp_path / "rig.yaml"
    arguments = ["calibrate", str(tmp_path / "left"), str(tmp_path / "right"), "--out", str(out), "--json"]
    assert main([*arguments, "--board", "9x6", "--square", "0.025"]) == 0
    streams = capsys.readouterr()
    report = json.loads(streams.out)
    check_result(report, 10)
    assert {"16", "17"} <= set(report["left_out"])
    assert "anynet: 17: left out: no board in the left image" in streams.err
    assert read_image(tmp_path / "rig_epipolar.png").shape == (480, 1280, 3)
    found = read_calibration(out)
    assert isinstance(found, StereoRig)
    pair = found.rectify()(*images[0])
    view = find_view(BOARD, "rectified", *pair)
    assert isinstance(view, View)
    assert np.abs(view.left[:, 1] - view.right[:, 1]).mean() < 0.2


def filmed(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    texture, scale, _ = rendering.chessboard(9, 6, 0.025)
    return rendering.pairs(texture, scale, np.array([texture.shape[1], texture.shape[0], 0]) / scale / 2, count)


@pytest.mark.slow
def test_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The board is held still for ten frames each time; the video is compressed."""
    videos = [str(tmp_path / f"{side}.mp4") for side in ("left", "right")]
    writers = [cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*"mp4v"), 30, rendering.SIZE) for name in videos]
    for pair in filmed(16):
        for writer, image in zip(writers, pair, strict=True):
            for _ in range(10):
                writer.write(image[..., ::-1])
    for writer in writers:
        writer.release()
    arguments = ["calibrate", *videos, "--out", str(tmp_path / "rig.yaml"), "--board", "9x6", "--square", "0.025"]
    assert main([*arguments, "--json"]) == 0
    check_result(json.loads(capsys.readouterr().out), 10)


class BoardCamera:
    """A camera that sees both sides' pictures of the board, one after the other, again and again."""

    def __init__(self, pictures: list[np.ndarray], interrupted: int | None = None) -> None:
        self.pictures, self.interrupted, self.count, self.asked = pictures, interrupted, 0, {}

    def __call__(self, name: str) -> BoardCamera:
        assert name == "0"
        return self

    def isOpened(self) -> bool:
        return True

    def grab(self) -> bool:
        if self.count == self.interrupted:
            os.kill(os.getpid(), signal.SIGINT)
        self.count += 1
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, self.pictures[(self.count - 1) % len(self.pictures)]

    def get(self, key: int) -> float:
        return 0.0

    def set(self, key: int, value: float) -> bool:
        self.asked[key] = value
        return True

    def release(self) -> None:
        pass


@pytest.mark.slow
@pytest.mark.parametrize("views", [6, 500])
def test_a_live_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, views: int
) -> None:
    """It ends with as many views as are asked for, or with those that there are on Ctrl-C."""
    camera = BoardCamera([np.hstack(pair)[..., ::-1].copy() for pair in filmed(14)], interrupted=14)
    monkeypatch.setattr("anynet.streams.Capture", partial(Capture, open=camera))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        arguments = ["calibrate", "0", "--split", "--size", "1280x480", "--out", str(tmp_path / "rig.yaml"), "--json"]
        assert main([*arguments, "--board", "9x6", "--square", "0.025", "--views", str(views)]) == 0
    finally:
        signal.signal(signal.SIGINT, before)
    report = json.loads(capsys.readouterr().out)
    if views == 6:
        assert report["views"] + len(report["left_out"]) == 6
    else:
        check_result(report, 8)
    assert camera.asked[cv2.CAP_PROP_FRAME_WIDTH] == 1280
    assert camera.count <= 14 + 1


@pytest.mark.slow
def test_rendered_charuco_side_by_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((8, 6), 0.03, 0.022, dictionary)
    gray = board.generateImage((960, 720), marginSize=0)
    texture = cv2.copyMakeBorder(gray, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=230)
    texture = np.repeat(texture[..., None], 3, axis=2)
    scale = 120 / 0.03
    middle = np.array([texture.shape[1], texture.shape[0], 0]) / scale / 2
    (tmp_path / "both").mkdir()
    for number, pair in enumerate(rendering.pairs(texture, scale, middle, 14)):
        write_image(tmp_path / "both" / f"{number:02}.png", np.hstack(pair))
    arguments = ["calibrate", str(tmp_path / "both"), "--split", "--out", str(tmp_path / "rig.yaml"), "--json"]
    assert main([*arguments, "--board", "8x6", "--square", "0.03", "--charuco", "0.022"]) == 0
    check_result(json.loads(capsys.readouterr().out), 10)


def test_mistakes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, message in (
        (["left"], "left: expected RIGHT too, or --split for images side by side"),
        (["left", "right", "--board", "nine"], "expected --board COLUMNSxROWS such as 9x6, got nine"),
        (["left", "right", "--square", "25"], "is it in millimeters"),
        (["left", "right", "--dictionary", "4X4_50"], "--dictionary belongs to --charuco"),
        ([str(tmp_path / "a.png"), str(tmp_path / "a.png"), "--views", "40"], "--views belongs to videos, cameras"),
        (["none.mp4", "none.mp4"], "cannot open none.mp4: no such video"),
    ):
        assert main(["calibrate", *arguments, "--out", str(tmp_path / "rig.yaml")]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "rig.yaml").exists()


def test_an_output_that_cannot_be_written_is_told_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "rig_epipolar.png").mkdir()
    for out, message in (
        (tmp_path, f"{tmp_path}: expected the name of a file, got a folder"),
        (tmp_path / "rig.yaml", f"{tmp_path / 'rig_epipolar.png'}: expected the name of a file, got a folder"),
        (tmp_path / "file" / "rig.yaml", f"cannot make the folder {tmp_path / 'file'}: File exists"),
    ):
        assert main(["calibrate", "none.mp4", "none.mp4", "--out", str(out)]) == 2
        assert capsys.readouterr().err == f"anynet: {message}\n"


def test_a_result_that_cannot_be_written_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    save(tmp_path, [(np.zeros((*rendering.SIZE[::-1], 3), np.uint8),) * 2] * 12)
    views = iter(calculated(rendering.rig(), 12))
    monkeypatch.setattr("anynet.camera.boards.find_view", lambda *_: next(views))

    def full(*_: object) -> None:
        raise AnyNetError("cannot write: No space left on device")

    monkeypatch.setattr("anynet.camera.write.write_rig", full)
    arguments = ["calibrate", str(tmp_path / "left"), str(tmp_path / "right"), "--out", str(tmp_path / "rig.yaml")]
    assert main([*arguments, "--json"]) == 2
    streams = capsys.readouterr()
    report = json.loads(streams.out)
    assert (report["views"], report["files"]) == (12, {})
    assert streams.err == "anynet: cannot write: No space left on device\n"
