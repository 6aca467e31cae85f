from __future__ import annotations

import json
import math

from anynet.json_text import json_text


def test_what_is_not_finite_is_null() -> None:
    text = json_text({"a": [1.5, math.nan, (math.inf, "NaN")], 2: {"b": -math.inf, "c": True}})
    assert json.loads(text) == {"a": [1.5, None, [None, "NaN"]], "2": {"b": None, "c": True}}
