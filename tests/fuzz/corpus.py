"""Small valid files of every kind that the readers know, made here, to be damaged."""

from __future__ import annotations

import io
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

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


@cache
def _checkpoint() -> bytes:
    from anynet import AnyNet, AnyNetConfig, save_checkpoint

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weights.safetensors"
        save_checkpoint(path, AnyNet(AnyNetConfig()))
        return path.read_bytes()


def safetensors() -> list[bytes]:
    """The header is what is worth damaging: some files have little else."""
    whole = _checkpoint()
    header = whole[: 8 + struct.unpack("<Q", whole[:8])[0]]
    return [whole, header]


def pickled() -> list[bytes]:
    import torch

    state = {"state_dict": {"module.feature_extraction.block0.0.0.weight": torch.zeros(1, 3, 3, 3)}, "epoch": 1}
    files = []
    for new in (True, False):
        buffer = io.BytesIO()
        torch.save(state, buffer, _use_new_zipfile_serialization=new)
        files.append(buffer.getvalue())
    return files
