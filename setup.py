"""Builds the native libraries: CMake knows the sources, this file only drives it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).parent.resolve()


class CMakeBuild(build_ext):
    """One "extension" stands for the whole CMake project; its libraries are installed into anynet_ext/."""

    def run(self) -> None:
        import pybind11
        import torch

        target = ROOT if self.inplace else Path(self.build_lib).resolve()
        build = Path(self.build_temp).resolve() / "cmake"
        configure = [
            "cmake",
            f"-S{ROOT}",
            f"-B{build}",
            "-GNinja",
            f"-DCMAKE_MAKE_PROGRAM={shutil.which('ninja')}",  # an isolated build's own is gone when the next one starts
            f"-DANYNET_TORCH_DIR={Path(torch.__file__).parent}",
            f"-Dpybind11_DIR={pybind11.get_cmake_dir()}",
            f"-DPYTHON_EXECUTABLE={sys.executable}",
            "-DANYNET_PYTHON=ON",
            "-DANYNET_TESTS=OFF",
            f"-DCMAKE_INSTALL_PREFIX={target / 'anynet_ext'}",
            f"-DANYNET_CUDA={os.environ.get('ANYNET_CUDA', 'AUTO')}",
            "-UANYNET_NVCC",  # look for it anew: CUDA may have come or gone since the last build
        ]
        subprocess.run(configure, check=True)
        subprocess.run(["cmake", "--build", str(build)], check=True)
        subprocess.run(["cmake", "--install", str(build)], check=True)

    def get_outputs(self) -> list[str]:
        return []


setup(ext_modules=[Extension("anynet_ext._C", sources=[])], cmdclass={"build_ext": CMakeBuild})
