from __future__ import annotations

import subprocess
import sys

import pytest

import anynet


def test_the_api_is_listed() -> None:
    assert set(anynet.__all__) <= set(dir(anynet))
    for name in anynet.__all__:
        assert getattr(anynet, name).__name__ == name


def test_other_names_are_not_there() -> None:
    with pytest.raises(AttributeError, match="module 'anynet' has no attribute 'Stereo'"):
        anynet.Stereo  # noqa: B018


def test_importing_it_does_not_wait_for_torch() -> None:
    code = "import sys, anynet; dir(anynet); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_version_and_packages_are_there_on_first_use() -> None:
    code = """
import sys, re, anynet
assert "torch" not in sys.modules and "anynet.io" not in sys.modules
assert re.match(r"\\d+(\\.\\d+)*", anynet.__version__), anynet.__version__
assert callable(anynet.io.read_pair) and issubclass(anynet.AnyNetError, ValueError)
assert {"io", "camera", "__version__"} <= set(dir(anynet))
"""
    subprocess.run([sys.executable, "-c", code], check=True)
