"""Which torch a build uses, when it asks for one of its own, and which OpenCV the package will depend on."""

from __future__ import annotations

import importlib.util
import site
import sys
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("setuptools")


@pytest.fixture
def backend() -> ModuleType:
    file = Path(__file__).parents[2] / "build_backend" / "backend.py"
    spec = importlib.util.spec_from_file_location("backend", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The packages of the environment that pip installs into, which an isolated build does not have on its path."""
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.setattr(site, "getsitepackages", lambda: [str(tmp_path)])
    monkeypatch.setattr(site, "getusersitepackages", lambda: str(tmp_path / "user"))
    monkeypatch.delenv("ANYNET_TORCH_DIR", raising=False)
    return tmp_path


def install(folder: Path, version: str, headers: bool = True, name: str = "torch") -> Path:
    metadata = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (folder / "torch" / ("include" if headers else "")).mkdir(parents=True)
    return folder / "torch"


@pytest.mark.parametrize("version", ["2.10.0", "2.13.0+cpu", "2.14.1", "3.0.0a0+git1234"])
def test_uses_the_torch_that_is_there(backend: ModuleType, environment: Path, version: str) -> None:
    torch = install(environment, version)
    assert backend.find_torch() == torch
    assert not any("torch" in name for name in backend.get_requires_for_build_wheel())


@pytest.mark.parametrize(("version", "headers"), [("2.9.1", True), ("1.13.0", True), ("2.13.0", False)])
def test_asks_for_one_if_that_does_not_fit(backend: ModuleType, environment: Path, version: str, headers: bool) -> None:
    install(environment, version, headers)
    assert backend.find_torch() is None
    assert "torch>=2.10" in backend.get_requires_for_build_wheel()
    assert "torch>=2.10" in backend.get_requires_for_build_editable()


def test_asks_for_one_if_there_is_none(backend: ModuleType, environment: Path) -> None:
    assert backend.find_torch() is None
    assert "torch>=2.10" in backend.get_requires_for_build_wheel()


def test_the_builds_own_comes_first(backend: ModuleType, environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = install(environment / "isolated", "2.14.1")
    install(environment, "2.13.0")
    monkeypatch.setattr(sys, "path", [str(environment / "isolated")])
    assert backend.find_torch() == own


def test_a_given_folder_comes_before_all(
    backend: ModuleType, environment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(environment, "2.13.0")
    monkeypatch.setenv("ANYNET_TORCH_DIR", "/elsewhere/torch")
    assert backend.find_torch() == Path("/elsewhere/torch")


@pytest.mark.parametrize("name", ["opencv-python", "opencv-contrib-python", "opencv-contrib-python-headless"])
def test_depends_on_the_opencv_that_is_there(backend: ModuleType, environment: Path, name: str) -> None:
    assert backend.find_opencv() == "opencv-python-headless"
    install(environment, "4.10.0.84", name=name)
    assert backend.find_opencv() == name
