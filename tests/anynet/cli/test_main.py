"""The command line as a process: status, streams, speed of the start."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from processes import completed

import anynet
import anynet_ext
from anynet import cli
from anynet.cli import COMMANDS
from anynet.errors import AnyNetError

from .conftest import Run

MODULE = [sys.executable, "-m", "anynet"]


def test_help_names_every_command_without_torch(run: Run) -> None:
    program = "import sys, anynet.cli; anynet.cli.main(['--help']); sys.exit('torch' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    for name, (_, summary) in COMMANDS.items():
        assert f"  {name}" in result.stdout
        assert summary.split()[0] in result.stdout


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_has_help(run: Run, name: str) -> None:
    result = run(name, "--help")
    assert result.status == 0
    assert result.out.startswith(f"Usage: anynet {name} ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--data", "render:1", "--threads", "1000000"], "Invalid value for '--threads'"),
        (["render", "--out", "o", "--workers", "1000000"], "Invalid value for '--workers'"),
        (["render", "--out", "o", "--height", "1000000000"], "Invalid value for '--height'"),
        (["demo", "--rendered", "--seed", "-1"], "Invalid value for '--seed'"),
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


def test_version(run: Run) -> None:
    result = run("--version")
    assert (result.status, result.out, result.err) == (0, f"anynet {anynet.__version__}\n", "")


def test_a_closed_pipe_is_quiet() -> None:
    process = subprocess.Popen([*MODULE, "info"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait() == 1


def test_a_closed_standard_output_is_no_error() -> None:
    every = ">&-", ">&- 2>&-", "<&- >&-"
    for result in completed([["bash", "-c", f'exec "$@" {closed}', "bash", *MODULE, "info"] for closed in every]):
        assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
def test_a_full_standard_output_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        for result in completed([[*MODULE, "info"], [*MODULE, "--help"]], stdout=full):
            assert (result.returncode, result.stderr) == (2, "anynet: No space left on device\n")
        command, environment = [*MODULE, "predict", "a", "b", "--out", "c"], {**os.environ, "PYTHONUNBUFFERED": ""}
        assert subprocess.run(command, stderr=full, env=environment, check=False).returncode == 2


def test_a_working_folder_that_is_gone(tmp_path: Path) -> None:
    path = os.pathsep.join(os.path.abspath(p) for p in sys.path if p)
    leaving = "import os; os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')"
    program = f"{leaving}; os.execv({MODULE[0]!r}, {[*MODULE, 'info']!r})"
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr == "anynet: the working folder cannot be used: No such file or directory\n"


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (PermissionError(13, "Permission denied", "/a/b"), 2, "anynet: /a/b: Permission denied"),
        (OSError("something"), 2, "anynet: something"),
        (AnyNetError("a\nb.png: expected this"), 2, r"anynet: a\nb.png: expected this"),
        (MemoryError(), 2, "anynet: out of memory"),
        (KeyboardInterrupt(), 130, None),
    ],
)
def test_errors_are_one_line(
    run: Run, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int, line: str | None
) -> None:
    def fail(chosen: str) -> None:
        raise error

    monkeypatch.setattr(cli, "_application", fail)
    result = run("info")
    assert result.status == status
    assert result.err.splitlines() == ([line] if line else [])


@pytest.mark.parametrize(
    "call",
    [
        lambda: torch.empty(2**50),
        lambda: anynet_ext.cost_volume(*[torch.zeros(1).expand(1, 2**44, 1, 1)] * 2),
        lambda: anynet_ext.cost_volume(*[torch.zeros(1, 1, 1, 2**16)] * 2, None, 0, 2**29),
    ],
    ids=["a tensor", "an operator's scratch", "an operator's result"],
)
def test_memory_that_is_not_there(run: Run, monkeypatch: pytest.MonkeyPatch, call: Callable[[], object]) -> None:
    monkeypatch.setattr(cli, "_application", lambda chosen: call())
    result = run("info")
    assert (result.status, result.err) == (2, "anynet: out of memory\n")


def test_warnings_are_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def warn(chosen: str) -> Callable[..., None]:
        warnings.warn("a.png: dark", stacklevel=1)
        raise SystemExit(0)

    monkeypatch.setattr(cli, "_application", warn)
    result = run("info")
    assert (result.status, result.err) == (0, "anynet: warning: a.png: dark\n")


SWALLOWING = """
import os, signal, sys, time
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(5)
except BaseException:
    pass
"""


def test_an_interrupt_during_imports_ends_the_program(tmp_path: Path) -> None:
    """Even where a library swallows KeyboardInterrupt; never with a traceback."""
    (tmp_path / "swallowing.py").write_text(SWALLOWING)
    program = (
        "import sys, anynet.cli as cli\n"
        "def application(chosen):\n    import swallowing\n    print('went on')\n    raise SystemExit(0)\n"
        "cli._application = application\nsys.exit(cli.main([]))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *(p for p in sys.path if p)])}
    result = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "")


@pytest.mark.slow
def test_an_interrupt_at_any_time_ends_the_program(pair: tuple[Path, Path], tmp_path: Path) -> None:
    for wait in (0.3, 0.6, 1, 1.5, 2, 3):
        process = subprocess.Popen(
            [*MODULE, "predict", *map(str, pair), "--out", str(tmp_path / "out")],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        time.sleep(wait)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        # Before the first of our lines runs, nobody but Python can answer.
        assert process.returncode in (0, 130, -signal.SIGINT)
        assert "Traceback" not in errors or process.returncode == -signal.SIGINT


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
