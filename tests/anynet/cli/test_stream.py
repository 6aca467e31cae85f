from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from bags import START, BagWriter
from PIL import Image

from anynet import AnyNetError, Predictor
from anynet.cli.stream import _completed
from anynet.io import read_disparity, read_image, write_image

from .conftest import Run

KEYS = {"name", "stamp", "width", "height", "stage", "elapsed_ms", "calibration", "files", "warnings"}
CALIB = ("--focal", 100, "--baseline", 0.1)


def lines(out: str) -> tuple[list[dict], dict]:
    """The frames' lines and the summary."""
    *frames, last = [json.loads(line) for line in out.splitlines()]
    assert list(last) == ["summary"]
    return frames, last["summary"]


def test_folders_to_files(run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("stream", *folders, "--every-frame", "--weights", weights, "--out", out, "--json", *CALIB)
    assert (result.status, result.err) == (0, "")
    frames, summary = lines(result.out)
    assert [frame["name"] for frame in frames] == ["a", "b", "c"]
    for frame in frames:
        assert frame.keys() == KEYS
        assert sorted(frame["files"]) == ["cloud", "color", "depth", "disparity"]
        assert all(Path(file).is_file() for file in frame["files"].values())
        assert (frame["width"], frame["height"], frame["stage"]) == (64, 48, 4)
        assert frame["calibration"]["focal"] == 100
        assert len(frame["elapsed_ms"]) == 1
    assert [frame["stamp"] - frames[0]["stamp"] for frame in frames] == pytest.approx([0, 0.1, 0.2], abs=1e-6)
    assert (summary["frames"], summary["dropped"], summary["stages"]) == (3, 0, {"4": 3})
    assert summary["fps"] > 0
    assert 0 < summary["latency_ms"]["p50"] <= summary["latency_ms"]["p95"] <= summary["latency_ms"]["max"]
    images = [read_image(folder / "b.png") for folder in folders]
    expected = Predictor(weights).predict(*images).disparity
    expected = np.where(expected > 0, expected, np.nan)
    name = frames[1]["files"]["disparity"]
    np.testing.assert_allclose(read_disparity(name), expected, atol=1 / 256 if name.endswith("png") else 1e-4)


def test_text(run: Run, folders: tuple[Path, Path], weights: Path) -> None:
    result = run("stream", *folders, "--every-frame", "--weights", weights, "--stage", 2, "--frames", 2)
    assert (result.status, result.err) == (0, "")
    first, second, last = result.out.splitlines()
    assert first.startswith("a: 64 x 48, stage 2 after ")
    assert second.startswith("b: 64 x 48, stage 2 after ")
    assert last.startswith("2 frames, ")


def test_a_file_that_is_damaged_ends_it_in_one_line(
    run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path
) -> None:
    (folders[0] / "c.png").write_bytes(b"\x89PNG garbage")
    options = ("--every-frame", "--weights", weights, "--json", "--video", tmp_path / "a.mp4")
    result = run("stream", *folders, *options)
    assert result.status == 2
    assert result.err.count("\n") == 1
    assert result.err.startswith(f"anynet: cannot read {folders[0] / 'c.png'}")
    frames, summary = lines(result.out)
    assert len(frames) == summary["frames"] == 2
    assert cv2.VideoCapture(str(tmp_path / "a.mp4")).read()[0]  # what came before is complete


def test_mistakes_are_told_at_once(run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    (tmp_path / "old.mp4").touch()
    for options, message in (
        (("--stage", 5), "expected --stage from 1 to 4, got 5"),
        (("--video", tmp_path / "old.mp4"), "exists"),
        (("--video", tmp_path / "a.avi"), "expected a name ending in .mp4"),
        (("--record", tmp_path / "none" / "a.mcap"), "no folder"),
        (("--calib", tmp_path / "none"), "none"),
        (("--size", "big"), "expected a size like 1280x720, got big"),
        (("--max-depth", "nan"), "expected --max-depth > 0, got nan"),
        (("--max-depth", 5, "--video", tmp_path / "a.mp4"), "--max-depth belongs to --out and --record"),
        (("--format", "npy", "--record", tmp_path / "a.mcap"), "--format belongs to --out"),
        (("--depth-format", "npy"), "--depth-format belongs to --out"),
        (("--depth-encoding", "16UC1", "--out", tmp_path / "out"), "--depth-encoding belongs to --record"),
        (("--record", tmp_path / "a.bag", "--record", tmp_path / "." / "a.bag"), "expected files that differ, got "),
        (("--size", "64x48"), "--size belongs to live sources"),
    ):
        result = run("stream", *folders, "--weights", weights, "--every-frame", *options)
        assert result.status == 2, options
        assert message in result.err
        assert result.err.count("\n") == 1
        assert "," not in result.out


def test_recording_to_recording(run: Run, scene: tuple[np.ndarray, np.ndarray], weights: Path, tmp_path: Path) -> None:
    """Stamps and frame ids of a bag go into the MCAP file, and the calibration comes from the bag."""
    rosbags = pytest.importorskip("rosbags.highlevel", reason="the extra ros is not installed")
    left, right = (np.ascontiguousarray(image) for image in scene)
    with BagWriter(tmp_path / "in.bag") as bag:
        for index, side in enumerate(("left", "right")):
            projection = np.array([[100.0, 0, 32, -10.0 * index], [0, 100, 24, 0], [0, 0, 1, 0]])
            bag.camera_info(f"/rig/{side}/camera_info", (64, 48), projection[:, :3], [], np.eye(3), projection)
        for index in range(3):
            for side, image in (("left", left), ("right", right)):
                bag.image(f"/rig/{side}/image_rect", image, START + 1_000_001 * index)
    out = tmp_path / "out.mcap"
    result = run("stream", tmp_path / "in.bag", "--every-frame", "--weights", weights, "--record", out, "--json")
    assert (result.status, result.err) == (0, "")
    frames, _ = lines(result.out)
    assert [frame["stamp"] for frame in frames] == pytest.approx([START / 1e9 + 0.001 * i for i in range(3)], abs=1e-5)
    assert frames[0]["calibration"]["baseline"] == pytest.approx(0.1)
    with rosbags.AnyReader([out]) as reader:
        messages = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    depths = [message for topic, message in messages if topic == "/stereo/left/depth"]
    assert [message.header.stamp.nanosec for message in depths] == [1_000_001 * index for index in range(3)]
    assert {message.header.frame_id for _, message in messages} == {"eye"}
    values = depths[0].data.view("<f4").reshape(48, 64)
    expected = Predictor(weights).predict(left, right).disparity
    expected = 10 / np.where(expected > 0, expected, np.nan)
    np.testing.assert_allclose(values, expected, rtol=1e-3)


def test_images_without_a_partner_are_told_at_the_end(
    run: Run, scene: tuple[np.ndarray, np.ndarray], weights: Path, tmp_path: Path
) -> None:
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    with BagWriter(tmp_path / "in.bag") as bag:
        for index in range(4):
            for side, image, late in zip(("left", "right"), scene, (0, 50_000_000 * (index > 1)), strict=True):
                bag.image(f"/{side}/image", np.ascontiguousarray(image), START + 100_000_000 * index + late)
    result = run("stream", tmp_path / "in.bag", "--every-frame", "--no-check", "--weights", weights, "--json")
    frames, summary = lines(result.out)
    assert (result.status, len(frames)) == (0, 2)
    message = "2 left and 2 right images had no partner within 10 ms (--slop)"
    assert result.err == f"anynet: warning: {tmp_path / 'in.bag'}: {message}\n"
    assert (summary["frames"], summary["dropped"], summary["unpaired"]) == (2, 0, {"left": 2, "right": 2})


def test_confidence_goes_everywhere(run: Run, folders: tuple[Path, Path], tmp_path: Path) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel", reason="the extra ros is not installed")
    out, record = tmp_path / "out", tmp_path / "out.mcap"
    options = ("--every-frame", "--out", out, "--format", "npy", "--record", record, "--json", *CALIB)
    result = run("stream", *folders, "--min-confidence", 0.5, "--drop-occluded", *options)
    assert result.status == 0, result.err
    frames, _ = lines(result.out)
    assert {"confidence", "occluded"} < set(frames[0]["files"])
    with rosbags.AnyReader([record]) as reader:
        messages = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    confidence = messages["/stereo/left/confidence"].data.view("<f4").reshape(48, 64)
    occluded = messages["/stereo/left/occluded"].data.reshape(48, 64) > 0
    images = [read_image(folder / "c.png") for folder in folders]
    np.testing.assert_array_equal(confidence, Predictor().predict(*images, confidence=True).confidence)
    disparity = np.load(frames[-1]["files"]["disparity"])
    assert np.isnan(disparity[(confidence < 0.5) | occluded]).all()
    assert np.isfinite(disparity).any()


def test_the_size_chooses_among_a_files_resolutions(run: Run, folders: tuple[Path, Path], tmp_path: Path) -> None:
    """ZED's files have several."""
    lefts, rights = tmp_path / "left", tmp_path / "right"
    for folder, image in zip((lefts, rights), scene_of(folders), strict=True):
        folder.mkdir()
        write_image(folder / "0.png", cv2.resize(image, (672, 376)))
    values = "fx={0}\nfy={0}\ncx={1}\ncy={2}\nk1=0\nk2=0\n"
    text = "".join(
        f"[{side}_CAM_{name}]\n" + values.format(focal, width / 2, height / 2)
        for side in ("LEFT", "RIGHT")
        for name, focal, width, height in (("HD", 700, 1280, 720), ("VGA", 350, 672, 376))
    )
    (tmp_path / "SN1.conf").write_text(text + "[STEREO]\nBaseline=120\nRX_VGA=0\nCV_VGA=0\nRZ_VGA=0\n")
    options = ("--every-frame", "--no-check", "--stage", 1, "--json")
    result = run("stream", lefts, rights, "--calib", tmp_path / "SN1.conf", *options)
    assert result.status == 0, result.err
    assert lines(result.out)[0][0]["calibration"]["focal"] == 350


def scene_of(folders: tuple[Path, Path]) -> list[np.ndarray]:
    return [read_image(folder / "a.png") for folder in folders]


def test_view_excludes_what_it_does_not_do(run: Run, folders: tuple[Path, Path], tmp_path: Path) -> None:
    for options in (("--record", tmp_path / "a.mcap"), ("--json",), ("--stage", 1), ("--min-confidence", 0.5),
                    ("--format", "npy"), ("--max-depth", 5)):  # fmt: skip
        result = run("stream", *folders, "--view", *options)
        assert result.status == 2
        assert result.err.startswith("anynet: --view excludes --record")
        assert result.err.count("\n") == 1


def raw_view(camera: np.ndarray, distortion: np.ndarray, x: float, turn: float, depth: float) -> np.ndarray:
    """A textured wall, seen by a raw camera at x, turned about its vertical axis."""
    texture = cv2.resize(np.random.default_rng(0).integers(0, 256, (160, 160, 3), np.uint8), (1600, 1600))
    columns, rows = np.meshgrid(np.arange(320.0), np.arange(240.0))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(pixels, camera, distortion).reshape(240, 320, 2)
    rays = np.dstack([rays, np.ones((240, 320))]) @ cv2.Rodrigues(np.array([0.0, turn, 0.0]))[0].T
    points = rays * (depth / rays[..., 2:])
    where = ((points[..., :2] + (x, 0)) * 400 + 800).astype(np.float32)
    return cv2.remap(texture, where[..., 0], where[..., 1], cv2.INTER_LINEAR)


def test_raw_images_of_a_rig_with_distortion(run: Run, tmp_path: Path) -> None:
    """Rendered, recorded raw, rectified on the fly; the wall stands at 1.5 m."""
    rosbags = pytest.importorskip("rosbags.highlevel", reason="the extra ros is not installed")
    camera = np.array([[260.0, 0, 158], [0, 262, 121], [0, 0, 1]])
    distortion = np.array([-0.25, 0.06, 0.001, -0.001, 0.0])
    turn = 0.03
    rotation = cv2.Rodrigues(np.array([0.0, -turn, 0.0]))[0]  # from the left camera's axes to the right one's
    translation = rotation @ np.array([[-0.12], [0], [0]])
    r1, r2, p1, p2, *_ = cv2.stereoRectify(camera, distortion, camera, distortion, (320, 240), rotation, translation)
    views = [raw_view(camera, distortion, x, angle, 1.5) for x, angle in ((0, 0), (0.12, turn))]
    with BagWriter(tmp_path / "raw.mcap") as bag:
        for side, image, r, p in zip(("left", "right"), views, (r1, r2), (p1, p2), strict=True):
            bag.camera_info(f"/{side}/camera_info", (320, 240), camera, distortion, r, p)
            bag.image(f"/{side}/image_raw", image, START)
    out = tmp_path / "out.mcap"
    result = run("stream", tmp_path / "raw.mcap", "--every-frame", "--record", out, "--json")
    assert result.status == 0, result.err
    (frame,), _ = lines(result.out)
    assert not any("unrectified" in warning for warning in frame["warnings"])
    assert frame["calibration"]["baseline"] == pytest.approx(0.12, rel=1e-3)
    with rosbags.AnyReader([out]) as reader:
        messages = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    depth = messages["/stereo/left/depth"].data.view("<f4").reshape(240, 320)[40:-40, 100:-40]
    assert np.nanmedian(np.abs(depth - 1.5)) < 0.05
    assert np.isfinite(depth).mean() > 0.9


def processes(*arguments: object, weights: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "anynet", "stream", *map(str, arguments), "--weights", str(weights), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # the tests may run where it is ignored
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_and_complete_what_is_written(
    folders: tuple[Path, Path], weights: Path, tmp_path: Path, number: signal.Signals
) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel", reason="the extra ros is not installed")
    for folder in folders:
        for index in range(2000):
            os.link(folder / "a.png", folder / f"{index:04}.png")
    out, video = tmp_path / "out.mcap", tmp_path / "out.mp4"
    process = processes(*folders, "--record", out, "--video", video, "--rate", 20, weights=weights)
    assert process.stdout is not None
    first = [process.stdout.readline() for _ in range(3)]
    process.send_signal(number)
    rest, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    frames, summary = lines("".join(first) + rest)
    assert len(frames) == summary["frames"] < 2000
    with rosbags.AnyReader([out]) as reader:
        assert sum(1 for _ in reader.messages()) == len(frames)
    assert cv2.VideoCapture(str(video)).read()[0]
    assert sorted(path.name for path in tmp_path.iterdir() if "out" in path.name) == ["out.mcap", "out.mp4"]


def test_each_loss_is_told(
    run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A write that fails, and two sinks that cannot be completed."""
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    from anynet.streams import Recorder, Video

    def failing(what: str) -> Callable[..., None]:
        def fail(sink: object, *_: object) -> None:
            raise AnyNetError(f"{what} {type(sink).__name__}")

        return fail

    monkeypatch.setattr(Video, "write", failing("write"))
    for kind in (Recorder, Video):
        monkeypatch.setattr(kind, "close", failing("close"))
    options = ("--record", tmp_path / "a.mcap", "--video", tmp_path / "a.mp4")
    result = run("stream", *folders, "--no-check", "--every-frame", "--weights", weights, *options)
    assert result.status == 2
    assert result.err == "anynet: write Video\nanynet: close Recorder\nanynet: close Video\n"


def test_a_closed_pipe_is_quiet(folders: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    process = processes(*folders, "--rate", 5, weights=weights)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(timeout=60) == 1


def test_a_slow_network_keeps_up(run: Run, folders: tuple[Path, Path], weights: Path) -> None:
    """At a thousand frames per second most are dropped, and the stream ends soon after the last."""
    for folder in folders:
        for index in range(100):
            os.link(folder / "a.png", folder / f"{index:04}.png")
    begin = time.monotonic()
    result = run("stream", *folders, "--rate", 1000, "--weights", weights, "--json", "--budget-ms", 0)
    frames, summary = lines(result.out)
    assert result.status == 0
    assert summary["frames"] + summary["dropped"] == 103
    assert frames[-1]["name"] == "c"
    assert {frame["stage"] for frame in frames} == {1}
    assert time.monotonic() - begin < 60


def test_side_by_side_video_to_video(
    run: Run, scene: tuple[np.ndarray, np.ndarray], weights: Path, tmp_path: Path
) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "in.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (128, 48))
    for _ in range(4):
        writer.write(np.ascontiguousarray(np.hstack(scene)[..., ::-1]))
    writer.release()
    out = tmp_path / "out.mp4"
    result = run(
        "stream", tmp_path / "in.avi", "--split", "--every-frame", "--weights", weights, "--video", out, "--json"
    )
    assert (result.status, result.err) == (0, "")
    frames, summary = lines(result.out)
    assert summary["frames"] == 4
    assert [frame["name"] for frame in frames] == ["000000", "000001", "000002", "000003"]
    capture = cv2.VideoCapture(str(out))
    assert capture.get(cv2.CAP_PROP_FPS) == 10
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 4


def test_warnings_come_with_the_first_frame(run: Run, weights: Path, tmp_path: Path) -> None:
    from skimage.data import stereo_motorcycle

    for name, image in zip(("right", "left"), stereo_motorcycle()[:2], strict=True):  # exchanged
        (tmp_path / name).mkdir()
        write_image(tmp_path / name / "0.png", image)
    given = ("stream", tmp_path / "left", tmp_path / "right", "--weights", weights, "--every-frame", "--json")
    result = run(*given)
    (frame,), _ = lines(result.out)
    assert any("swapped" in warning for warning in frame["warnings"])
    assert "anynet: 0: warning: left and right look swapped" in result.err
    assert run(*given, "--no-check").err == ""


def test_warnings_of_other_threads(run: Run, folders: tuple[Path, Path], weights: Path) -> None:
    """Images are read on a thread of their own, whose warnings are the frame's."""
    alpha = np.dstack([read_image(folders[0] / "b.png"), np.full((48, 64), 9, np.uint8)])
    Image.fromarray(alpha).save(folders[0] / "b.png")
    result = run("stream", *folders, "--weights", weights, "--every-frame", "--json")
    frames, _ = lines(result.out)
    message = f"{folders[0] / 'b.png'}: the alpha channel is ignored"
    assert [warning for frame in frames for warning in frame["warnings"]] == [message]
    assert [line.partition(": warning: ")[2] for line in result.err.splitlines()] == [message]


@pytest.mark.slow
def test_from_a_board_to_depth(run: Run, tmp_path: Path) -> None:
    """calibrate -> stream -> MCAP: rendered pictures of a board, then raw videos of a wall that comes nearer."""
    reader = pytest.importorskip("mcap.reader", reason="the mcap library is not installed")
    ros2 = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
    from camera import rendering

    true = rendering.rig()
    sides = "left", "right"
    for side in sides:
        (tmp_path / side).mkdir()
    for index, images in enumerate(rendering.pairs(*rendering.chessboard(9, 6, 0.025), 14)):
        for side, image in zip(sides, images, strict=True):
            write_image(tmp_path / side / f"{index:02}.png", image)
    calib = tmp_path / "stereo.yaml"
    result = run(
        "calibrate", tmp_path / "left", tmp_path / "right", "--board", "9x6", "--square", 0.025, "--out", calib
    )
    assert result.status == 0, result.err

    noise = np.random.default_rng(3).integers(0, 256, (300, 300, 3), dtype=np.uint8)
    texture = cv2.resize(noise, (3000, 3000), interpolation=cv2.INTER_CUBIC)
    depths = 1.6, 1.2, 0.9
    directions = [rendering.rays(camera) for camera in (true.left, true.right)]
    poses = (np.eye(3), np.zeros(3)), (true.rotation, true.translation)
    for side, rays, (rotation, translation) in zip(sides, directions, poses, strict=True):
        writer = cv2.VideoWriter(str(tmp_path / f"{side}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, rendering.SIZE)
        for depth in depths:
            place = rotation @ [-1.5, -1.5, depth] + translation
            writer.write(rendering.view(rays, rotation, place, texture, 1000.0)[..., ::-1].copy())
        writer.release()

    out = tmp_path / "out.mcap"
    videos = tmp_path / "left.avi", tmp_path / "right.avi"
    result = run("stream", *videos, "--calib", calib, "--every-frame", "--record", out, "--json")
    assert result.status == 0, result.err
    frames, summary = lines(result.out)
    assert summary["frames"] == 3
    assert not any("unrectified" in warning for warning in frames[0]["warnings"])
    turned = true.rectify().rotations[0]
    found = []
    with open(out, "rb") as file:
        decoders = [ros2.DecoderFactory()]
        for _, _, _, message in reader.make_reader(file, decoder_factories=decoders).iter_decoded_messages(
            ["/stereo/points"]
        ):
            points = np.frombuffer(bytes(message.data), "<f4").reshape(-1, 4)[:, :3]
            found.append(float(np.median((points @ turned)[:, 2])))  # in the raw left camera's frame
    assert found == pytest.approx(depths, rel=0.03)


def test_every_sink_is_closed_whatever_happens(capsys: pytest.CaptureFixture[str]) -> None:
    class Broken:
        def __init__(self, error: BaseException | None) -> None:
            self.error = error

        def close(self) -> None:
            closed.append(self)
            if self.error is not None:
                raise self.error

    for errors in ((KeyboardInterrupt(), AnyNetError("lost"), None), (AnyNetError("lost"), KeyboardInterrupt(), None)):
        closed: list[Broken] = []
        with pytest.raises(KeyboardInterrupt), _completed() as sinks:
            sinks += [Broken(error) for error in errors]  # type: ignore[arg-type]
        assert closed == sinks
        assert capsys.readouterr().err == "anynet: lost\n"
