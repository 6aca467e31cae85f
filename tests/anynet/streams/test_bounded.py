from __future__ import annotations

import resource
from bz2 import BZ2Compressor, BZ2Decompressor
from pathlib import Path

import pytest

from anynet.streams.bounded import BoundedPath, bounded


def test_a_length_beyond_the_file_takes_no_memory(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    with (BoundedPath(tmp_path) / "file").open("rb") as file:
        assert file.read(2) == b"12"
        assert file.read(2**62) == b"345"
        file.seek(0)
        assert file.read() == b"12345"
        file.seek(1)
        assert file.read(None) == b"2345"


def test_a_compressed_block_takes_no_more_memory_than_an_image(monkeypatch: pytest.MonkeyPatch) -> None:
    compressor = BZ2Compressor()
    bomb = b"".join([*(compressor.compress(bytes(2**20)) for _ in range(200)), compressor.flush()])
    assert len(bomb) < 1000
    monkeypatch.setenv("ANYNET_MAX_PIXELS", str(2**20))
    decompress = bounded(BZ2Decompressor)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="expected blocks of at most 8388608 bytes; ANYNET_MAX_PIXELS raises"):
        decompress(bomb)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # KB
    monkeypatch.setenv("ANYNET_MAX_PIXELS", str(200 * 2**17))
    assert decompress(bomb, "more that rosbags gives") == bytes(200 * 2**20)
    for damaged in (bomb[:-1], bomb + b"more"):
        with pytest.raises(ValueError, match="expected one compressed block"):
            decompress(damaged)
