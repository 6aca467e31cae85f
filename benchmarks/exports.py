"""Times exported networks beside ours, and says how far their disparities are from the predictor's.

python benchmarks/exports.py [--weights W] [--threads 2] [--height 368] [--width 1232] [--formats ...] [--json FILE]

All take turns on one rendered pair. Times are medians of one call with all stages, in milliseconds; ratios are medians
over the turns. Exporting takes minutes.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from measure import HEIGHT, WIDTH, console, interleaved_ms, median_ratio, options, write_json
from numpy.typing import NDArray
from rich.table import Table

from anynet import Predictor
from anynet.export import FORMATS, export_as
from anynet.export.network import Request
from anynet.synthetic import render

Images = list[NDArray[np.uint8]]
Disparities = list[NDArray[np.float32]]
OURS = "Predictor"


def runners(format: str, path: Path, images: Images, threads: int) -> dict[str, Callable[[], Disparities]]:
    """Calls of an exported network by the name of what runs it."""
    if format == "onnx":
        engines = {"onnxruntime": _onnxruntime, "OpenVINO": _openvino}
        return {f"onnx, {name}": engine(path, images, threads) for name, engine in engines.items()}
    if format == "pt2":
        network: Callable[..., tuple[torch.Tensor, ...]] = torch.export.load(path).module()
    else:
        network = torch._inductor.aoti_load_package(str(path))
    tensors = [torch.from_numpy(image) for image in images]

    @torch.inference_mode()
    def run() -> Disparities:
        return [disparity.numpy() for disparity in network(*tensors)]

    return {format: run}


def _onnxruntime(path: Path, images: Images, threads: int) -> Callable[[], Disparities]:
    import onnxruntime

    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = threads
    settings.inter_op_num_threads = 1
    settings.add_session_config_entry("session.intra_op.allow_spinning", "0")  # not while the others take their turns
    session = onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])
    feed = dict(zip(("left", "right"), images, strict=True))
    return lambda: session.run(None, feed)  # type: ignore[no-any-return]


def _openvino(path: Path, images: Images, threads: int) -> Callable[[], Disparities]:
    import openvino

    settings = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_NUM_THREADS": threads, "INFERENCE_PRECISION_HINT": "f32"}
    request = openvino.Core().compile_model(path, "CPU", settings).create_infer_request()
    return lambda: list(request.infer(images).values())


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--weights", default="default")
    parser.add_argument("--height", type=int, default=HEIGHT)
    parser.add_argument("--width", type=int, default=WIDTH)
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=list(FORMATS))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    scene = render(0, given.height, given.width)
    images = [np.ascontiguousarray(scene.left), np.ascontiguousarray(scene.right)]
    predictor = Predictor(given.weights, threads=given.threads)
    calls: dict[str, Callable[[], Disparities]] = {OURS: lambda: [e.disparity for e in predictor.stages(*images)]}
    with tempfile.TemporaryDirectory() as folder:
        for format in given.formats:
            path = Path(folder) / f"{format}.{'onnx' if format == 'onnx' else 'pt2'}"
            export_as(format, Request(given.weights, given.height, given.width), path)
            calls |= runners(format, path, images, given.threads)
        expected = calls[OURS]()
        found = {name: [np.abs(a - b) for a, b in zip(call(), expected, strict=True)] for name, call in calls.items()}
        times = interleaved_ms(calls)
    table = Table(title=f"{given.weights}, {given.width} x {given.height}, {given.threads} threads")
    for column in ("", "ms", "times ours", "largest difference by stage, px", "more than 0.01 px, %"):
        table.add_column(column, justify="left" if not column else "right")
    report = []
    for name, differences in found.items():
        row = {
            "name": name,
            "ms": statistics.median(times[name]),
            "ratio": median_ratio(times[name], times[OURS]),
            "largest": [float(d.max()) for d in differences],
            "share": 100 * max(float((d > 0.01).mean()) for d in differences),
        }
        report.append(row)
        largest = " ".join(f"{value:.4f}" for value in row["largest"])
        table.add_row(name, f"{row['ms']:.1f}", f"{row['ratio']:.2f}", largest, f"{row['share']:.2f}")
    console().print(table)
    write_json(given.json, {"weights": given.weights, "size": [given.height, given.width], "rows": report})


if __name__ == "__main__":
    main()
