from __future__ import annotations

import errno
import os
import resource
import signal
import stat
from pathlib import Path

import pytest

from anynet.errors import AnyNetError
from anynet.io import write_atomically
from anynet.io.files import (
    MAX_PIXELS,
    check_output,
    check_regular,
    check_size,
    make_folder,
    max_pixels,
    read_bytes,
    read_text,
    remove_unfinished,
    replacing,
)


def test_writes_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "file"
    for data in (b"first", b"", b"second"):
        write_atomically(path, data)
        assert path.read_bytes() == data
    assert list(tmp_path.iterdir()) == [path]


def test_the_users_permissions_hold(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "file", b"")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o640


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    """A limit on the size of files stands for the full disk: the write fails in the middle."""
    path = tmp_path / "file"
    path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(AnyNetError, match=rf"^cannot write {path}: File too large$"):
            write_atomically(path, bytes(10_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), KeyboardInterrupt()])
def test_late_failures_leave_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, failure: BaseException
) -> None:
    def fail(*arguments: object) -> None:
        raise failure

    path = tmp_path / "file"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, step, fail)
    with pytest.raises((AnyNetError, KeyboardInterrupt)) as caught:
        write_atomically(path, b"new")
    assert isinstance(caught.value, KeyboardInterrupt) or "No space left on device" in str(caught.value)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"cannot write .*: No such file or directory"):
        write_atomically(tmp_path / "none" / "file", b"")


def test_make_folder(tmp_path: Path) -> None:
    for _ in range(2):
        make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(AnyNetError, match=r"cannot make the folder .*file: File exists"):
        make_folder(tmp_path / "file")


def test_check_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_output(tmp_path / "made" / "file")
    assert list((tmp_path / "made").iterdir()) == []
    with pytest.raises(AnyNetError, match="made: expected the name of a file, got a folder"):
        check_output(tmp_path / "made")

    def refuse(**_: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(AnyNetError, match=r"cannot write .*file: Permission denied"):
        check_output(tmp_path / "file")


def test_devices_and_pipes_are_refused_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, kind in (("/dev/zero", "device"), (tmp_path / "pipe", "pipe")):
        with pytest.raises(AnyNetError, match=f"cannot read {path}: expected a file, got a {kind}"):
            read_bytes(path)
        with pytest.raises(AnyNetError, match=f"cannot read {path}: expected a file, got a {kind}"):
            check_regular(path)
    for other in (tmp_path, tmp_path / "none", "a\0b"):  # told by who opens it
        check_regular(other)


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    for name, message in {
        "none": "No such file",
        "loop": "Too many levels of symbolic links",
        "a\0b": "null byte",
        "x" * 300: "File name too long",
    }.items():
        with pytest.raises(AnyNetError, match=message):
            read_bytes(tmp_path / name)


def test_a_file_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with open(tmp_path / "huge", "wb") as file:
        file.truncate(2**42)
    with pytest.raises(AnyNetError, match=r"huge: expected at most \d+ bytes, got 4398046511104"):
        read_bytes(tmp_path / "huge")
    with pytest.raises(AnyNetError, match="expected at most 16777216 bytes"):
        read_text(tmp_path / "huge")


def test_texts_with_and_without_a_mark(tmp_path: Path) -> None:
    for data in (b"caf\xc3\xa9", b"\xef\xbb\xbfcaf\xc3\xa9"):
        (tmp_path / "text").write_bytes(data)
        assert read_text(tmp_path / "text") == "café"
    (tmp_path / "text").write_bytes(b"caf\xe9")
    with pytest.raises(AnyNetError, match=r"cannot read .*text: not a text in UTF-8"):
        read_text(tmp_path / "text")


def test_the_limit_on_pixels_and_its_option(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ANYNET_MAX_PIXELS", raising=False)
    assert max_pixels() == MAX_PIXELS
    check_size("a.png", MAX_PIXELS, 1)
    with pytest.raises(AnyNetError, match=rf"a\.png: expected at most {MAX_PIXELS} pixels, got {MAX_PIXELS + 1} x 1"):
        check_size("a.png", MAX_PIXELS + 1, 1)
    monkeypatch.setenv("ANYNET_MAX_PIXELS", str(10**10))
    check_size("a.png", 10**5, 10**5)
    with pytest.raises(AnyNetError, match=r"a\.png: expected at least one pixel, got 0 x 5"):
        check_size("a.png", 0, 5)
    for text in ("", "0", "-1", "1e9", "many", "9" * 5000):
        monkeypatch.setenv("ANYNET_MAX_PIXELS", text)
        with pytest.raises(AnyNetError, match="expected ANYNET_MAX_PIXELS to be a positive whole number"):
            max_pixels()


def test_what_killed_writers_left_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda number: os._exit(9))
    child = os.fork()
    if not child:
        write_atomically(tmp_path / "file", b"half")
    os.waitpid(child, 0)
    child = os.fork()
    if not child:
        with replacing(tmp_path / "file") as path:
            path.write_bytes(b"half")
            os._exit(9)
    os.waitpid(child, 0)
    assert [path.suffix for path in tmp_path.iterdir()] == [".part"] * 2
    (tmp_path / "part").touch()
    (tmp_path / ".mine.part").mkdir()
    remove_unfinished(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".mine.part", "part"]


def test_a_name_as_long_as_names_may_be(tmp_path: Path) -> None:
    write_atomically(tmp_path / ("x" * 255), b"data")
    with pytest.raises(AnyNetError, match=r"cannot write .*: .*null"):
        write_atomically(tmp_path / "a\0b", b"data")
