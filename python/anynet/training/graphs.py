"""The training step on a GPU, as one CUDA graph: its thousands of launches cost the host one."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

WARM_UP = 3  # steps as they are: what is loaded or allocated at first use, a capture must not


class GraphedStep:
    """A function of batches of one shape, pinned or on its device, that decides nothing by their values."""

    def __init__(self, step: Callable[[list[Tensor]], Tensor], device: torch.device) -> None:
        self._step, self._device, self._calls = step, device, 0
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self, batch: list[Tensor]) -> Tensor:
        """As the function itself; the result is gone with the next call. The host waits for the capture alone."""
        self._calls += 1
        if self._calls <= WARM_UP:
            return self._step(batch)
        if self._graph is None:
            self._batch = [torch.empty_like(tensor, device=self._device) for tensor in batch]
            graph = torch.cuda.CUDAGraph()
            # Data loaders pin memory meanwhile.
            with torch.cuda.device(self._device), torch.cuda.graph(graph, capture_error_mode="thread_local"):
                self._result = self._step(self._batch)
            self._graph = graph
        for static, tensor in zip(self._batch, batch, strict=True):
            static.copy_(tensor, non_blocking=True)
        self._graph.replay()
        return self._result
