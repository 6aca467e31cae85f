from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from anynet.export.cut import Part, cut, run, whole
from anynet.export.network import Request, outputs, trace

from .cases import Pair


def test_the_parts_compute_what_the_whole_does(small_weights: Path, pair: Pair) -> None:
    program = trace(Request(small_weights, *pair.left.shape[:2]))
    names = outputs(4)
    parts = cut(program, names)
    images = {"left": torch.from_numpy(pair.left), "right": torch.from_numpy(pair.right)}
    assert [part.outputs[0] for part in parts] == names
    assert parts[0].inputs == ["left", "right"]
    assert parts[-1].outputs == ["disparity_4"]
    values = run(parts, images)
    for name, expected in zip(names, pair.disparities(small_weights), strict=True):
        np.testing.assert_array_equal(values[name], expected)
    assert sum(map(_operations, parts)) == _operations(whole(program, names))  # nothing twice


def _operations(part: Part) -> int:
    return sum(node.op == "call_function" for node in part.module.graph.nodes)
