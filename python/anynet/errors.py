"""The error of this package that a user can put right."""


class AnyNetError(ValueError):
    """A file, an image or an option is not usable; the message says in one line what was expected and what came."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


def printable(text: str) -> str:
    """The text on one line: what a file says may end lines, or command a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(error: BaseException) -> str:
    """What the error says, at most 200 characters of it."""
    return " ".join(str(error).split())[:200] or type(error).__name__
