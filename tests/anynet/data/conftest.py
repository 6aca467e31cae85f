from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import cv2
import pytest


@pytest.fixture
def rendering_here(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Folders are rendered in this process: to start another one takes longer than small pairs do."""
    monkeypatch.setattr("anynet.data.rendered.ProcessPoolExecutor", lambda workers, _: ThreadPoolExecutor(workers))
    threads = cv2.getNumThreads()
    yield
    cv2.setNumThreads(threads)
