"""Times exported networks beside ours, and says how far their disparities are from the predictor's.

python benchmarks/exports.py [--weights W ...] [--threads 2] [--height 368] [--width 1232] [--formats ...] [--json FILE]

All take turns on one rendered pair. Times are the processor's for one call with all stages, of all threads together:
medians, in milliseconds; ratios are medians over the turns. The network in double precision shows what is rounding, of
the exported program and of ours. Exporting takes minutes.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import HEIGHT, WIDTH, console, interleaved_ms, median_ratio, options, write_json
from numpy.typing import NDArray
from rich.table import Table

from anynet import Predictor, load_checkpoint
from anynet.checkpoint import PACKAGED
from anynet.export import FORMATS, export_as
from anynet.export.network import Request
from anynet.model.anynet import normalize
from anynet.synthetic import render

Images = list[NDArray[np.uint8]]
Disparities = list[NDArray[np.float32]]
OURS = "Predictor"
LIMIT = 0.01  # pixels


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


def in_double_precision(weights: str | Path, images: Images) -> list[NDArray[np.float64]]:
    left, right = (normalize(torch.from_numpy(image).permute(2, 0, 1)[None].double()) for image in images)
    with torch.inference_mode():
        return [disparity[0, 0].numpy() for disparity in load_checkpoint(weights).double().eval()(left, right)]


def measure(weights: str, images: Images, threads: int, formats: list[str]) -> list[dict[str, Any]]:
    """A row for the predictor and for each runner, of differences in pixels by stage and times in milliseconds."""
    predictor = Predictor(weights, threads=threads)
    calls: dict[str, Callable[[], Disparities]] = {OURS: lambda: [e.disparity for e in predictor.stages(*images)]}
    with tempfile.TemporaryDirectory() as folder:
        for format in formats:
            path = Path(folder) / f"{format}.{'onnx' if format == 'onnx' else 'pt2'}"
            export_as(format, Request(weights, *images[0].shape[:2]), path)
            calls |= runners(format, path, images, threads)
        found = {name: call() for name, call in calls.items()}
        times = interleaved_ms(calls, clock=time.process_time)
    exact = in_double_precision(weights, images)
    rows = []
    for name, disparities in found.items():
        differences = [np.abs(a - b) for a, b in zip(disparities, found[OURS], strict=True)]
        rows.append(
            {
                "name": name,
                "ms": statistics.median(times[name]),
                "ratio": median_ratio(times[name], times[OURS]),
                "from_ours": [float(d.max()) for d in differences],
                "above_limit": [100 * float((d > LIMIT).mean()) for d in differences],
                "from_double": [float(np.abs(a - b).max()) for a, b in zip(disparities, exact, strict=True)],
            }
        )
    return rows


def table(title: str, rows: list[dict[str, Any]]) -> Table:
    shown = Table(title=title)
    for column in (
        "",
        "processor's ms",
        "times ours",
        "largest difference by stage, px",
        f"more than {LIMIT} px, %",
        "from double precision, px",
    ):
        shown.add_column(column, justify="right" if column else "left")
    for row in rows:
        lists = (" ".join(f"{value:.4f}" for value in row[k]) for k in ("from_ours", "above_limit", "from_double"))
        shown.add_row(row["name"], f"{row['ms']:.1f}", f"{row['ratio']:.2f}", *lists)
    return shown


def main() -> None:
    parser = options(__doc__)
    packaged = sorted(file.stem for file in PACKAGED.glob("*.safetensors"))
    parser.add_argument("--weights", nargs="+", default=packaged)
    parser.add_argument("--height", type=int, default=HEIGHT)
    parser.add_argument("--width", type=int, default=WIDTH)
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=list(FORMATS))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    scene = render(0, given.height, given.width)
    images = [np.ascontiguousarray(scene.left), np.ascontiguousarray(scene.right)]
    report = {}
    for weights in given.weights:
        report[weights] = measure(weights, images, given.threads, given.formats)
        title = f"{weights}, {given.width} x {given.height}, {given.threads} threads"
        console().print(table(title, report[weights]))
    write_json(given.json, {"size": [given.height, given.width], "threads": given.threads, "rows": report})


if __name__ == "__main__":
    main()
