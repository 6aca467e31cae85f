"""Processes that tests start."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from typing import Any


def completed(commands: Sequence[Sequence[str]], **options: Any) -> list[subprocess.CompletedProcess[str]]:
    """Runs all at once: most of their time is the import of torch, which takes one core."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **options}
    processes = [subprocess.Popen(command, **options) for command in commands]
    try:
        results = []
        for process in processes:
            streams = process.communicate(timeout=120)
            results.append(subprocess.CompletedProcess(process.args, process.returncode, *streams))
        return results
    finally:
        for process in processes:
            process.kill()
