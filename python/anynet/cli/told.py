"""What `warnings.warn` tells, as the command line tells it."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """A list that has, at the end, what was told within, each message once."""
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield messages
    messages += dict.fromkeys(str(warning.message) for warning in caught)


def tell(messages: Iterable[str]) -> None:
    """Each as a line on stderr."""
    for message in messages:
        print(f"anynet: warning: {message}", file=sys.stderr)


def telling_warnings(command: Callable[..., None]) -> Callable[..., None]:
    """The command with what it is warned of as lines on stderr, each message once."""

    @wraps(command)
    def telling(**arguments: Any) -> None:
        told: set[str] = set()

        def show(message: Warning | str, *_: Any) -> None:
            if str(message) not in told:
                told.add(str(message))
                tell([str(message)])

        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = show  # type: ignore[assignment]
            command(**arguments)

    return telling
