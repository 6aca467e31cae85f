"""What else computes the network, or disparities, each with its best settings: the peers of pipeline.py."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
import torch
from measure import PlainOperators, pair
from rich.console import Console
from torch import Tensor, nn

from anynet import AnyNet, load_checkpoint
from anynet.model.config import MEAN, STD


class Plain(nn.Module):
    """The first stages of a network, on PyTorch's own operators."""

    def __init__(self, model: AnyNet, stages: int) -> None:
        super().__init__()
        self.model, self.stages = model, stages

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        with PlainOperators():
            estimates: list[Tensor] = self.model(left, right, self.stages)
        return estimates[-1]


@contextmanager
def peers(weights: str, threads: int, out: Console) -> Iterator[dict[str, Callable[[], object]]]:
    """Calls of one pair by the name of the peer."""
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    left, right = pair()
    tensors = tuple(
        torch.from_numpy((image / 255 - MEAN) / STD).permute(2, 0, 1)[None].float().contiguous()
        for image in (left, right)
    )
    calls: dict[str, Callable[[], object]] = {}
    model = load_checkpoint(weights)
    with torch.no_grad(), tempfile.TemporaryDirectory() as folder:
        for stages in (1, 3, 4):
            plain = Plain(model, stages).eval()
            calls[f"eager, {stages} stages"] = lambda plain=plain: plain(*tensors)
        plain = Plain(model, 3).eval()
        expected = plain(*tensors)

        def check(name: str, estimate: Tensor) -> None:
            if not torch.allclose(estimate, expected, atol=0.05):
                out.print(f"{name}: differs from eager by up to {(estimate - expected).abs().max():.3f} px")

        torch._dynamo.reset()
        with torch._inductor.config.patch(freezing=True):
            compiled = torch.compile(torch.export.export(plain, tensors).module())
            check("torch.compile", compiled(*tensors))
        calls["torch.compile, 3 stages"] = lambda: compiled(*tensors)

        path = f"{folder}/three_stages.onnx"
        torch.onnx.export(plain, tensors, path, dynamo=True, optimize=True, verbose=False)
        calls |= _onnx_peers(path, tensors, threads, check)
        gray = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right)]
        matcher = cv2.StereoBM.create(numDisparities=192, blockSize=15)
        calls["OpenCV StereoBM"] = lambda: matcher.compute(*gray)
        semi_global = cv2.StereoSGBM.create(minDisparity=0, numDisparities=192, blockSize=5, P1=200, P2=800)
        calls["OpenCV StereoSGBM"] = lambda: semi_global.compute(*gray)
        yield calls


def _onnx_peers(
    path: str, tensors: tuple[Tensor, ...], threads: int, check: Callable[[str, Tensor], None]
) -> dict[str, Callable[[], object]]:
    import onnxruntime
    import openvino

    arrays = [t.numpy() for t in tensors]
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # not while the others take their turns
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    feed = {node.name: array for node, array in zip(session.get_inputs(), arrays, strict=True)}
    check("onnxruntime", torch.from_numpy(session.run(None, feed)[0]))

    core = openvino.Core()
    settings = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_NUM_THREADS": threads, "INFERENCE_PRECISION_HINT": "f32"}
    request = core.compile_model(path, "CPU", settings).create_infer_request()
    check("openvino", torch.from_numpy(request.infer(arrays)[0]))
    return {
        "onnxruntime, 3 stages": lambda: session.run(None, feed),
        "openvino, 3 stages": lambda: request.infer(arrays),
    }
