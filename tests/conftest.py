from __future__ import annotations

import os
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def another_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Processes that tests start import what is installed, not what lies in the folder in which pytest was started."""
    before = os.getcwd()
    os.chdir(tmp_path_factory.mktemp("elsewhere"))
    yield
    os.chdir(before)
