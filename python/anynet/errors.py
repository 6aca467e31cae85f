"""The error of this package that a user can put right."""


class AnyNetError(ValueError):
    """A file, an image or an option is not usable; the message says in one line what was expected and what came."""
