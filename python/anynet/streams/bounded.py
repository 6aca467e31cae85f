"""Bounds for `rosbags`, which believes what is written in a file: of memory, of time, and of what it unpacks."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from anynet.io.files import check_regular, max_pixels

_BYTES = 8  # of a pixel: RGB of 16 bits, and what else the block holds
_RATIO = 32  # of a bag's files unpacked; images with noise in them give 1 to 3
_METADATA = 2**20  # bytes; read at 0.1 MB/s
_STEPS = 2 * 10**7  # of SQLite's machine, which take a second, and
_STEPS_PER_BYTE = 20  # of the file; a message has more than 50 bytes, and is looked at in some hundred steps
_left: ContextVar[int | None] = ContextVar("bytes to which the files of what is being opened may unpack", default=None)


class BoundedPath(type(Path())):  # type: ignore[misc]
    """A path; a file opened from it for reading bytes asks for no more than its size, whatever it is asked for."""

    def open(self, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        file = super().open(mode, *args, **kwargs)
        return _Bounded(file.detach()) if mode == "rb" else file


class _Bounded(io.BufferedReader):
    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(size if size is None else min(size, os.fstat(self.fileno()).st_size))


@contextmanager
def opening(path: Path) -> Iterator[None]:
    """While a recording is being opened: bounds of what it unpacks, and no time for what is not needed of it.

    Raises:
        AnyNetError: if one of its files is a pipe, a socket or a device.
        ValueError: if the metadata of a folder are too large, or its files unpack to more than 32 times their size and
            16 bytes for each of `max_pixels`.
    """
    files = list(path.iterdir()) if path.is_dir() else [path]
    for file in files:
        check_regular(file)
        if file.name == "metadata.yaml" and file.stat().st_size > _METADATA:
            raise ValueError(f"expected metadata.yaml of at most {_METADATA} bytes, got {file.stat().st_size}")
    size = sum(file.stat().st_size for file in files if file.is_file())
    token = _left.set(max(_RATIO * size, 16 * max_pixels()))
    try:
        yield
    finally:
        _left.reset(token)


def bounded(decompressor: Callable[[], Any]) -> Callable[..., bytes]:
    """A function from a compressed block to its bytes; ValueError if there are more than images may take.

    Args:
        decompressor: makes an object of `bz2.BZ2Decompressor`'s interface.
    """

    def decompress(data: bytes, *_: Any) -> bytes:
        most = _BYTES * max_pixels()
        block = decompressor()
        result: bytes = block.decompress(data, max_length=most + 1)
        if len(result) > most:
            raise ValueError(f"expected blocks of at most {most} bytes; ANYNET_MAX_PIXELS raises the limit")
        if not block.eof or block.unused_data:
            raise ValueError(f"expected one compressed block, got {len(data)} bytes that are not one")
        return result

    return decompress


@cache
def bound_rosbags() -> None:
    """Has `rosbags` do no more than is bounded here; it has no options for that."""
    from bz2 import BZ2Decompressor

    from lz4.frame import LZ4FrameDecompressor  # rosbags depends on it, and on one of two zstd
    from rosbags.rosbag1 import reader as rosbag1
    from rosbags.rosbag2 import reader as rosbag2
    from rosbags.rosbag2 import storage_mcap, storage_sqlite3

    lz4, zstd = bounded(LZ4FrameDecompressor), vars(rosbag2)["zstd"]
    messages = bounded(zstd.ZstdDecompressor)
    rosbag1.decompressors.update(bz2=bounded(BZ2Decompressor), lz4=lz4)
    storage_mcap.DECOMPRESSORS.update(lz4=lz4, zstd=messages)

    class Unpacked(zstd.ZstdFile):  # type: ignore[name-defined, misc]
        def read(self, size: int | None = -1) -> bytes:
            data: bytes = super().read(size)
            left = _left.get()
            if left is not None:
                if len(data) > left:
                    raise ValueError(
                        f"expected compressed files that unpack to at most {_RATIO} times their size or "
                        f"{16 * max_pixels()} bytes; ANYNET_MAX_PIXELS raises the limit"
                    )
                _left.set(left - len(data))
            return data

    vars(rosbag2)["zstd"] = SimpleNamespace(open=Unpacked, decompress=messages)

    parse = vars(rosbag2)["parse_qos"]  # in YAML, at 0.1 MB/s

    def parse_qos(profiles: Any) -> list[Any]:
        return list(parse(profiles)) if _left.get() is None else []

    for module in (rosbag2, storage_mcap, storage_sqlite3):
        vars(module)["parse_qos"] = parse_qos

    apsw = vars(storage_sqlite3)["apsw"]

    class Connection(apsw.Connection):  # type: ignore[name-defined, misc]
        """To tables that hold what they return, no views; for no more steps than a file of this size needs."""

        def __init__(self, name: str, *args: Any, **kwargs: Any) -> None:
            super().__init__(name, *args, **kwargs)
            size = os.stat(self.filename).st_size
            self.limit(apsw.SQLITE_LIMIT_LENGTH, min(size, 2**31 - 1))  # no value is larger than the file
            left = iter(range((_STEPS + _STEPS_PER_BYTE * size) // 10**6))
            self.set_progress_handler(lambda: next(left, None) is None, 10**6)
            computed = "SELECT count(*) FROM sqlite_master AS one, pragma_table_xinfo(one.name) WHERE hidden > 1"
            if self.execute(computed).fetchone() != (0,):
                raise ValueError("expected tables without computed columns")
            self.authorizer = authorized

    def authorized(action: int, name: str | None, function: str | None, _: str | None, view: str | None) -> int:
        usual = (
            action in (apsw.SQLITE_SELECT, apsw.SQLITE_READ)
            or (action == apsw.SQLITE_PRAGMA and name == "table_info")
            or (action == apsw.SQLITE_FUNCTION and function in ("count", "min", "max"))
        )
        return int(apsw.SQLITE_OK if usual and view is None else apsw.SQLITE_DENY)

    vars(storage_sqlite3)["apsw"] = SimpleNamespace(**(vars(apsw) | {"Connection": Connection}))
