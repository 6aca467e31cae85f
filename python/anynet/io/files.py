"""Bytes to and from files, so that an error is one line and nothing half-written is ever left."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from anynet.errors import AnyNetError


def write_atomically(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes `data` to `path`: afterwards the file is complete, or on an error as it was before.

    Raises:
        AnyNetError: if the file cannot be written, for example because the disk is full.
    """
    path = Path(path)
    unfinished = path.with_name(
        f".{path.name}.{secrets.token_hex(4)}.part"
    )  # same folder: os.replace stays on one disk
    try:
        try:
            with open(unfinished, "xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise AnyNetError(f"cannot write {path}: {error.strerror}") from error


def make_folder(path: str | Path) -> None:
    """Makes the folder and those above it, if missing.

    Raises:
        AnyNetError: if it cannot be made.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AnyNetError(f"cannot make the folder {path}: {error.strerror}") from error


def read_bytes(path: str | Path) -> bytes:
    """The content of `path`.

    Raises:
        AnyNetError: if there is no such file or it cannot be read.
    """
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise AnyNetError(f"cannot read {path}: {error.strerror}") from error
