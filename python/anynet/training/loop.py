"""The training loop: data, loss, optimizer, log, checkpoints."""

from __future__ import annotations

import copy
import io
import json
import math
import os
import time
import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from anynet.baselines.model import BaselineModel, load_baseline, random_baseline, stored_config
from anynet.checkpoint import find_weights, load_checkpoint, load_partial, save_checkpoint
from anynet.data import StereoSample, open_dataset
from anynet.data.registry import joined
from anynet.device import HostCopy
from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import Evaluation, evaluate
from anynet.evaluation.methods import open_method
from anynet.evaluation.truth import check_counted
from anynet.io.files import read_bytes, telling_damage, write_atomically
from anynet.model.anynet import AnyNet, normalize
from anynet.training.batches import batches, telling_killed_workers
from anynet.training.distributed import Processes, process_group, synchronize_batch_norm
from anynet.training.graphs import GraphedStep
from anynet.training.log import RunLog
from anynet.training.loss import loss_weights, stage_losses
from anynet.training.recipe import Recipe
from anynet.training.run_folder import CHECKPOINT, LOG, RECIPE, WEIGHTS, check_free, locked
from anynet.waiting import waiting


def train(
    recipe: Recipe,
    out: str | os.PathLike[str],
    *,
    resume: bool = False,
    data: Sequence[StereoSample] | None = None,
    validation: dict[str, Sequence[StereoSample]] | None = None,
) -> Path:
    """Trains a network; returns the file of its weights, `out`/weights.safetensors.

    The folder `out` also gets recipe.json, log.jsonl (one line per `log_every` steps: losses in pixels, learning rate,
    norm of the gradient, seconds) and checkpoint.pt, from which a run that was interrupted goes on.

    Args:
        recipe: what to do.
        out: a folder; made if need be.
        resume: go on from the checkpoint in `out`, or begin, where there is none. The run then ends in the same weights
            as one that was never interrupted.
        data, validation: samples (by name, for validation) in place of those that the recipe names.

    Raises:
        AnyNetError: `out` holds a run already and `resume` is false; or it is the run of another recipe, or one that
            another process is busy with; or the loss is no longer finite; or there is nothing to train on.
    """
    out = Path(out)
    if recipe.threads is not None:
        torch.set_num_threads(recipe.threads)
    parts: list[tuple[str, Sequence[StereoSample]]]
    if data is None:
        opened = [open_dataset(spec) for spec in recipe.data]
        parts = [(f"data {spec}", part) for spec, part in zip(recipe.data, opened, strict=True)]
        data = joined(opened)
    else:
        parts = [("data", data)]
    if validation is None:
        validation = {name: open_dataset(name) for name in recipe.validation}
    if not len(data):
        raise AnyNetError("expected pairs to train on (data), got none")
    with process_group(recipe.device) as group, locked(out) if group.is_main else nullcontext():
        if recipe.amp and group.device.type == "cpu" and group.is_main:
            warnings.warn("amp is for CUDA: on a CPU it saves no time", stacklevel=2)
        if group.is_main:
            for what, samples in (*parts, *((f"validation {name}", v) for name, v in validation.items())):
                check_counted(what, samples)
            recipe.warn_of_lengths(recipe.length(len(data)))
            check_free(recipe, out, resume)
        group.barrier()
        with telling_killed_workers():
            return _Run(recipe, out, data, validation, group).go()


def _begun(recipe: Recipe) -> AnyNet | BaselineModel:
    """The network as the run begins with it."""
    network, scale = recipe.network, recipe.input_scale
    if recipe.model is not None:
        return random_baseline(recipe.model, scale)
    if recipe.weights is None:
        return AnyNet(network)
    if recipe.load_partial:
        return load_partial(recipe.weights, network if scale is None else network.with_input_scale(scale))
    if stored_config(find_weights(recipe.weights)) is not None:
        return load_baseline(recipe.weights, scale)
    return load_checkpoint(recipe.weights, scale)


@dataclass(frozen=True)
class _Step:
    """A step that is on its way: its number, from 1, each stage's loss and the norm of the gradient, and times."""

    number: int
    values: HostCopy
    seconds: float
    waited: float


class _Run:
    """A run at some step: model, optimizer and the running average of the weights are all its state."""

    def __init__(
        self,
        recipe: Recipe,
        out: Path,
        data: Sequence[StereoSample],
        validation: dict[str, Sequence[StereoSample]],
        group: Processes,
    ) -> None:
        self.recipe, self.out, self.data, self.validation, self.group = recipe, out, data, validation, group
        self.steps = recipe.length(len(data))
        torch.manual_seed(recipe.seed)
        self.model = _begun(recipe)
        self.model.to(group.device).train()
        usual = self.model.loss_weights if isinstance(self.model, BaselineModel) else ()
        count = self.model.config.stages if isinstance(self.model, AnyNet) else len(usual)
        weights = recipe.stage_weights_of(count, usual)
        self.stages = max(stage for stage, weight in enumerate(weights, 1) if weight > 0)
        self.stage_weights = torch.tensor(weights[: self.stages], device=group.device)
        self.average = copy.deepcopy(self.model)
        self.parallel: nn.Module = self.model
        if group.world_size > 1:
            synchronize_batch_norm(self.model, group.device)
            unused = self.stages < count
            self.parallel = DistributedDataParallel(self.model, broadcast_buffers=False, find_unused_parameters=unused)
        self.optimizer = torch.optim.Adam(self.model.parameters(), recipe.learning_rate, fused=True)
        self.step = 0
        if os.path.exists(out / CHECKPOINT):
            self._restore()
        graphed = group.device.type == "cuda" and group.world_size == 1
        self._compute = GraphedStep(self._computed, group.device) if graphed else self._computed
        for parameters in self.optimizer.param_groups:  # wherever the checkpoint comes from
            parameters["capturable"] = graphed
            parameters["lr"] = torch.zeros((), device=group.device) if graphed else 0.0

    def go(self) -> Path:
        recipe = self.recipe
        loader = batches(self.data, recipe, range(self.step, self.steps), self.group)
        validate_every = recipe.validate_every or self.steps
        path = self.out / LOG if self.group.is_main else None
        events = self.out / "tensorboard" if self.group.is_main and recipe.tensorboard else None
        with RunLog(path, self.step, self.steps, recipe.log_every, events) as log:
            before, first = None, self.step
            while self.step < self.steps:
                waiting().adapt()
                began = time.perf_counter()
                batch = next(loader)
                waited = time.perf_counter() - began
                values = HostCopy(self._update(batch))
                if self.group.is_main and self.step == first + 1:  # only now, so that mistakes leave the folder free
                    write_atomically(self.out / RECIPE, recipe.to_json().encode())
                if before is not None:
                    self._tell(log, before)  # only now: a GPU is not to stand still meanwhile
                before = _Step(self.step, values, time.perf_counter() - began, waited)
                last = self.step == self.steps
                saves = last or self.step % recipe.checkpoint_every == 0
                validates = bool(self.validation) and (last or self.step % validate_every == 0)
                if saves or validates:
                    self._tell(log, before)  # which sees that it is sound
                    before = None
                if self.group.is_main and validates:  # first: a run that goes on begins after what is saved
                    log.validation(self.step, self._validate())
                if validates:
                    self.group.barrier()
                if self.group.is_main and saves:
                    self._save()
            if self.group.is_main:
                self._export()
        return self.out / WEIGHTS

    def _update(self, batch: list[Tensor]) -> Tensor:
        """One step of the optimizer; returns each stage's loss (pixels) and the norm of the gradient, on the device.

        Unless they are all finite, the weights stay what they are. The host waits for nothing.
        """
        rate = self.recipe.learning_rate_at(self.step, self.steps)
        for parameters in self.optimizer.param_groups:
            if isinstance(parameters["lr"], Tensor):
                parameters["lr"].fill_(rate)
            else:
                parameters["lr"] = rate
        values = self._compute(batch)
        self.step += 1
        return values

    def _computed(self, batch: list[Tensor]) -> Tensor:
        """All of `_update` that happens on the device."""
        recipe, group = self.recipe, self.group
        left, right, disparity, weights = (tensor.to(group.device, non_blocking=True) for tensor in batch)
        weights = loss_weights(disparity, weights)
        total = group.all_reduce_sum(weights.sum()).clamp(min=1)
        with torch.autocast(group.device.type, torch.bfloat16, enabled=recipe.amp):
            outputs = self.parallel(normalize(left), normalize(right), self.stages)
        losses = stage_losses(outputs, disparity, weights, total, recipe.smooth_below, recipe.robust_scale)
        # DistributedDataParallel averages the gradients; the losses of the processes are parts of one sum.
        (group.world_size * (losses * self.stage_weights).sum()).backward()  # type: ignore[no-untyped-call]
        grad_norm = nn.utils.clip_grad_norm_(self.model.parameters(), recipe.max_grad_norm or math.inf, foreach=True)
        values = torch.cat([group.all_reduce_sum(losses.detach()), grad_norm[None]])
        # By which a GradScaler tells an optimizer to change nothing.
        self.optimizer.found_inf = values.isfinite().all().logical_not().float()  # type: ignore[attr-defined]
        self.optimizer.step()
        self.optimizer.zero_grad()
        self._move_average()
        return values

    @torch.no_grad()
    def _move_average(self) -> None:
        """Towards the weights; the first step sets it. (PyTorch's AveragedModel has the host wait for a GPU.)"""
        pairs = list(zip(self.average.state_dict().values(), self.model.state_dict().values(), strict=True))
        averages, now = zip(*[pair for pair in pairs if pair[0].is_floating_point()], strict=True)
        torch._foreach_lerp_(averages, now, 1 - self.recipe.ema_decay if self.step else 1.0)
        for average, count in pairs:
            if not average.is_floating_point():
                average.copy_(count)

    def _tell(self, log: RunLog, step: _Step) -> None:
        """Logs the step, when it is there.

        Raises:
            AnyNetError: if its values are not finite.
        """
        *losses, grad_norm = step.values.tolist()
        for stage, value in enumerate(losses, 1):
            if not math.isfinite(value):
                raise AnyNetError(
                    f"the loss of stage {stage} became {value} at step {step.number}: "
                    f"resume from {self.out / CHECKPOINT} with other data, or begin again with a smaller learning rate"
                )
        if not math.isfinite(grad_norm):
            raise AnyNetError(f"the gradient became {grad_norm} at step {step.number}, the losses being {losses}")
        rate = self.recipe.learning_rate_at(step.number - 1, self.steps)
        log.step(step.number, losses, grad_norm, rate, step.seconds, step.waited)

    def _save(self) -> None:
        state = {
            "step": self.step,
            "samples": len(self.data),
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        content = io.BytesIO()
        torch.save(state, content)
        write_atomically(self.out / CHECKPOINT, content.getvalue())

    def _restore(self) -> None:
        # The data and the learning rate of a step follow from its number, and nothing else in a step is random.
        path = self.out / CHECKPOINT
        content = io.BytesIO(read_bytes(path))
        with telling_damage(path, "not a sound checkpoint of this run"):
            state = torch.load(content, map_location=self.group.device, weights_only=True)
            if (samples := state.get("samples", len(self.data))) != len(self.data):  # the order goes by it
                raise AnyNetError(f"{path}: expected {samples} pairs, as when the run began, got {len(self.data)}")
            if not isinstance(state["step"], int) or not 0 <= state["step"] <= self.steps:
                raise AnyNetError(f"{path}: expected a step from 0 to {self.steps}, got {state['step']}")
            self.step = state["step"]
            self.model.load_state_dict(state["model"])
            self.average.load_state_dict(state["average"])
            self.optimizer.load_state_dict(state["optimizer"])

    def _export(self) -> None:
        recipe = json.loads(self.recipe.to_json())
        save_checkpoint(
            self.out / WEIGHTS,
            self.average,
            {"recipe": recipe, "steps": self.step},
        )

    def _validate(self) -> dict[str, Evaluation]:
        self._export()
        method = open_method(self.out / WEIGHTS, threads=self.recipe.threads)
        return {name: evaluate(method, samples) for name, samples in self.validation.items()}
