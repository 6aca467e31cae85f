"""Builds the native libraries: CMake knows the sources, this file only drives it.

Environment variables: ANYNET_CUDA=ON, OFF or AUTO; ANYNET_TORCH_DIR, a torch package whose headers to use; CMAKE_ARGS;
ANYNET_KERNELS=ON, or OFF, which leaves out _kernels: only the tests need them, and they alone tie a wheel to one
version of Python.
"""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).parent.resolve()
sys.path.insert(0, str(ROOT / "build_backend"))

from backend import OLDEST_TORCH, find_opencv, find_torch  # noqa: E402

KERNELS = os.environ.get("ANYNET_KERNELS", "ON")
if KERNELS not in ("ON", "OFF"):  # of all that CMake takes for one of the two, these: the wheel's name follows from it
    raise SystemExit(f"ANYNET_KERNELS: expected ON or OFF, got {KERNELS}")


def own_pybind11(folder: Path) -> Path:
    """pybind11's CMake files in a copy of it that stays: with an isolated build's own, which is gone when the next one
    starts, everything would be compiled anew."""
    import pybind11

    package = folder / f"pybind11-{pybind11.__version__}"
    if not package.exists():
        shutil.copytree(Path(pybind11.__file__).parent, package)
    return package / "share" / "cmake" / "pybind11"


class CleanBuild(build):
    """Packages what this build makes, and nothing that an earlier one left behind."""

    def run(self) -> None:
        shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()


class CMakeBuild(build_ext):
    """One "extension" stands for the whole CMake project; its libraries are installed into anynet_ext/."""

    def run(self) -> None:
        target = (ROOT if self.inplace else Path(self.build_lib).resolve()) / "anynet_ext"
        cmake_build = Path(self.build_temp).resolve() / "cmake"
        torch = find_torch()
        if torch is None:
            raise SystemExit("no torch >= {}.{} was found, whose headers are needed".format(*OLDEST_TORCH))
        configure = [
            "cmake",
            f"-S{ROOT}",
            f"-B{cmake_build}",
            "-GNinja",
            f"-DCMAKE_MAKE_PROGRAM={shutil.which('ninja')}",  # an isolated build's own is gone when the next one starts
            f"-DANYNET_TORCH_DIR={torch}",
            f"-DANYNET_PYTHON={KERNELS}",
            "-DANYNET_TESTS=OFF",
            f"-DCMAKE_INSTALL_PREFIX={target}",
            f"-DANYNET_CUDA={os.environ.get('ANYNET_CUDA', 'AUTO')}",
            "-UANYNET_NVCC",  # look for it anew: CUDA may have come or gone since the last build
            *shlex.split(os.environ.get("CMAKE_ARGS", "")),
        ]
        if KERNELS == "ON":
            configure += [f"-Dpybind11_DIR={own_pybind11(cmake_build.parent)}", f"-DPython_EXECUTABLE={sys.executable}"]
        subprocess.run(configure, check=True)
        subprocess.run(["cmake", "--build", str(cmake_build)], check=True)
        for old in target.glob("*.so"):
            old.unlink()
        subprocess.run(["cmake", "--install", str(cmake_build)], check=True)

    def get_outputs(self) -> list[str]:
        return []


class Wheel(bdist_wheel):
    def get_tag(self) -> tuple[str, str, str]:
        """The operators need no Python of their own: without _kernels one wheel serves all versions."""
        python, abi, platform = super().get_tag()
        return (python, abi, platform) if KERNELS == "ON" else ("py3", "none", platform)


setup(
    install_requires=[
        "torch>={}.{}".format(*OLDEST_TORCH),
        "numpy",
        "safetensors",
        "filelock",
        f"{find_opencv()}!=4.11.0.*",  # that one misreads whole numbers in YAML files
        "scikit-image",
        "typer",
        "rich",
        "plyfile",
        "PyYAML",
    ],
    ext_modules=[Extension("anynet_ext._C", sources=[])],
    cmdclass={"build": CleanBuild, "build_ext": CMakeBuild, "bdist_wheel": Wheel},
)
