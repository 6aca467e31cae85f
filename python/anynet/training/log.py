"""What a run tells: a progress bar (or lines, where there is no terminal), log.jsonl, TensorBoard."""

from __future__ import annotations

import json
import math
from datetime import timedelta
from pathlib import Path
from statistics import fmean
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import Evaluation
from anynet.io.files import read_bytes, write_atomically
from anynet.json_text import json_text


class RunLog:
    """One line of JSON per `every` steps with their means, and one per validation.

    Args:
        path: the .jsonl file; lines beyond `step`, which an interrupted run left, are dropped. None: say nothing.
        step, steps: where the run is, and its length.
        every: steps per line.
        tensorboard: a folder for TensorBoard's events, or None.
    """

    def __init__(self, path: Path | None, step: int, steps: int, every: int, tensorboard: Path | None) -> None:
        self._steps, self._every = steps, every
        self._console = Console(stderr=True, quiet=path is None, markup=False, soft_wrap=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._progress.add_task("training", total=steps, completed=step)
        self._file = None
        if path is not None:
            lines = read_bytes(path).splitlines(keepends=True) if path.exists() else []
            write_atomically(path, b"".join(line for line in lines if _step_of(line) <= step))
            self._file = path.open("a")
        self._events = _events(tensorboard) if tensorboard is not None else None
        self._recent: list[list[float]] = []

    def __enter__(self) -> RunLog:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()
        if self._file is not None:
            self._file.close()
        if self._events is not None:
            self._events.close()

    def step(
        self, step: int, losses: list[float], grad_norm: float, learning_rate: float, seconds: float, waited: float
    ) -> None:
        """Step number `step` (from 1) is done.

        losses: of each stage, in pixels; seconds: what it took, `waited` of them for its data.
        """
        self._recent.append([*losses, grad_norm, seconds, waited])
        described = "loss " + " ".join(f"{loss:.2f}" for loss in losses)
        self._progress.update(self._task, completed=step, description=described)
        if step % self._every and step != self._steps:
            return
        *losses, grad_norm, seconds, waited = (round(fmean(column), 4) for column in zip(*self._recent, strict=True))
        self._recent.clear()
        line = {
            "losses": losses,
            "grad_norm": grad_norm,
            "learning_rate": learning_rate,
            "seconds": seconds,
            "waited": waited,
        }
        self._write({"step": step, **line})
        if not self._console.is_terminal:
            left = timedelta(seconds=round(seconds * (self._steps - step)))
            means = " ".join(f"{loss:.2f}" for loss in losses)
            self._console.print(f"step {step} of {self._steps}  loss {means}  {seconds:.2f} s/step  {left} left")
        if self._events is not None:
            for stage, loss in enumerate(losses, 1):
                self._events.add_scalar(f"loss/stage {stage}", loss, step)
            self._events.add_scalar("grad_norm", grad_norm, step)
            self._events.add_scalar("learning_rate", learning_rate, step)

    def validation(self, step: int, results: dict[str, Evaluation]) -> None:
        """Measured after `step`, by data set."""
        for name, result in results.items():
            d1, epe = ([getattr(stage.mean, metric) for stage in result.stages] for metric in ("d1", "epe"))
            self._write({"step": step, "validation": name, "d1": d1, "epe": epe})
            d1_text, epe_text = (" ".join(f"{value:.2f}" for value in values) for values in (d1, epe))
            self._console.print(f"step {step}  {name}  D1 {d1_text} %  EPE {epe_text} px")
            if self._events is not None:
                for stage, value in enumerate(d1, 1):
                    self._events.add_scalar(f"{name}/D1 stage {stage}", value, step)

    def _write(self, line: dict[str, Any]) -> None:
        if self._file is not None:
            self._file.write(json_text(line) + "\n")
            self._file.flush()


def _step_of(line: bytes) -> float:
    """The step that a line tells of; of damaged ones, which a machine that lost its power may leave, infinity."""
    try:
        return float(json.loads(line)["step"]) if line.endswith(b"\n") else math.inf
    except (KeyError, OverflowError, RecursionError, TypeError, ValueError):
        return math.inf


def _events(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise AnyNetError("TensorBoard is not installed: pip install 'anynet[train]'") from None
    return SummaryWriter(folder)
