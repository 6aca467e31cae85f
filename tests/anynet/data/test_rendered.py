from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import psutil
import pytest

from anynet.data.rendered import RenderedFolder, write_rendered
from anynet.errors import AnyNetError
from anynet.synthetic import render

MAGIC = b"\x93NUMPY"


def test_folder_holds_what_was_rendered_and_is_resumed(tmp_path: Path) -> None:
    assert list(write_rendered(tmp_path, 2, seed=4, height=96, width=128)) == [0, 1, 2]
    kept = tmp_path / "0000004.npy"
    stamp = kept.stat().st_mtime_ns
    (tmp_path / "0000005.npy").unlink()
    assert list(write_rendered(tmp_path, 3, seed=4, height=96, width=128)) == [1, 2, 3]
    assert kept.stat().st_mtime_ns == stamp

    stored, fresh = RenderedFolder(tmp_path)[1], render(5, 96, 128)
    assert np.array_equal(stored.left, fresh.left)
    assert np.array_equal(stored.right, fresh.right)
    assert np.abs(stored.disparity - fresh.disparity).max() <= 1 / 512
    assert np.array_equal(stored.right_occluded, fresh.right_occluded)


def test_a_killed_worker_is_told(tmp_path: Path) -> None:
    steps = write_rendered(tmp_path, 50, height=96, width=128)
    assert [next(steps), next(steps)] == [0, 1]
    (worker,) = (p for p in psutil.Process().children() if "spawn_main" in " ".join(p.cmdline()))
    worker.kill()
    with pytest.raises(AnyNetError, match=r"a worker failed or was killed, perhaps for lack of memory: .* with fewer"):
        list(steps)
    assert len(list(write_rendered(tmp_path, 2, height=96, width=128))) < 3


def test_a_worker_that_failed_itself_is_told(tmp_path: Path) -> None:
    """As where the program comes from a pipe: a spawned process cannot read it again."""
    program = f"from anynet.cli import main; main(['render', '--count=5', '--workers=2', '--out={tmp_path}'])"
    done = subprocess.run([sys.executable, "-"], input=program, capture_output=True, text=True)
    assert done.stderr.splitlines()[-1].startswith(f"anynet: {tmp_path}: a worker failed or was killed, ")
    assert "FileNotFoundError" in done.stderr


def test_a_worker_killed_before_all_is_handed_out_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise BrokenProcessPool

    monkeypatch.setattr(ProcessPoolExecutor, "submit", broken)
    with pytest.raises(AnyNetError, match="a worker failed or was killed"):
        list(write_rendered(tmp_path, 2, height=96, width=128))


def test_folder_of_another_size_is_refused(tmp_path: Path, rendering_here: None) -> None:
    list(write_rendered(tmp_path, 1, height=96, width=128))
    with pytest.raises(AnyNetError, match=r'asked for .*"height": 64'):
        list(write_rendered(tmp_path, 1, height=64, width=128))


@pytest.mark.parametrize("content", [b"", b"damaged", MAGIC + b"\x01\0\x05\0(((((", None])
def test_damaged_pairs_are_told(tmp_path: Path, content: bytes | None) -> None:
    if content is None:
        np.save(tmp_path / "0000000.npy", np.zeros((3, 4)))
    else:
        (tmp_path / "0000000.npy").write_bytes(content)
    with pytest.raises(AnyNetError, match=r"cannot read .*0000000\.npy: not a pair that `anynet render` wrote [^\n]*$"):
        RenderedFolder(tmp_path)[0]


def test_a_damaged_note_of_the_settings(tmp_path: Path) -> None:
    (tmp_path / "render.json").write_bytes(b"{broken\n")
    with pytest.raises(AnyNetError, match=r"holds pairs rendered with '\{broken', asked for"):
        next(write_rendered(tmp_path, 1))


def test_what_else_lies_in_the_folder_is_left_out(tmp_path: Path, rendering_here: None) -> None:
    list(write_rendered(tmp_path, 1, height=96, width=128))
    (tmp_path / "._0000000.npy").write_bytes(b"\0\5\26\7")
    os.mkfifo(tmp_path / "0000001.npy")  # to open it would take for ever
    assert [sample.name for sample in RenderedFolder(tmp_path)] == ["0000000"]
