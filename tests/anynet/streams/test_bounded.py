from __future__ import annotations

from pathlib import Path

from anynet.streams.bounded import BoundedPath


def test_a_length_beyond_the_file_takes_no_memory(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    with (BoundedPath(tmp_path) / "file").open("rb") as file:
        assert file.read(2) == b"12"
        assert file.read(2**62) == b"345"
        file.seek(0)
        assert file.read() == b"12345"
        file.seek(1)
        assert file.read(None) == b"2345"
