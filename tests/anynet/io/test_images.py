from __future__ import annotations

import io
import resource
import struct
import time
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from anynet.errors import AnyNetError
from anynet.io import images, read_image, read_pair, write_image
from anynet.io.images import endings, image_size, open_image, to_8_bits

RGB = np.random.default_rng(0).integers(0, 256, (7, 9, 3), dtype=np.uint8)


def save(path: Path, array: np.ndarray, mode: str | None = None) -> Path:
    image = Image.fromarray(array)
    (image.convert(mode) if mode else image).save(path)
    return path


@pytest.fixture(autouse=True)
def _no_unexpected_warnings() -> None:
    warnings.simplefilter("error")


@pytest.mark.parametrize("ending", ["png", "bmp", "ppm", "tiff"])
def test_rgb_comes_back(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"image.{ending}"
    write_image(path, RGB)
    read = read_image(path)
    assert read.dtype == np.uint8
    np.testing.assert_array_equal(read, RGB)
    read[0] = 0  # not a read-only view


def test_gray_is_repeated(tmp_path: Path) -> None:
    read = read_image(save(tmp_path / "gray.png", RGB[..., 0]))
    np.testing.assert_array_equal(read, RGB[..., :1].repeat(3, 2))


def test_palette_gives_its_colors(tmp_path: Path) -> None:
    path = save(tmp_path / "palette.png", RGB // 128 * 255, "P")
    with Image.open(path) as image:
        assert image.mode == "P"
        expected = np.array(image.convert("RGB"))
    np.testing.assert_array_equal(read_image(path), expected)


@pytest.mark.parametrize("channels", [2, 4])
def test_alpha_is_dropped_with_a_warning(tmp_path: Path, channels: int) -> None:
    image = np.dstack([RGB, np.full(RGB.shape[:2], 7, np.uint8)]) if channels == 4 else RGB[..., :2].copy()
    path = save(tmp_path / "alpha.png", image)
    with pytest.warns(UserWarning, match=r"alpha\.png: the alpha channel is ignored"):
        read = read_image(path)
    np.testing.assert_array_equal(read, RGB if channels == 4 else RGB[..., :1].repeat(3, 2))


@pytest.mark.parametrize("ending", ["png", "tiff"])
def test_16_bit_gray_is_scaled(tmp_path: Path, ending: str) -> None:
    values = np.array([[0, 128, 129, 257, 32896, 65535]], np.uint16)
    read = read_image(save(tmp_path / f"deep.{ending}", values))
    np.testing.assert_array_equal(read[..., 1], [[0, 0, 1, 1, 128, 255]])


def test_16_bit_color_is_scaled(tmp_path: Path) -> None:
    path = tmp_path / "deep.png"
    cv2.imwrite(str(path), RGB[..., ::-1].astype(np.uint16) * 257)
    np.testing.assert_array_equal(read_image(path), RGB)


def test_floating_point_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "float.tiff", np.ones((3, 3), np.float32))
    with pytest.raises(AnyNetError, match="expected an image of 8 or 16 bits per channel, got 32"):
        read_image(path)


def test_16_bits_that_pillow_takes_for_8_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "planes.tiff"
    tifffile.imwrite(path, np.zeros((3, 4, 5), np.uint16), photometric="rgb", planarconfig="separate")
    with pytest.raises(AnyNetError, match="expected 16-bit colors pixel by pixel, not plane by plane"):
        read_image(path)
    tifffile.imwrite(path, np.arange(60, dtype=np.uint8).reshape(3, 4, 5), photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(read_image(path), np.arange(60).reshape(3, 4, 5).transpose(1, 2, 0))
    path = tmp_path / "alpha.png"
    path.write_bytes(_png(4, 3, 16, color=4))
    with pytest.raises(AnyNetError, match="expected 16-bit gray without an alpha channel"):
        read_image(path)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"cannot read .*none\.png: No such file"):
        read_image(tmp_path / "none.png")
    with pytest.raises(AnyNetError, match="Is a directory"):
        read_image(tmp_path)


def test_something_else_is_not_an_image(tmp_path: Path) -> None:
    path = tmp_path / "text.png"
    path.write_text("not an image")
    with pytest.raises(AnyNetError, match="not an image of a known format"):
        read_image(path)


def test_a_truncated_png_is_told_wherever_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "whole.png"
    write_image(path, RGB)
    data = path.read_bytes()
    pixels_end = data.index(b"IEND") - 12  # behind the pixels: two checksums and the empty last chunk
    for length in range(pixels_end):
        path.write_bytes(data[:length])
        with pytest.raises(AnyNetError, match=r"cannot read .*whole\.png: "):
            read_image(path)


def test_a_damaged_png_is_an_error_or_an_image(tmp_path: Path) -> None:
    """Never another exception, whatever the decoder stumbles over."""
    path = tmp_path / "damaged.png"
    write_image(path, RGB)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    errors = 0
    for _ in range(300):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            assert read_image(path).ndim == 3
        except AnyNetError:
            errors += 1
    assert errors > 250


def test_a_pair_has_one_size(tmp_path: Path) -> None:
    write_image(tmp_path / "left.png", RGB)
    write_image(tmp_path / "right.png", RGB[:, 1:])
    with pytest.raises(AnyNetError, match="expected two images of one size, got 9 x 7 and 8 x 7"):
        read_pair(tmp_path / "left.png", tmp_path / "right.png")


def test_an_unknown_ending_is_told(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected a name ending like an image format"):
        write_image(tmp_path / "image.xyz", RGB)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("kind", ["gray.png", "gray.tiff", "gray.pgm", "color.png", "color.tiff", "color.ppm"])
def test_pairs_of_few_of_16_bits_keep_their_levels(tmp_path: Path, kind: str, bits: int) -> None:
    """Machine cameras write 10 or 12 bits into 16: divided by 257, 17 levels would be left of 256."""
    first = np.arange(256, dtype=np.uint16).reshape(8, 32) << (bits - 8)
    second = first // 2  # alone it would be scaled otherwise
    paths = tmp_path / f"left_{kind}", tmp_path / f"right_{kind}"
    for path, image in zip(paths, (first, second), strict=True):
        assert cv2.imwrite(str(path), image if kind.startswith("gray") else np.dstack([image, image // 2, image]))
    left, right = read_pair(*paths)
    assert np.abs(left[..., 0].astype(int) - np.arange(256).reshape(8, 32)).max() <= 1
    assert np.abs(right[..., 0].astype(int) - np.arange(256).reshape(8, 32) / 2).max() <= 1.5
    if kind.startswith("color"):
        assert np.abs(left[..., 1].astype(int) - np.arange(256).reshape(8, 32) / 2).max() <= 1.5


def test_one_image_of_few_of_16_bits(tmp_path: Path) -> None:
    path = save(tmp_path / "dark.png", np.full((2, 2), 4095, np.uint16))
    with pytest.warns(UserWarning, match=r"dark\.png: uses 12 of its 16 bits"):
        assert read_image(path).max() == 16
    assert read_image(path, bits=12).min() == 255
    with pytest.raises(AnyNetError, match="expected bits from 8 to 16, got 17"):
        read_image(path, bits=17)


@pytest.mark.parametrize(("magic", "channels"), [("P5", 1), ("P6", 3)])
@pytest.mark.parametrize("maximum", [1, 100, 255, 1023, 4095, 65535])
def test_the_maximum_of_pgm_and_ppm(tmp_path: Path, magic: str, channels: int, maximum: int) -> None:
    stored = np.linspace(0, maximum, 6 * channels).round().astype(">u2" if maximum > 255 else "u1")
    path = tmp_path / "image.ppm"
    path.write_bytes(f"{magic}\n# a comment\n3 2\n{maximum}\n".encode() + stored.tobytes())
    expected = np.broadcast_to(np.round(stored * (255 / maximum)).reshape(2, 3, channels), (2, 3, 3))
    assert np.abs(read_image(path).astype(int) - expected).max() <= 1
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(AnyNetError, match=r"image\.ppm: expected \d+ bytes of pixels, got \d+"):
        read_image(path)


@pytest.mark.parametrize("ending", ["jpg", "png", "tiff", "webp", "deep.png", "deep.tiff"])
@pytest.mark.parametrize("orientation", range(10))
def test_exif_orientation_is_applied_as_viewers_do(tmp_path: Path, ending: str, orientation: int) -> None:
    path = tmp_path / f"turned.{ending}"
    exif = Image.Exif()
    exif[0x0112] = orientation
    smooth = np.add.outer(10 * np.arange(8), np.arange(16)).astype(np.uint8)  # survives JPEG
    rgb = np.dstack([smooth, smooth // 2, 255 - smooth])
    if ending.startswith("deep"):
        kind = ending.split(".")[1]
        data = cv2.imencode(f".{kind}", rgb[..., ::-1].astype(np.uint16) * 16)[1].tobytes()
        path.write_bytes(
            _png_with(data, b"eXIf", exif.tobytes()[6:]) if kind == "png" else _turned_tiff(data, orientation)
        )
    else:
        Image.fromarray(rgb).save(path, exif=exif, **({"lossless": True} if ending == "webp" else {"quality": 100}))
    plain = Image.fromarray(rgb)
    plain.getexif()[0x0112] = orientation
    expected = np.asarray(ImageOps.exif_transpose(plain))
    read = read_pair(path, path)[0]
    assert read.shape == expected.shape
    assert np.abs(read.astype(int) - expected).max() <= {"jpg": 16, "deep.png": 1, "deep.tiff": 1}.get(ending, 0)
    assert open_image(path).size == expected.shape[1::-1]


def _png_with(data: bytes, kind: bytes, content: bytes) -> bytes:
    """The PNG with a chunk more, behind its pixels."""
    chunk = struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    return data[:-12] + chunk + data[-12:]


def _turned_tiff(data: bytes, orientation: int) -> bytes:
    """The little-endian TIFF with an entry for its orientation; the directory moves to the end."""
    place = struct.unpack_from("<I", data, 4)[0]
    count = struct.unpack_from("<H", data, place)[0]
    entries = [data[place + 2 + 12 * i : place + 14 + 12 * i] for i in range(count)]
    entries = [entry for entry in entries if entry[:2] != b"\x12\x01"]
    entries = sorted([*entries, struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0)], key=lambda e: e[1::-1])
    directory = struct.pack("<H", len(entries)) + b"".join(entries) + bytes(4)
    return data[:4] + struct.pack("<I", len(data)) + data[8:] + directory


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)


def _animated_webp(width: int, height: int) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(RGB).save(buffer, "WEBP", lossless=True)
    size = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    frame = bytes(6) + bytes((8, 0, 0, 6, 0, 0)) + bytes(4) + buffer.getvalue()[12:]
    body = (
        b"WEBP" + _chunk(b"VP8X", bytes((2, 0, 0, 0)) + size) + _chunk(b"ANIM", bytes(6)) + 90 * _chunk(b"ANMF", frame)
    )
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _png(width: int, height: int, depth: int = 1, color: int = 0) -> bytes:
    data = b"\x89PNG\r\n\x1a\n"
    pixels = zlib.compress(bytes(min(10**7, (1 + (color // 4 + 1) * width * depth // 8) * height)))
    for name, content in (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)), (b"IDAT", pixels), (b"IEND", b""),
    ):  # fmt: skip
        data += struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
    return data


def _gif(width: int, height: int) -> bytes:
    return b"GIF89a" + struct.pack("<HH", width, height) + b"\x80\0\0" + bytes(6) + b"," + bytes(4) + struct.pack(
        "<HHB", width, height, 0
    ) + b"\x02\x02\x44\x01\0;"  # fmt: skip


@pytest.mark.parametrize(
    "data",
    [
        _animated_webp(8192037, 19),  # a 4 KB file that took a minute and 3 GB
        _png(30_000, 5_000),
        _png(10**6, 10**6),
        _gif(60_000, 2_000),
        b"P5\n90000 90000\n255\n",
        b"P6\n9999999999 9999999999\n65535\n",
        b"P4\n100000 100000\n",
        b"BM" + struct.pack("<IHHIIiiHHIIiiII", 54, 0, 0, 54, 40, 90_000, 90_000, 1, 24, 0, 0, 0, 0, 0, 0),
    ],
    ids=["webp", "png", "larger png", "gif", "pgm", "ppm", "pbm", "bmp"],
)
def test_declared_sizes_are_refused_before_memory_is_taken(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "bomb"
    path.write_bytes(data)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow's, of its own limit
        for read in (read_image, open_image, image_size):
            with pytest.raises(AnyNetError, match=r"bomb: expected at most 67108864 pixels"):
                read(path)
    assert time.process_time() - start < 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KB


def _rle_bmp(width: int, height: int) -> bytes:
    """Gray, run-length encoded: of every row only its first pixel."""
    palette = b"".join(bytes((level, level, level, 0)) for level in range(256))
    pixels = height * b"\x01\x50\x00\x00" + b"\x00\x01"
    start = 54 + len(palette)
    sizes = struct.pack("<IHHI", start + len(pixels), 0, 0, start)
    header = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 8, 1, len(pixels), 0, 0, 256, 0)
    return b"BM" + sizes + header + palette + pixels


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (_animated_webp(4194321, 12), "expected at most 1048576 columns, got 4194321 x 12 pixels"),  # took 7 seconds
        (b"P6\n1048577 1\n255\n", "expected at most 1048576 columns, got 1048577 x 1 pixels"),
        (_rle_bmp(8000, 8000), "expected no compression in a BMP of this size"),  # took 12 seconds
    ],
    ids=["webp", "ppm", "bmp"],
)
def test_what_pillow_is_slow_at_is_refused(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "image"
    path.write_bytes(data)
    start = time.process_time()
    with pytest.raises(AnyNetError, match=f"image: {message}"):
        read_image(path)
    assert time.process_time() - start < 1


def test_every_decoder_in_python_has_a_limit() -> None:
    endings()  # loads the formats; others may have been loaded by others
    ours = {f"PIL.{name}ImagePlugin" for name in images._PLUGINS}
    assert set(images._SLOW) == {name for name, kind in Image.DECODERS.items() if kind.__module__ in ours}


def test_a_compressed_bmp(tmp_path: Path) -> None:
    path = tmp_path / "image.bmp"
    path.write_bytes(_rle_bmp(9, 7))
    image = read_image(path)
    assert image.shape == (7, 9, 3)
    assert (image[:, 0] == 0x50).all()
    assert not image[:, 1:].any()


@pytest.mark.parametrize("depth", [1, 8, 16])
def test_a_png_of_fewer_bytes_than_its_pixels_take(tmp_path: Path, depth: int) -> None:
    """Its stream may end early without an error, and would be an image of mostly nothing."""
    path = tmp_path / "image.png"
    data = _png(8, 8, depth)
    path.write_bytes(data)
    assert read_image(path, bits=16).shape == (8, 8, 3)
    path.write_bytes(_with_size(data, 8000, 8000))
    with pytest.raises(AnyNetError, match=f"expected more than {len(data)} bytes for 8000 x 8000 pixels"):
        read_image(path)


def _with_size(png: bytes, width: int, height: int) -> bytes:
    header = b"IHDR" + struct.pack(">II", width, height) + png[24:29]
    return png[:12] + header + struct.pack(">I", zlib.crc32(header)) + png[33:]


def test_tall_images_of_16_bits_take_no_longer_than_wide_ones() -> None:
    levels = np.arange(2**20, dtype=np.uint16)
    start = time.process_time()
    tall = to_8_bits(levels[:, None], 16)
    assert time.process_time() - start < 0.5  # row by row, two seconds
    np.testing.assert_array_equal(tall[:, 0], to_8_bits(levels[None], 16)[0])


def test_an_option_raises_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "image.png"
    write_image(path, RGB)
    monkeypatch.setenv("ANYNET_MAX_PIXELS", "62")
    with pytest.raises(AnyNetError, match="expected at most 62 pixels, got 9 x 7; ANYNET_MAX_PIXELS"):
        read_image(path)
    monkeypatch.setenv("ANYNET_MAX_PIXELS", "63")
    assert read_image(path).shape == (7, 9, 3)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)  # Pillow's own limit follows
    assert read_image(path).shape == (7, 9, 3)


def test_only_the_first_frame_of_an_animation(tmp_path: Path) -> None:
    frames = [Image.fromarray(np.full((8, 8, 3), level, np.uint8)) for level in (10, 200, 90)]
    for ending in ("gif", "webp", "png", "tiff"):
        path = tmp_path / f"animation.{ending}"
        frames[0].save(
            path, save_all=True, append_images=frames[1:], **({"lossless": True} if ending == "webp" else {})
        )
        assert (read_image(path) == 10).all()


def test_a_jpeg_of_many_scans_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each scan, of a few bytes, costs as much as decoding all pixels."""
    path = tmp_path / "scans.jpg"
    Image.fromarray(RGB).save(path, progressive=True)
    data = path.read_bytes()
    last = data[data.rindex(b"\xff\xda") : -2]
    path.write_bytes(data[:-2] + 500 * last + data[-2:])
    monkeypatch.setenv("ANYNET_MAX_PIXELS", "1000")
    with pytest.raises(AnyNetError, match=r"scans\.jpg: expected a JPEG of 9 x 7 pixels to have fewer scans"):
        read_image(path)


def test_damage_beyond_the_decoder_is_told(tmp_path: Path) -> None:
    """Pillow converts a palette with a damaged tRNS chunk, of more entries than it has, by an assertion."""
    path = tmp_path / "palette.png"
    Image.fromarray(RGB).convert("P").save(path, transparency=bytes(range(256)))
    data = path.read_bytes()
    place = data.index(b"tRNS")
    for length in (0, 1, 257, 300):
        content = b"tRNS" + bytes(length)
        chunk = struct.pack(">I", length) + content + struct.pack(">I", zlib.crc32(content))
        path.write_bytes(data[: place - 4] + chunk + data[place + 264 :])
        try:
            assert read_image(path).shape == RGB.shape
        except AnyNetError:
            continue  # and nothing else


@pytest.mark.parametrize("failure", [AssertionError(), MemoryError(), RecursionError("a\nb"), ZeroDivisionError("x")])
@pytest.mark.parametrize("step", ["open", "getexif", "load", "convert"])
def test_whatever_pillow_raises_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, failure: Exception
) -> None:
    def fail(*arguments: object, **options: object) -> None:
        raise failure

    path = tmp_path / "image.png"
    write_image(path, RGB)
    monkeypatch.setattr(Image if step == "open" else Image.Image, step, fail)
    if step == "load":
        monkeypatch.setattr("PIL.ImageFile.ImageFile.load", fail)
    if step == "getexif":
        assert read_image(path).shape == RGB.shape  # metadata alone are damaged
        return
    with pytest.raises(AnyNetError, match=rf"^cannot read {path}: damaged image \([^\n]+\)$"):
        read_image(path)


def test_formats_that_start_programs_are_none_of_ours(tmp_path: Path) -> None:
    path = tmp_path / "drawing.png"
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 7\n%%EndComments\n")
    with pytest.raises(AnyNetError, match="not an image of a known format"):
        read_image(path)
    assert {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".ppm", ".bmp", ".webp"} <= endings()
    assert not {".eps", ".pdf", ".mpg"} & endings()


def test_a_size_that_the_format_does_not_hold(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"cannot write .*wide\.webp: "):
        write_image(tmp_path / "wide.webp", np.zeros((1, 20_000, 3), np.uint8))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("length", [0x0004DF49, 0x72D7ACDF, 0x80000000, 0xFFFFFFFF])
def test_a_chunk_longer_than_its_file(tmp_path: Path, length: int) -> None:
    """In 16-bit colors: OpenCV took the memory, up to 4 GB, for a file of 1 KB."""
    path = tmp_path / "deep.png"
    data = cv2.imencode(".png", RGB.astype(np.uint16) * 257)[1].tobytes()
    path.write_bytes(data[:33] + struct.pack(">I", length) + data[37:])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        assert read_image(path).shape == RGB.shape
    except AnyNetError as error:
        assert "deep.png" in str(error)  # noqa: PT017
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KB
