"""The source archive holds what a wheel is built from."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

pytest.importorskip("setuptools", minversion="77")  # as pyproject.toml says

ROOT = Path(__file__).parents[2]
NEEDED = ["build_backend", "cmake", "csrc", "python", "anynet_ext", "tests/kernels", "tests/cuda", "CMakeLists.txt"]


def test_the_archive_is_whole(tmp_path: Path) -> None:
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("needs a clone, and git")
    clone, out = tmp_path / "clone", tmp_path / "out"
    tracked = subprocess.run(["git", "ls-files", *NEEDED], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    every = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in every.splitlines():  # a copy: the build leaves files behind
        (clone / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, clone / name)
    code = f"import sys; sys.path.insert(0, 'build_backend'); import backend; backend.build_sdist({str(out)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=clone, check=True, capture_output=True)
    (archive,) = out.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        held = {name.partition("/")[2] for name in file.getnames()}
    assert not set(tracked.splitlines()) - held
    assert not any(name.endswith((".so", ".pyc")) for name in held)
