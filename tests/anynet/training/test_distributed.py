from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Any

import psutil
import pytest
import torch
from planes import finish, log_lines, start
from safetensors.torch import load_file

from anynet.errors import AnyNetError
from anynet.training.distributed import process_group
from anynet.training.run_folder import CHECKPOINT, WEIGHTS


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


@pytest.mark.slow
def test_two_hosts_go_on_after_a_process_was_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCH_DISABLE_SHARE_RDZV_TCP_STORE", "1")  # docs/training.md says why
    with socket.socket() as free:
        free.bind(("localhost", 0))
        endpoint = f"--rdzv-endpoint=localhost:{free.getsockname()[1]}"
    meeting = ("--rdzv-backend=c10d", "--rdzv-id=test", endpoint)
    launcher = ("-m", "torch.distributed.run", "--nnodes=2", "--nproc-per-node=1", "--max-restarts=3", *meeting)
    hosts = [start(tmp_path / "two", launcher, workers=0) for _ in range(2)]
    while not (tmp_path / "two" / CHECKPOINT).exists():
        assert all(host.poll() is None for host in hosts)
        time.sleep(0.05)
    (worker,) = (p for p in psutil.Process(hosts[1].pid).children() if "planes.py" in " ".join(p.cmdline()))
    worker.kill()
    for host in hosts:
        finish(host)
    finish(start(tmp_path / "one", workers=0))
    one, two = (load_file(tmp_path / name / WEIGHTS) for name in ("one", "two"))
    for name, tensor in one.items():
        assert torch.allclose(two[name], tensor, rtol=1e-5, atol=1e-6), name


@pytest.mark.parametrize(("device", "message"), [("gpu", "expected cpu or cuda"), ("cuda", "device 'cuda': ")])
def test_devices_that_there_are_not(device: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(AnyNetError, match=message), process_group(device):
        pass


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        (
            {"WORLD_SIZE": "two"},
            "expected WORLD_SIZE in the environment to be a number, as torchrun sets it, got 'two'",
        ),
        ({"WORLD_SIZE": "9" * 5000}, "expected WORLD_SIZE in the environment"),
        ({"WORLD_SIZE": "2"}, "expected RANK in the environment to be a number, as torchrun sets it, got None"),
        ({"WORLD_SIZE": "2", "RANK": "0"}, "cannot join the run's other processes: .*MASTER_ADDR"),
    ],
)
def test_an_environment_that_describes_no_process(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], message: str
) -> None:
    for name in ("WORLD_SIZE", "RANK", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(AnyNetError, match=message), process_group("cpu"):
        pass
