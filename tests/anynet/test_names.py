from __future__ import annotations

import pytest

from anynet.names import listed


@pytest.mark.parametrize(
    ("most", "expected"), [(1, "a (and 2 more)"), (2, "a, b (and 1 more)"), (3, "a, b, c"), (4, "a, b, c")]
)
def test_a_list_says_how_many_more_there_are(most: int, expected: str) -> None:
    assert listed(["a", "b", "c"], most) == expected
