"""What `warnings.warn` tells, as the command line tells it."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from typing import Any, TextIO

from anynet.errors import printable


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """A list that has, at the end, what was told within, each message once."""
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            yield messages
        finally:
            messages += dict.fromkeys(str(warning.message) for warning in caught)


@contextmanager
def warnings_first() -> Iterator[list[str]]:
    """As `collected_warnings`; they are told at the end, before an error that they may explain."""
    messages: list[str] = []
    try:
        with collected_warnings() as messages:
            yield messages
    finally:
        tell_warnings(messages)


def tell(text: str) -> None:
    """One line on stderr, whatever is in the names of files; nothing where that is closed or full."""
    try:
        print("anynet:", printable(text), file=sys.stderr)
    except OSError:
        discard(sys.stderr)


def discard(stream: TextIO) -> None:
    """So that Python's last flush of what cannot be written is quiet."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def tell_warnings(messages: Iterable[str], about: str = "") -> None:
    """Each as a line on stderr, which begins with the name of what it is `about`."""
    for message in messages:
        tell(f"{about}: warning: {message}" if about else f"warning: {message}")


def telling_warnings(command: Callable[..., None]) -> Callable[..., None]:
    """The command with what it is warned of as lines on stderr, each message once."""

    @wraps(command)
    def telling(**arguments: Any) -> None:
        told: set[str] = set()

        def show(message: Warning | str, *_: Any) -> None:
            if str(message) not in told:
                told.add(str(message))
                tell_warnings([str(message)])

        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = show  # type: ignore[assignment]
            command(**arguments)

    return telling
