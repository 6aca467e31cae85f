from __future__ import annotations

import pytest

from anynet.errors import AnyNetError, one_line, printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a/b.png: größer, 3 x 4", "a/b.png: größer, 3 x 4"),
        ("two\nlines\r\n", r"two\nlines\r\n"),
        ("\x1b[31mred\x07\u2028", r"\x1b[31mred\x07\u2028"),
        ("caf\udce9", r"caf\udce9"),  # a file's name that is not UTF-8
        ("", ""),
    ],
)
def test_a_message_is_one_line_that_commands_no_terminal(text: str, shown: str) -> None:
    assert printable(text) == shown
    assert str(AnyNetError(text)) == shown


def test_what_another_error_says() -> None:
    assert one_line(ValueError("a\n  b")) == "a b"
    assert one_line(KeyError()) == "KeyError"
    assert len(one_line(ValueError("x" * 1000))) == 200
