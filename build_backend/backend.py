"""What pip calls to build AnyNet: setuptools, but PyTorch is downloaded for its headers only where there is none yet.

An isolated build sees none of the environment that it builds for. Here that environment's torch is looked for, which
any recent one will do (stable ABI), and required of the package index only if it is missing or too old.
"""

from __future__ import annotations

import os
import re
import site
import sys
from collections.abc import Iterator
from importlib.metadata import distributions
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
    for folder in _package_folders():
        for found in distributions(name="torch", path=[str(folder)]):
            version = re.match(r"(\d+)\.(\d+)", found.version)
            torch = Path(str(found.locate_file("torch")))
            if version and tuple(map(int, version.groups())) >= OLDEST_TORCH and (torch / "include").is_dir():
                return torch
    return None


def _package_folders() -> Iterator[Path]:
    """Where packages are installed: this process's own, then those of the environment that pip installs into."""
    yield from map(Path, sys.path)
    yield from map(Path, site.getsitepackages())
    if site.ENABLE_USER_SITE:
        yield Path(site.getusersitepackages())
