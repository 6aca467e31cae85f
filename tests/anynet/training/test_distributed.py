from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from planes import finish, log_lines, start
from safetensors.torch import load_file

from anynet.training.loop import WEIGHTS


@pytest.mark.slow
@pytest.mark.parametrize("stage_weights", [(), (1, 0, 0, 0)])
def test_two_processes_equal_one(tmp_path: Path, stage_weights: tuple[int, ...]) -> None:
    options: dict[str, Any] = {"steps": 3, "workers": 0, "stage_weights": stage_weights}
    finish(start(tmp_path / "one", **options))
    torchrun = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
    finish(start(tmp_path / "two", torchrun, **options))
    one, two = (load_file(tmp_path / name / WEIGHTS) for name in ("one", "two"))
    for name, tensor in one.items():
        assert torch.allclose(two[name], tensor, rtol=1e-5, atol=1e-6), name
    for first, second in zip(log_lines(tmp_path / "one"), log_lines(tmp_path / "two"), strict=True):
        assert second["losses"] == pytest.approx(first["losses"], rel=1e-4)
        assert second["grad_norm"] == pytest.approx(first["grad_norm"], rel=1e-4)
