"""What pip calls to build AnyNet: setuptools, but with an eye on what the environment has that it builds for.

An isolated build does not see that. Here its torch is looked for, whose headers will do if it is recent enough (stable
ABI); only else does the build ask for one of its own. And the package will depend on the OpenCV that is there.
"""

from __future__ import annotations

import os
import re
import site
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

from setuptools.build_meta import (  # noqa: F401  (pip looks for them here)
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

OLDEST_TORCH = 2, 10


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """What a build needs beside pyproject.toml's build requirements."""
    return [] if find_torch() else ["torch>={}.{}".format(*OLDEST_TORCH)]


get_requires_for_build_editable = get_requires_for_build_wheel


def find_torch() -> Path | None:
    """The folder of a torch package that has the headers: ANYNET_TORCH_DIR, or else one of a version that fits."""
    if given := os.environ.get("ANYNET_TORCH_DIR"):
        return Path(given)
    for found in _installed("torch"):
        version = re.match(r"(\d+)\.(\d+)", found.version)
        torch = Path(str(found.locate_file("torch")))
        if version and tuple(map(int, version.groups())) >= OLDEST_TORCH and (torch / "include").is_dir():
            return torch
    return None


def find_opencv() -> str:
    """The OpenCV package to depend on: the one that is there, or else the headless one.

    All of them bring the module cv2. A second one overwrites the first: the headless one a user's windows, say.
    """
    names = "opencv-python", "opencv-contrib-python", "opencv-contrib-python-headless"
    return next((name for name in names if any(_installed(name))), "opencv-python-headless")


def _installed(name: str) -> Iterator[Distribution]:
    """Packages of that name, this process's own before those of the environment that pip installs into."""
    folders = [*sys.path, *site.getsitepackages()]
    if site.ENABLE_USER_SITE:
        folders.append(site.getusersitepackages())
    for folder in folders:
        yield from distributions(name=name, path=[folder])
