"""How the compiled libraries are found, and what importing them costs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import anynet_ext
from anynet_ext import _library

PACKAGE = Path(anynet_ext.__file__).parent


def python(code: str, folder: Path, **environment: str) -> str:
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, cwd=folder, env={**os.environ, **environment}
    )
    return done.stdout.strip()


def test_source_tree_finds_the_installed_libraries(tmp_path: Path) -> None:
    """As after `pip install .` in a clone: its own folder comes first, and has no libraries."""
    clone, installed = tmp_path / "clone" / "anynet_ext", tmp_path / "site" / "anynet_ext"
    shutil.copytree(PACKAGE, clone, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    installed.mkdir(parents=True)
    for library in _library._FOLDER.glob("*.so"):
        (installed / library.name).symlink_to(library)
    code = "import anynet_ext; print(anynet_ext.__file__, anynet_ext._library._FOLDER)"
    found = python(code, clone.parent, PYTHONPATH=f"{clone.parent}:{installed.parent}")
    assert found == f"{clone / '__init__.py'} {installed}"


def test_missing_libraries_are_told(tmp_path: Path) -> None:
    clone = tmp_path / "anynet_ext"
    shutil.copytree(PACKAGE, clone, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    code = """
import sys
from pathlib import Path
import torch  # which may lie beside an installed anynet_ext
sys.path = [entry for entry in sys.path if not Path(entry, "anynet_ext", "_C.so").exists()]
try:
    import anynet_ext
except ImportError as error:
    print(error)
"""
    assert python(code, tmp_path, PYTHONPATH=str(tmp_path)).startswith(
        f"{clone / '_C.so'} is missing: build it with `pip install .`"
    )


def test_import_does_not_wait_for_symbolic_shapes(tmp_path: Path) -> None:
    code = "import sys, anynet_ext; print('torch.fx.experimental.symbolic_shapes' in sys.modules)"
    assert python(code, tmp_path, PYTHONPATH=str(PACKAGE.parent)) == "False"
