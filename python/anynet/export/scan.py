"""Spatial propagation in ONNX: one `Scan` over the lines."""

# onnxscript reads these functions' source; to mypy they are no Python.
# mypy: ignore-errors

from onnxscript import FLOAT, graph, script
from onnxscript import opset18 as op

END = 2**31 - 1
LINE, LINES = FLOAT["N", "C", "S"], FLOAT["T", "N", "C", "S"]


@script(default_opset=op)
def _scan(start: LINE, lines: LINES, smaller: LINES, same: LINES, larger: LINES) -> LINES:
    """h[t] = lines[t] + smaller[t] * h[t - 1] one row up + same[t] * h[t - 1] + larger[t] * h[t - 1] one row down"""

    @graph()
    def step(before: LINE, line: LINE, to_smaller: LINE, to_same: LINE, to_larger: LINE):
        padded = op.Pad(before, op.Constant(value_ints=[0, 0, 1, 0, 0, 1]))
        axis = op.Constant(value_ints=[2])
        up = op.Slice(padded, op.Constant(value_ints=[0]), op.Constant(value_ints=[-2]), axis)
        down = op.Slice(padded, axis, op.Constant(value_ints=[2147483647]), axis)
        sides = op.Add(op.Mul(to_smaller, up), op.Mul(to_larger, down))
        now = op.Add(op.Add(line, op.Mul(to_same, before)), sides)
        return now, op.Identity(now)

    _last, every = op.Scan(start, lines, smaller, same, larger, body=step, num_scan_inputs=4)
    return every


def spatial_propagation(input: FLOAT, gates: FLOAT, direction: int) -> FLOAT:
    """`anynet_ext.spatial_propagation` of [N, C, H, W] and [N, 3, C, H, W], as the exporter calls it."""
    along_rows, backwards = direction < 2, direction % 2 == 1
    to_lines = [3, 0, 1, 2] if along_rows else [2, 0, 1, 3]
    from_lines = [1, 2, 3, 0] if along_rows else [1, 2, 0, 3]

    def ints(*values: int) -> FLOAT:
        return op.Constant(value_ints=list(values))

    def flipped(lines: FLOAT) -> FLOAT:
        return op.Slice(lines, ints(-1), ints(-END), ints(0), ints(-1)) if backwards else lines

    def inner(gate: int, starts: list[int], ends: list[int]) -> FLOAT:
        """A gate's lines [T, N, C, S]; zero in the first one, and where there is no such neighbor."""
        lines = flipped(op.Transpose(op.Gather(gates, op.Constant(value_int=gate), axis=1), perm=to_lines))
        kept = op.Slice(lines, ints(1, *starts), ints(END, *ends), ints(0, 3))
        return op.Pad(kept, ints(1, 0, 0, starts[0], 0, 0, 0, int(ends[0] < 0)))

    smaller, same, larger = inner(0, [1], [END]), inner(1, [0], [END]), inner(2, [0], [-1])
    lines = flipped(op.Transpose(input, perm=to_lines))
    one = op.Constant(value_float=1.0)
    weighed = op.Mul(op.Sub(one, op.Add(op.Add(smaller, same), larger)), lines)
    start = op.Mul(op.Gather(lines, op.Constant(value_int=0), axis=0), op.Constant(value_float=0.0))
    return op.Transpose(flipped(_scan(start, weighed, smaller, same, larger)), perm=from_lines)
