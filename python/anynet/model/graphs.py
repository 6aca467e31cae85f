"""The deployed network on a GPU, its stages as CUDA graphs: a stage's dozen launches cost the host one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from anynet.model.deploy import DeployedAnyNet, StageResult
from anynet.scheduler import RecentlyUsed

SIZES = 8  # kept: the most recently seen; each takes a frame's memory on the device


class GraphedAnyNet:
    """A deployed network for uint8 RGB tensors [H, W, 3] on its CUDA device; its results are gone with the next frame.

    The first frame of a size captures the stages, one graph each; all others replay them. A frame owns the graphs of
    its size while it is on its way: where two are, each has its own.
    """

    def __init__(self, network: DeployedAnyNet) -> None:
        self._network = network
        self.config, self.refinement = network.config, network.refinement
        self._free: RecentlyUsed[list[_Graphs]] = RecentlyUsed(list, SIZES)

    def __getstate__(self) -> dict[str, Any]:
        """Without the graphs, which are this process's: another one captures its own."""
        return {**vars(self), "_free": RecentlyUsed(list, SIZES)}

    def stages(self, left: Tensor, right: Tensor) -> Iterator[StageResult]:
        """As `DeployedAnyNet.stages`; the graphs are there when this returns. Called in inference mode.

        Whoever asks for the next frame has waited for all that reads this one's results.
        """
        free = self._free[left.shape]
        try:  # another thread may be faster
            graphs = free.pop()
        except IndexError:
            graphs = _Graphs(self._network, left)
        return self._replay(graphs, free, left, right)

    @staticmethod
    def _replay(graphs: _Graphs, free: list[_Graphs], left: Tensor, right: Tensor) -> Iterator[StageResult]:
        try:
            yield from graphs.replay(left, right)
        finally:
            free.append(graphs)


class _Graphs:
    """One size's. Their memory is a pool of their own, reused in the order of the stages, in which they replay."""

    def __init__(self, network: DeployedAnyNet, like: Tensor) -> None:
        self._images = torch.zeros_like(like), torch.zeros_like(like)
        self._captured: list[tuple[torch.cuda.CUDAGraph, StageResult]] = []
        exact = torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False)
        with torch.cuda.device(like.device), exact:
            for _ in network.stages(*self._images):  # loads what is loaded at first use, which a capture must not
                pass
            stream, pool = torch.cuda.Stream(), torch.cuda.graph_pool_handle()  # type: ignore[no-untyped-call]
            steps = network.stages(*self._images)
            for _ in range(network.config.stages):
                graph = torch.cuda.CUDAGraph()
                # Other threads may do as they like meanwhile.
                with torch.cuda.graph(graph, pool=pool, stream=stream, capture_error_mode="thread_local"):
                    result = next(steps)
                self._captured.append((graph, result))

    def replay(self, left: Tensor, right: Tensor) -> Iterator[StageResult]:
        for static, image in zip(self._images, (left, right), strict=True):
            static.copy_(image)
        for graph, result in self._captured:
            graph.replay()
            yield result
