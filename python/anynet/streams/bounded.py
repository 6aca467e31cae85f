"""Files that take no more memory than they hold, for libraries that believe the lengths written in them."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any


class BoundedPath(type(Path())):  # type: ignore[misc]
    """A path; a file opened from it for reading bytes asks for no more than its size, whatever it is asked for."""

    def open(self, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        file = super().open(mode, *args, **kwargs)
        return _Bounded(file.detach()) if mode == "rb" else file


class _Bounded(io.BufferedReader):
    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(size if size is None else min(size, os.fstat(self.fileno()).st_size))
