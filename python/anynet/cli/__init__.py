"""The command line: `anynet COMMAND`, also `python -m anynet COMMAND`.

A command is a function in a module of this package; what its signature and docstring say is its help. Only the command
that is asked for is imported, so that help does not wait for torch.

Exit status: 0 done; 2 the user's mistake or a file that cannot be used, told in one line on stderr; 1 an error of the
program (with a traceback), or nobody reads the output any more; 130 interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import TYPE_CHECKING, TextIO

from anynet.cli.told import discard, tell
from anynet.errors import AnyNetError

if TYPE_CHECKING:
    import typer

# name: module in this package that has a function of that name, summary
COMMANDS = {
    "predict": ("predict", "Disparity, depth and point clouds from pairs of images."),
    "stream": ("stream", "The same as the frames come: cameras, videos, folders, recordings."),
    "view": ("view", "A page in the browser: disparity, confidence and cloud, live."),
    "demo": ("demo", "Every stage on a real pair that comes along: times, errors, pictures."),
    "calibrate": ("calibrate", "A rig's calibration from pictures of a board."),
    "train": ("train", "Train a network from scratch."),
    "finetune": ("train", "Train weights further on other data."),
    "evaluate": ("evaluate", "Error and time of networks and of OpenCV's matchers on data sets."),
    "render": ("render", "Stereo pairs with exact ground truth, rendered here."),
    "export": ("export", "The network for ONNX runtimes, torch.export and C++."),
    "info": ("info", "What is installed: build, instruction set, threads, weights."),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line, by default the process's own, and returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    _open_closed_streams()
    with _interruptible_imports(), warnings.catch_warnings():
        warnings.showwarning = _show_warning
        try:
            try:
                _check_working_folder()
                _application(arguments[0] if arguments else "")(arguments, prog_name="anynet")
            finally:
                sys.stdout.flush()  # a closed pipe or a full disk shows here, not at exit
        except AnyNetError as error:
            tell(str(error))
            return 2
        except ImportError as error:
            if error.name != "anynet_ext":
                raise
            tell(str(error))  # not built, or not for this machine
            return 2
        except BrokenPipeError:
            discard(sys.stdout)
            return 1
        except OSError as error:  # a file, a folder or a stream; never the program's own mistake
            discard(sys.stdout)
            tell(": ".join(str(part) for part in (error.filename, error.strerror or error) if part is not None))
            return 2
        except (MemoryError, RuntimeError) as error:
            if not _out_of_memory(error):
                raise
            tell("out of memory")
            return 2
        except KeyboardInterrupt:
            return 130
        except SystemExit as end:  # how typer ends
            return end.code if isinstance(end.code, int) else 0
        raise AssertionError("typer ends with SystemExit")


def _out_of_memory(error: Exception) -> bool:
    """PyTorch tells it of tensors as a RuntimeError, as operators do of results, and from 2.15 on of their scratch."""
    messages = "can't allocate memory", "expected memory for", "expected enough memory for the operator's scratch"
    return isinstance(error, MemoryError) or any(message in str(error) for message in messages)


def _application(chosen: str) -> typer.Typer:
    import typer

    application = typer.Typer(
        help="Stereo depth that can be stopped at any moment.",
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )

    def options(
        version: bool = typer.Option(
            False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ) -> None:
        pass

    application.callback()(options)
    for name, (module, summary) in COMMANDS.items():
        command: Callable[..., None] = _no_options
        if name == chosen:
            command = getattr(import_module(f"anynet.cli.{module}"), name)
        application.command(name, short_help=summary)(command)
    return application


def _print_version(asked: bool) -> None:
    if asked:
        import anynet

        print(f"anynet {anynet.__version__}")
        raise SystemExit(0)


def _no_options() -> None:
    """Stands for the commands that are not asked for; they appear in the help only."""


@contextmanager
def _interruptible_imports() -> Iterator[None]:
    """Ends the process on Ctrl-C during an import: libraries swallow KeyboardInterrupt there, or show a traceback."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_globals.get("__name__") == "importlib._bootstrap":
                os._exit(130)
            frame = frame.f_back
        raise KeyboardInterrupt

    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not, where the parent ignores it
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _check_working_folder() -> None:
    """Libraries end the process where it is gone, each with a message of its own."""
    try:
        os.getcwd()
    except OSError as error:
        raise AnyNetError(f"the working folder cannot be used: {error.strerror}") from None


def _open_closed_streams() -> None:
    """Gives the process the standard streams that its parent has closed, so that no other file gets their place."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    tell(f"warning: {message}")
