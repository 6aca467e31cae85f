"""The command line: `anynet COMMAND`, also `python -m anynet COMMAND`.

A command is a function in a module of this package; what its signature and docstring say is its help. Only the command
that is asked for is imported, so that help does not wait for torch.

Exit status: 0 done; 2 the user's mistake, told in one line on stderr; 1 an error of the program (with a traceback), or
nobody reads the output any more; 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

import typer

from anynet.errors import AnyNetError

# name: module in this package that has a function of that name, summary
COMMANDS = {
    "predict": ("predict", "Disparity, depth and point clouds from pairs of images."),
    "stream": ("stream", "The same as the frames come: cameras, videos, folders, recordings."),
    "demo": ("demo", "Every stage on a real pair that comes along: times, errors, pictures."),
    "calibrate": ("calibrate", "A rig's calibration from pictures of a board."),
    "train": ("train", "Train a network from scratch."),
    "finetune": ("train", "Train weights further on other data."),
    "evaluate": ("evaluate", "Error and time of networks and of OpenCV's matchers on data sets."),
    "render": ("render", "Stereo pairs with exact ground truth, rendered here."),
    "info": ("info", "What is installed: build, instruction set, threads, weights."),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line, by default the process's own, and returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    # Before torch loads OpenMP: threads that wait spinning take the cores from all others that have work.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    try:
        try:
            _application(arguments[0] if arguments else "")(arguments, prog_name="anynet")
        finally:
            sys.stdout.flush()  # a closed pipe shows here, not at exit
    except AnyNetError as error:
        print(f"anynet: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # so that Python's last flush is quiet
        return 1
    except SystemExit as end:  # how typer ends
        return end.code if isinstance(end.code, int) else 0
    raise AssertionError("typer ends with SystemExit")


def _application(chosen: str) -> typer.Typer:
    application = typer.Typer(
        help="Stereo depth that can be stopped at any moment.",
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    application.callback()(_no_options)
    for name, (module, summary) in COMMANDS.items():
        command: Callable[..., None] = _no_options
        if name == chosen:
            command = getattr(import_module(f"anynet.cli.{module}"), name)
        application.command(name, short_help=summary)(command)
    return application


def _no_options() -> None:
    """Stands for the commands that are not asked for; they appear in the help only."""
