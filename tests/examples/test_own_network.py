from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_network.py"


@pytest.mark.slow
def test_it_learns_and_is_short() -> None:
    assert len(EXAMPLE.read_text().splitlines()) < 130
    run = subprocess.run([sys.executable, EXAMPLE, "--steps", "8"], check=True, capture_output=True, text=True)
    found = re.fullmatch(r"before: (\S+) px\nafter 8 steps: (\S+) px\n", run.stdout)
    assert found, run.stdout
    assert 0 < float(found[2]) < float(found[1])
