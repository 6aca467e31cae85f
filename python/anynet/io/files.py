"""Bytes to and from files, so that an error is one line and nothing half-written is ever left."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from anynet.errors import AnyNetError, one_line

MAX_PIXELS = 2**26  # 67 megapixels: larger than images of cameras, small enough to decode in seconds
MAX_TEXT = 2**24  # bytes
_UNFINISHED = ".{}.part"  # 16 hexadecimal digits


def max_pixels() -> int:
    """Most pixels that an image or map may have: `MAX_PIXELS`, or what the environment's ANYNET_MAX_PIXELS says.

    Raises:
        AnyNetError: if ANYNET_MAX_PIXELS is not a positive whole number.
    """
    text = os.environ.get("ANYNET_MAX_PIXELS")
    if text is None:
        return MAX_PIXELS
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) > 0):
        raise AnyNetError(f"expected ANYNET_MAX_PIXELS to be a positive whole number, got {text!r}")
    return int(text)


def check_size(path: str | os.PathLike[str], width: int, height: int) -> None:
    """Refuses what a header declares before memory is taken for it.

    Raises:
        AnyNetError: if there is no pixel, or there are more than `max_pixels`.
    """
    if min(width, height) < 1:
        raise AnyNetError(f"{path}: expected at least one pixel, got {width} x {height}")
    if width * height > max_pixels():
        raise AnyNetError(
            f"{path}: expected at most {max_pixels()} pixels, got {width} x {height}; "
            "ANYNET_MAX_PIXELS in the environment raises the limit"
        )


@contextmanager
def telling_damage(path: str | os.PathLike[str], what: str) -> Iterator[None]:
    """Makes any exception an AnyNetError of one line: a damaged file raises whatever its decoder meets first."""
    try:
        yield
    except AnyNetError:
        raise
    except Exception as error:
        raise AnyNetError(f"cannot read {path}: {what} ({one_line(error)})") from error


def check_regular(path: str | os.PathLike[str]) -> None:
    """For readers that open files themselves: to open a pipe may take for ever. What is missing they tell.

    Raises:
        AnyNetError: if it is a pipe, a socket or a device.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    _check_kind(path, mode)


def read_bytes(path: str | os.PathLike[str], limit: int | None = None) -> bytes:
    """The content of a regular file: devices and pipes, which may have no end, are refused.

    Args:
        path: the file.
        limit: most bytes that are read; by default 16 for each of `max_pixels`.

    Raises:
        AnyNetError: if there is no such file, it is of another kind or too large, or it cannot be read.
    """
    limit = limit or 16 * max_pixels()
    try:
        status = os.stat(path)
        _check_kind(path, status.st_mode)
        if status.st_size > limit:
            raise AnyNetError(f"cannot read {path}: expected at most {limit} bytes, got {status.st_size}")
        with open(path, "rb") as file:
            return file.read(status.st_size)
    except AnyNetError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise AnyNetError(f"cannot read {path}: {reason(error)}") from error


def read_text(path: str | os.PathLike[str]) -> str:
    """The content of a text file in UTF-8, with or without a byte-order mark.

    Raises:
        AnyNetError: as `read_bytes`, or if the file is not UTF-8.
    """
    data = read_bytes(path, MAX_TEXT)
    with telling_damage(path, "not a text in UTF-8"):
        return data.decode("utf-8-sig")


def write_atomically(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes `data` to `path`: afterwards the file is complete, or on an error as it was before.

    Raises:
        AnyNetError: if the file cannot be written, for example because the disk is full.
    """
    path = Path(path)
    try:
        unfinished = _unfinished(path)
        try:
            with open(unfinished, "xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        raise AnyNetError(f"cannot write {path}: {reason(error)}") from error


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """For writers that open files themselves: a path of the same name to write to, which then replaces `path`.

    Raises:
        AnyNetError: as `write_atomically`. `path` is then as it was before, as on errors of the writer.
    """
    path = Path(path)
    try:
        folder = _unfinished(path)
        folder.mkdir()
    except (OSError, ValueError) as error:
        raise AnyNetError(f"cannot write {path}: {reason(error)}") from error
    try:
        yield folder / path.name
        os.replace(folder / path.name, path)
    except OSError as error:
        raise AnyNetError(f"cannot write {path}: {reason(error)}") from error
    finally:
        shutil.rmtree(folder)


def _unfinished(path: Path) -> Path:
    return path.with_name(_UNFINISHED.format(secrets.token_hex(8)))  # same folder: the same disk


def remove_unfinished(folder: str | os.PathLike[str]) -> None:
    """Removes what writers that were killed left in a folder. Nobody may be writing there at the time."""
    for path in Path(folder).glob(_UNFINISHED.format("[0-9a-f]" * 16)):
        if path.is_dir():  # of `replacing`
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def make_folder(path: str | os.PathLike[str]) -> None:
    """Makes the folder and those above it, if missing.

    Raises:
        AnyNetError: if it cannot be made.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise AnyNetError(f"cannot make the folder {path}: {reason(error)}") from error


def check_output(path: str | os.PathLike[str]) -> None:
    """For long work that ends with writing a file: makes its folder, if missing, and tries to write there.

    Raises:
        AnyNetError: if the path is a folder, or its folder cannot be made or written to.
    """
    if os.path.isdir(path):
        raise AnyNetError(f"{path}: expected the name of a file, got a folder")
    folder = Path(path).parent
    make_folder(folder)
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise AnyNetError(f"cannot write {path}: {reason(error)}") from error


def reason(error: Exception) -> str:
    """Why a file failed: what the system says, or what the error says, on one line."""
    return error.strerror if isinstance(error, OSError) and error.strerror else one_line(error)


def _check_kind(path: str | os.PathLike[str], mode: int) -> None:
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        kind = "pipe" if stat.S_ISFIFO(mode) else "socket" if stat.S_ISSOCK(mode) else "device"
        raise AnyNetError(f"cannot read {path}: expected a file, got a {kind}")
