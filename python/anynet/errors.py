"""The error of this package that a user can put right."""


class AnyNetError(ValueError):
    """A file, an image or an option is not usable; the message says in one line what was expected and what came."""


def one_line(error: BaseException) -> str:
    """What the error says, at most 200 characters of it."""
    return " ".join(str(error).split())[:200] or type(error).__name__
