"""Files that take no more memory than they hold, and compressed blocks than images may take, for `rosbags`, which
believes what is written in a file."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from anynet.errors import AnyNetError
from anynet.io.files import max_pixels

_BYTES = 8  # of a pixel: RGB of 16 bits, and what else the block holds


class BoundedPath(type(Path())):  # type: ignore[misc]
    """A path; a file opened from it for reading bytes asks for no more than its size, whatever it is asked for."""

    def open(self, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        file = super().open(mode, *args, **kwargs)
        return _Bounded(file.detach()) if mode == "rb" else file


class _Bounded(io.BufferedReader):
    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(size if size is None else min(size, os.fstat(self.fileno()).st_size))


def bounded(decompressor: Callable[[], Any]) -> Callable[..., bytes]:
    """A function from a compressed block to its bytes, which are refused if there are more than images may take.

    Args:
        decompressor: makes an object of `bz2.BZ2Decompressor`'s interface.
    """

    def decompress(data: bytes, *_: Any) -> bytes:
        most = _BYTES * max_pixels()
        block = decompressor()
        result: bytes = block.decompress(data, max_length=most + 1)
        if len(result) > most:
            raise AnyNetError(f"expected blocks of at most {most} bytes; ANYNET_MAX_PIXELS raises the limit")
        if not block.eof or block.unused_data:
            raise AnyNetError(f"expected one compressed block, got {len(data)} bytes that are not one")
        return result

    return decompress


@cache
def bound_rosbags() -> None:
    """Has `rosbags` decompress no more than `bounded` does; it has no option for that."""
    from bz2 import BZ2Decompressor

    from lz4.frame import LZ4FrameDecompressor  # rosbags depends on it, and on one of two zstd
    from rosbags.rosbag1 import reader as rosbag1
    from rosbags.rosbag2 import reader as rosbag2
    from rosbags.rosbag2 import storage_mcap

    lz4, zstd = bounded(LZ4FrameDecompressor), vars(rosbag2)["zstd"]
    messages = bounded(zstd.ZstdDecompressor)
    rosbag1.decompressors.update(bz2=bounded(BZ2Decompressor), lz4=lz4)
    storage_mcap.DECOMPRESSORS.update(lz4=lz4, zstd=messages)
    vars(rosbag2)["zstd"] = SimpleNamespace(open=zstd.open, decompress=messages)
