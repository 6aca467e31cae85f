"""The command line as a process: status, streams, speed of the start."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from anynet.cli import COMMANDS

from .conftest import Run

MODULE = [sys.executable, "-m", "anynet"]


def test_help_names_every_command_without_torch(run: Run) -> None:
    program = "import sys, anynet.cli; anynet.cli.main(['--help']); sys.exit('torch' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    for name, (_, summary) in COMMANDS.items():
        assert f"  {name}" in result.stdout
        assert summary.split()[0] in result.stdout


@pytest.mark.parametrize(("given", "expected"), [(None, "passive"), ("active", "active")])
def test_threads_wait_without_spinning(given: str | None, expected: str) -> None:
    program = "import os, anynet.cli; anynet.cli.main(['info']); print(os.environ['OMP_WAIT_POLICY'])"
    environment = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    if given is not None:
        environment["OMP_WAIT_POLICY"] = given
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment
    )
    assert result.stdout.splitlines()[-1] == expected


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_has_help(run: Run, name: str) -> None:
    result = run(name, "--help")
    assert result.status == 0
    assert result.out.startswith(f"Usage: anynet {name} ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dream"], "No such command 'dream'"),
        (["predict", "left.png"], "Missing argument 'RIGHT'"),
        (["predict", "l", "r", "--out", "o", "--format", "jpg"], "'jpg' is not one of"),
        (["predict", "l", "r", "--out", "o", "--threads", "0"], "Invalid value for '--threads'"),
    ],
)
def test_usage_errors(run: Run, arguments: list[str], message: str) -> None:
    result = run(*arguments)
    assert result.status == 2
    assert result.out == ""
    assert message in result.err
    assert "Traceback" not in result.err


def test_info(run: Run) -> None:
    result = run("info")
    assert result.status == 0
    assert "\nthreads: " in result.out
    report = json.loads(run("info", "--json").out)
    assert report["threads"] >= 1
    assert report["instruction_set"] in report["instruction_sets"]


def test_a_closed_pipe_is_quiet() -> None:
    process = subprocess.Popen([*MODULE, "info"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait() == 1


def test_interrupt(folders: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    for folder in folders:
        for number in range(500):
            os.link(folder / "a.png", folder / f"{number:03}.png")
    out = tmp_path / "out"
    arguments = [*MODULE, "predict", *map(str, folders), "--out", str(out), "--weights", str(weights)]
    process = subprocess.Popen(
        arguments,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # the tests may run where it is ignored
    )
    deadline = time.monotonic() + 120
    while not (out.exists() and len(list(out.iterdir())) > 2) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert [path for path in out.iterdir() if path.suffix == ".part"] == []
