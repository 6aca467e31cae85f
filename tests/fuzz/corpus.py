"""Small valid files of every kind that the readers know, made here, to be damaged."""

from __future__ import annotations

import io
import json
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

Corpus = Callable[[], list[bytes]]


def _pixels(*shape: int, dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


RGB = Image.fromarray(_pixels(12, 17, 3))
GRAY, DEEP = Image.fromarray(_pixels(12, 17)), Image.fromarray(_pixels(12, 17, dtype=np.uint16))
PALETTE, RGBA = RGB.convert("P"), Image.fromarray(_pixels(12, 17, 4))
MAP = np.linspace(0.5, 190, 40, dtype=np.float32).reshape(5, 8)


def _saved(kind: str, *images: Image.Image, **options: object) -> list[bytes]:
    files = []
    for image in images:
        buffer = io.BytesIO()
        image.save(buffer, kind, **options)
        files.append(buffer.getvalue())
    return files


def _exif(orientation: int) -> bytes:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif.tobytes()


def _deep_color(ending: str) -> bytes:
    import cv2

    return bytes(cv2.imencode(ending, _pixels(12, 17, 3, dtype=np.uint16))[1])


def png() -> list[bytes]:
    files = _saved("PNG", RGB, GRAY, DEEP, PALETTE, RGBA, exif=_exif(6))
    files += _saved("PNG", PALETTE, transparency=bytes(range(256)))
    return [*files, *_saved("PNG", RGB, save_all=True, append_images=[RGB, RGB]), _deep_color(".png")]


def jpeg() -> list[bytes]:
    files = _saved("JPEG", RGB, GRAY, RGB.convert("CMYK"), exif=_exif(8))
    return [*files, *_saved("JPEG", RGB, progressive=True), *_saved("MPO", RGB, save_all=True, append_images=[RGB])]


def tiff() -> list[bytes]:
    files = _saved("TIFF", RGB, GRAY, DEEP, RGBA, exif=_exif(3))
    for compression in ("tiff_lzw", "tiff_deflate", "packbits", "jpeg"):
        files += _saved("TIFF", RGB, compression=compression)
    return [*files, *_saved("TIFF", RGB, save_all=True, append_images=[RGB]), _deep_color(".tiff")]


def webp() -> list[bytes]:
    files = _saved("WEBP", RGB, RGBA, lossless=True)
    return [*files, *_saved("WEBP", RGB), *_saved("WEBP", RGB, save_all=True, append_images=[GRAY, RGB], exif=_exif(5))]


def gif() -> list[bytes]:
    return [*_saved("GIF", RGB, GRAY), *_saved("GIF", RGB, save_all=True, append_images=[GRAY, RGB])]


def ppm() -> list[bytes]:
    gray, color, deep = _pixels(4, 6).tobytes(), _pixels(4, 6, 3).tobytes(), _pixels(4, 6, dtype=np.uint16).tobytes()
    return [
        b"P5\n6 4\n255\n" + gray,
        b"P5\n# of a camera\n6 4\n65535\n" + deep,
        b"P5 6 4 4095 " + deep,
        b"P6\n6 4\n255\n" + color,
        b"P6\n6 4\n65535\n" + 3 * deep,
        b"P2\n3 2\n9\n1 2 3\n4 5 6\n",
        b"P4\n8 2\nab",
        b"P1\n3 2\n101\n010\n",
    ]


def others() -> list[bytes]:
    files = []
    for kind in ("BMP", "TGA", "JPEG2000", "AVIF"):
        files += _saved(kind, RGB, GRAY)
    return [*files, *_saved("BMP", PALETTE), *_saved("TGA", RGBA, compression="tga_rle")]


def disparity_png() -> list[bytes]:
    return _saved("PNG", Image.fromarray(np.round(MAP * 256).astype(np.uint16)), GRAY, RGB)


def disparity_tiff() -> list[bytes]:
    image = Image.fromarray(MAP)
    return [*_saved("TIFF", image, DEEP), *_saved("TIFF", image, compression="tiff_lzw")]


def depth_png() -> list[bytes]:
    text = PngInfo()
    text.add_text("LevelsPerMeter", "1000")
    return [*_saved("PNG", Image.fromarray(np.round(MAP * 256).astype(np.uint16)), pnginfo=text), *disparity_png()]


def pfm() -> list[bytes]:
    values = MAP.tobytes()
    big = b"Pf\n# comment\n8 5\n0.004\n" + MAP.astype(">f4").tobytes()
    return [b"Pf\n8 5\n-1.0\n" + values, big, b"PF\n8 5\n-1\n" + 3 * values, b"Pf\r\n8 5\r\n-1.0\r\n" + values]


def npy() -> list[bytes]:
    arrays = [MAP, MAP.astype(np.float64), MAP.astype(">f2"), np.asfortranarray(MAP), MAP.astype(np.int16), MAP[0]]
    return [_numpy(np.save, array) for array in arrays]


def npz() -> list[bytes]:
    return [_numpy(np.savez_compressed, MAP), _numpy(np.savez, MAP), _numpy(np.savez, MAP, MAP)]


def _numpy(save: Callable[..., None], *arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    save(buffer, *arrays)
    return buffer.getvalue()


def csv() -> list[bytes]:
    return [
        b"left,right\na.png,b.png\n",
        b"\xef\xbb\xbfleft,right,disparity\r\na.png,b.png,c.pfm\r\n,,\r\n",
        b'left,right,depth,calibration\n"a, 1.png",b.png,d.tiff,calib.txt\n',
    ]


def split() -> list[bytes]:
    return [b"000000_10.png\n000001_10\n\n000002 more\n"]


def rendered() -> list[bytes]:
    record = np.zeros((), [("left", "u1", (2, 3, 3)), ("right", "u1", (2, 3, 3)), ("disparity", "<u2", (2, 2, 3)),
                           ("occluded", "?", (2, 2, 3))])  # fmt: skip
    return [_numpy(np.save, record)]


def recipe() -> list[bytes]:
    from anynet.training.recipe import PRESETS

    return [preset.to_json().encode() for preset in PRESETS.values()]


def kitti_calibration() -> list[bytes]:
    numbers = "721.5377 0 609.5593 {} 0 721.5377 172.854 0.2163791 0 0 1 0.002745884"
    left, right = numbers.format(44.85728), numbers.format(-339.5242)
    raw = f"calib_time: 09-Jan-2012\nS_rect_02: 1.242e+03 3.75e+02\nP_rect_02: {left}\nP_rect_03: {right}\n"
    return [raw.encode(), f"P0: {left}\nP1: {right}\nP2: {left}\nP3: {right}\nR0_rect: 1 0 0 0 1 0 0 0 1\n".encode()]


def middlebury_calibration() -> list[bytes]:
    return [
        b"cam0=[994.978 0 311.193; 0 994.978 254.877; 0 0 1]\ncam1=[994.978 0 342.279; 0 994.978 254.877; 0 0 1]\n"
        b"doffs=31.086\nbaseline=193.001\nwidth=741\nheight=500\nndisp=70\nisint=0\nvmin=5\nvmax=60\n"
    ]


def opencv_calibration(ending: str) -> Corpus:
    def files() -> list[bytes]:
        import cv2

        q = np.array([[1, 0, 0, -311.193], [0, 1, 0, -254.877], [0, 0, 0, 994.978], [0, 0, 1 / 0.193001, -161.067]])
        p = np.array([[994.978, 0, 311.193, 0], [0, 994.978, 254.877, 0], [0, 0, 1, 0]])
        shift = np.zeros((3, 4))
        shift[0, 3] = -994.978 * 0.193001
        matrices: list[dict[str, np.ndarray]] = [
            {"Q": q},
            {"P1": p, "P2": p + shift},
            {"K1": p[:, :3], "D1": np.zeros((1, 5)), "K2": p[:, :3], "D2": np.zeros((1, 5)), "R": np.eye(3),
             "T": np.array([[-0.193001], [0], [0]])},
        ]  # fmt: skip
        result = []
        for named in matrices:
            storage = cv2.FileStorage(ending, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
            for name, matrix in named.items():
                storage.write(name, matrix)
            result.append(storage.releaseAndGetString().encode())
        return result

    return files


def _matrix(name: str, values: object) -> str:
    array = np.asarray(values, float)
    rows, columns = array.shape
    data = ", ".join(map(str, array.ravel()))
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [{data}]\n"


_K = [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]


def json_calibrations() -> list[bytes]:
    """DepthAI's, RealSense's, and OpenCV's values as JSON."""
    turn = np.eye(3).tolist()

    def camera(x: float, target: int) -> dict[str, object]:
        place = {"rotationMatrix": turn, "translation": {"x": x, "y": 0, "z": 0}, "toCameraSocket": target}
        return {"cameraType": 0, "width": 1280, "height": 800, "intrinsicMatrix": _K, "distortionCoeff": 14 * [0.1],
                "extrinsics": place}  # fmt: skip

    depthai = {"cameraData": [[0, camera(0, -1)], [1, camera(-7.5, 2)], [2, camera(3.75, 0)]],
               "stereoRectificationData": {"leftCameraSocket": 1, "rightCameraSocket": 2}}  # fmt: skip
    infrared = {"width": 848, "height": 480, "fx": 420.0, "fy": 420.0, "ppx": 422.0, "ppy": 240.0, "coeffs": 5 * [0]}
    realsense = {"infrared1": infrared, "infrared2": infrared, "extrinsics": {"translation": [-0.05, 0, 0]}}
    opencv = {"left": {"K": _K, "D": [[-0.2, 0.05, 0, 0, 0]]}, "right": {"K": _K, "D": [[-0.2, 0.05, 0, 0, 0]]},
              "R": turn, "T": [-0.12, 0, 0], "imageSize": [640, 480], "unit": "m"}  # fmt: skip
    return [json.dumps(one).encode() for one in (depthai, realsense, opencv)]


def robots_calibrations() -> list[bytes]:
    """Kalibr's, and ORB-SLAM's of both kinds."""
    camera = "  camera_model: pinhole\n  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]\n"
    camera += "  distortion_model: radtan\n  intrinsics: [455.1, 454.3, 366.0, 247.7]\n  resolution: [752, 480]\n"
    pose = np.eye(4)
    pose[0, 3] = -0.11
    kalibr = f"cam0:\n{camera}cam1:\n  T_cn_cnm1:\n" + "".join(f"  - {row}\n" for row in pose.tolist()) + camera
    center = "Camera.fx: 435.2\nCamera.fy: 435.2\nCamera.cx: 367.4\nCamera.cy: 252.2\n"
    rectifying = f"%YAML:1.0\n{center}Camera.bf: 47.9\n"
    for side, along in (("LEFT", 0.0), ("RIGHT", -47.9)):
        rectifying += f"{side}.height: 480\n{side}.width: 752\n" + _matrix(f"{side}.D", [[-0.28, 0.07, 0, 0, 0]])
        rectifying += _matrix(f"{side}.K", _K) + _matrix(f"{side}.R", np.eye(3))
        rectifying += _matrix(f"{side}.P", [[435.2, 0, 367.4, along], [0, 435.2, 252.2, 0], [0, 0, 1, 0]])
    third = '%YAML:1.0\nCamera.type: "PinHole"\nCamera.width: 752\nCamera.height: 480\n'
    third += "".join(center.replace("Camera.", f"Camera{i}.") + f"Camera{i}.k1: 0.01\n" for i in (1, 2))
    return [text.encode() for text in (kalibr, rectifying, third + _matrix("Stereo.T_c1_c2", -pose + 2 * np.eye(4)))]


def zed_calibration() -> list[bytes]:
    text = "[STEREO]\nBaseline=119.9\nTY=0.1\nTZ=0.2\nCV_HD=0.02\nRX_HD=-0.003\nRZ_HD=-0.001\n"
    for side in ("LEFT", "RIGHT"):
        text += f"[{side}_CAM_HD]\nfx=700\nfy=700\ncx=630\ncy=350\nk1=-0.17\nk2=0.02\n"
    return [text.encode()]


def numbers_calibration() -> list[bytes]:
    odometry = "718.8 0 607.1 {} 0 718.8 185.2 0 0 0 1 0\n"
    return [b"994.9 0 311.1\n0 994.9 254.8\n0 0 1\n0.193\n", (odometry.format(0) + odometry.format(-386.1)).encode()]


def _camera_info(along: float) -> bytes:
    return (
        "image_width: 640\nimage_height: 480\ncamera_name: one\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0, 0, 0, 0]}\n"
        "rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
        f"projection_matrix: {{rows: 3, cols: 4, data: [480, 0, 325, {along}, 0, 480, 238, 0, 0, 0, 1, 0]}}\n"
    ).encode()


def ros_left() -> list[bytes]:
    message = "height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- -0.1\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n"
    message += f"k: {np.ravel(_K).tolist()}\nr: {np.eye(3).ravel().tolist()}\n"
    message += "p: [480.0, 0.0, 325.0, 0.0, 0.0, 480.0, 238.0, 0.0, 0.0, 0.0, 1.0, 0.0]\n---\n"
    return [_camera_info(0), message.encode()]


def ros_right() -> dict[str, bytes]:
    return {"right.yaml": _camera_info(-48)}


def _sensor(x: float) -> bytes:
    return (
        "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
        f"  data: [1.0, 0.0, 0.0, {x}, 0.0, 1.0, 0.0, 0.02, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]\n"
        "resolution: [752, 480]\ncamera_model: pinhole\nintrinsics: [458.654, 457.296, 367.215, 248.375]\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 1.76e-05]\n"
    ).encode()


def euroc_left() -> list[bytes]:
    return [_sensor(0.05)]


def euroc_right() -> dict[str, bytes]:
    return {"sensor.yaml": _sensor(0.16)}


def vins() -> list[bytes]:
    """The file of the rig, and one of a camera."""
    left, right = np.eye(4), np.eye(4)
    right[0, 3] = 0.11
    named = "%YAML:1.0\n---\ncam0_calib: cam0.yaml\ncam1_calib: cam1.yaml\n"
    return [(named + _matrix("body_T_cam0", left) + _matrix("body_T_cam1", right)).encode(), *vins_cameras().values()]


@cache
def vins_cameras() -> dict[str, bytes]:
    pinhole = "%YAML:1.0\n---\nmodel_type: PINHOLE\nimage_width: 752\nimage_height: 480\n"
    pinhole += "distortion_parameters:\n   k1: -0.29\n   k2: 0.08\n   p1: 0.0\n   p2: 0.0\n"
    pinhole += "projection_parameters:\n   fx: 461.1\n   fy: 459.7\n   cx: 362.6\n   cy: 248.5\n"
    return {f"cam{i}.yaml": pinhole.encode() for i in (0, 1)}


def recording(ending: str) -> Corpus:
    """Two pairs of images, of both kinds of message, with camera_info; and in compressed blocks."""
    blocks = {".bag": ["bz2", "lz4"], ".mcap": ["storage"]}.get(ending, [])
    kinds = [(False, ""), (True, ""), *((False, compression) for compression in blocks)]
    return lambda: [_recording(ending, compressed, compression) for compressed, compression in kinds]


@cache
def _recording(ending: str, compressed: bool, compression: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"one{ending if ending != '.db3' else ''}"
        _write(path, compressed, compression)
        return (path if path.is_file() else next(path.glob("*.db3"))).read_bytes()


def metadata() -> list[bytes]:
    """Of bags that are folders, plain and compressed."""
    return [data for name, data in _bags().items() if name.endswith(".yaml")]


def bagged() -> dict[str, bytes]:
    """What lies beside the metadata."""
    return {name: data for name, data in _bags().items() if not name.endswith(".yaml")}


@cache
def _bags() -> dict[str, bytes]:
    files = {}
    with tempfile.TemporaryDirectory() as folder:
        for compression in ("", "message", "file"):
            path = Path(folder) / f"bag{compression}"
            _write(path, False, compression)
            for file in path.iterdir():
                files[f"{path.name}.yaml" if file.suffix == ".yaml" else file.name] = file.read_bytes()
    return files


def _write(path: Path, compressed: bool, compression: str) -> None:
    from bags import START, BagWriter

    with BagWriter(path, compression) as bag:
        for side, along in (("left", 0.0), ("right", -48.0)):
            matrix = np.array([[480, 0, 8, along], [0, 480, 4, 0], [0, 0, 1, 0]])
            bag.camera_info(f"/{side}/camera_info", (17, 12), matrix[:, :3], 5 * [0.0], np.eye(3), matrix)
            for number in range(2):
                write = bag.compressed if compressed else bag.image
                write(f"/{side}/image_raw" + compressed * "/compressed", _pixels(12, 17, 3), START + number * 10**8)


def confidence() -> list[bytes]:
    from anynet.checkpoint import PACKAGED

    return [file.read_bytes() for file in sorted(PACKAGED.glob("*.confidence.json"))]


@cache
def _checkpoint() -> bytes:
    from anynet import AnyNet, AnyNetConfig, save_checkpoint

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weights.safetensors"
        save_checkpoint(path, AnyNet(AnyNetConfig()))
        return path.read_bytes()


def safetensors() -> list[bytes]:
    """The header is what is worth damaging: some files have little else."""
    return [_checkpoint(), _header(_checkpoint())]


def baseline_checkpoint() -> list[bytes]:
    return [_baseline_checkpoint(), _header(_baseline_checkpoint())]


def _header(whole: bytes) -> bytes:
    return whole[: 8 + struct.unpack("<Q", whole[:8])[0]]


@cache
def _baseline_checkpoint() -> bytes:
    from anynet import save_checkpoint
    from anynet.baselines.model import BaselineConfig, BaselineModel

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weights.safetensors"
        save_checkpoint(path, BaselineModel(BaselineConfig(model="stereonet-8x")))
        return path.read_bytes()


def pickled() -> list[bytes]:
    import torch

    state = {"state_dict": {"module.feature_extraction.block0.0.0.weight": torch.zeros(1, 3, 3, 3)}, "epoch": 1}
    files = []
    for new in (True, False):
        buffer = io.BytesIO()
        torch.save(state, buffer, _use_new_zipfile_serialization=new)
        files.append(buffer.getvalue())
    return files
