"""Training runs: learning, resuming, stopping."""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import time
from contextlib import nullcontext
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from planes import RECIPE, Planes, begun, finish, log_lines, start
from safetensors.torch import load_file
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from anynet import cli
from anynet.baselines.model import MODELS
from anynet.checkpoint import load_checkpoint
from anynet.data import StereoSample
from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import Evaluation
from anynet.io import write_disparity, write_image
from anynet.model.anynet import AnyNet
from anynet.model.config import AnyNetConfig, FirstStageConfig
from anynet.training import loop, run_folder
from anynet.training.loop import train
from anynet.training.run_folder import CHECKPOINT, LOG, WEIGHTS
from anynet.training.run_folder import RECIPE as RECIPE_FILE


def test_the_loss_falls_and_the_weights_are_measured(tmp_path: Path) -> None:
    recipe = replace(RECIPE, steps=40, validate_every=40)
    weights = train(recipe, tmp_path, data=Planes(10), validation={"planes": Planes(2)})
    *steps, validation = log_lines(tmp_path)
    assert [line["step"] for line in steps] == list(range(1, 41))
    assert np.mean([line["losses"] for line in steps[-5:]]) < 0.5 * np.mean([line["losses"] for line in steps[:5]])
    assert validation["validation"] == "planes"
    assert len(validation["d1"]) == 4
    assert weights == tmp_path / WEIGHTS


@pytest.mark.parametrize("step", [2, 4])
def test_an_interrupted_validation_is_made_on_resuming(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    recipe = replace(RECIPE, steps=4, validate_every=2)

    def interrupted(run: loop._Run) -> dict[str, Evaluation]:
        if run.step == step:
            raise KeyboardInterrupt
        return {}

    with monkeypatch.context() as patch:
        patch.setattr(loop._Run, "_validate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(recipe, tmp_path, data=Planes(4), validation={"planes": Planes(1)})
    train(recipe, tmp_path, resume=True, data=Planes(4), validation={"planes": Planes(1)})
    validated = [line["step"] for line in log_lines(tmp_path) if "validation" in line]
    assert step in validated


@pytest.mark.slow
def test_killed_and_resumed_gives_the_same_weights(tmp_path: Path) -> None:
    finish(start(tmp_path / "whole", workers=1, ema_decay=0.9))
    killed = start(tmp_path / "killed", workers=1, ema_decay=0.9)
    while not (tmp_path / "killed" / CHECKPOINT).exists():
        assert killed.poll() is None, killed.communicate()
        time.sleep(0.01)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert not (tmp_path / "killed" / WEIGHTS).exists(), "it was over before it was killed"
    finish(start(tmp_path / "killed", workers=0, ema_decay=0.9))
    whole, resumed = (load_file(tmp_path / name / WEIGHTS) for name in ("whole", "killed"))
    assert all(torch.equal(resumed[name], tensor) for name, tensor in whole.items())
    for name in ("step", "losses", "grad_norm", "learning_rate"):
        told = [[line[name] for line in log_lines(tmp_path / run)] for run in ("whole", "killed")]
        assert told[1] == told[0]


def test_a_loss_that_is_not_finite_stops_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def spoiled(self: AnyNet, left: torch.Tensor, right: torch.Tensor, stages: int) -> list[torch.Tensor]:
        calls.append(0)
        outputs = list(self.stages(left, right))
        return [*outputs[:2], outputs[2] * float("nan"), outputs[3]] if len(calls) == 6 else outputs

    monkeypatch.setattr(AnyNet, "forward", spoiled)
    with pytest.raises(AnyNetError, match="loss of stage 3 became nan at step 6"):
        train(RECIPE, tmp_path, data=Planes(10))
    state = torch.load(tmp_path / CHECKPOINT, weights_only=True)
    assert state["step"] == 4
    assert all(tensor.isfinite().all() for tensor in state["model"].values())


@pytest.mark.parametrize("spoiled", ["loss", "gradient"])
def test_a_step_that_is_not_finite_changes_nothing(tmp_path: Path, spoiled: str) -> None:
    run, batch = begun(tmp_path)
    run._update(batch)

    def state() -> list[Tensor]:
        moments = [value.clone() for each in run.optimizer.state.values() for value in each.values()]
        return [parameter.detach().clone() for parameter in run.model.parameters()] + moments

    before = state()
    weight = next(run.model.parameters())
    hook = weight.register_hook(lambda gradient: gradient * torch.inf)
    left, right, disparity, weights = batch
    if spoiled == "loss":
        weights = weights.clone()
        weights[0, 0, 60, 60] = torch.nan
    *losses, grad_norm = run._update([left, right, disparity, weights]).tolist()
    assert all(np.isfinite(losses)) == (spoiled == "gradient")
    assert not np.isfinite(grad_norm)
    assert all(torch.equal(one, other) for one, other in zip(state(), before, strict=True))
    hook.remove()
    assert run._update(batch).isfinite().all()
    assert not any(torch.equal(one, other) for one, other in zip(state(), before, strict=True))


def test_a_run_goes_on_from_the_checkpoint_of_a_gpu(tmp_path: Path) -> None:
    """Its optimizer has the learning rate as a tensor, fit for a capture."""
    run, batch = begun(tmp_path)
    run._update(batch)
    run.optimizer.param_groups[0].update(lr=torch.tensor(0.1), capturable=True)
    run._save()
    here, _ = begun(tmp_path)
    assert here.step == 1
    run.optimizer.param_groups[0].update(lr=0.0, capturable=False)
    assert torch.equal(here._update(batch), run._update(batch))
    for one, other in zip(here.model.parameters(), run.model.parameters(), strict=True):
        assert torch.equal(one, other)


class HostWaits(TorchDispatchMode):
    """Notes what would have the host wait for a GPU: operators that read a value, and copies from device to device."""

    def __init__(self) -> None:
        super().__init__()
        self.operators: list[str] = []
        self.copies = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        leaves = torch.utils._pytree.tree_leaves([args, kwargs, out])
        devices = {leaf.device for leaf in leaves if isinstance(leaf, Tensor)}
        if len(devices) > 1 and (kwargs or {}).get("non_blocking"):
            self.copies += 1
        elif len(devices) > 1 or func._opname in ("_local_scalar_dense", "is_nonzero", "nonzero", "masked_select"):
            self.operators.append(str(func))
        return out


@pytest.mark.parametrize("amp", [False, True])
def test_a_step_reads_no_value(tmp_path: Path, amp: bool) -> None:
    run, batch = begun(tmp_path, amp=amp, ema_decay=0.9)
    with HostWaits() as waits:
        for _ in range(2):
            values = run._update(batch)
    assert waits.operators == []
    with waits:
        values[0].item()
    assert waits.operators == ["aten._local_scalar_dense.default"]


@pytest.mark.parametrize("model", [None, *sorted(MODELS)])
def test_only_the_batch_goes_from_the_host_to_the_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, model: str | None
) -> None:
    """Nor could more, while a graph is captured.

    The device is `meta`, which has no values to read, and of which PyTorch's optimizers know nothing.
    """
    for module, kind in (("torch.utils._foreach_utils", "foreach"), ("torch.optim.optimizer", "fused")):
        monkeypatch.setattr(import_module(module), f"_get_{kind}_kernels_supported_devices", lambda: ["meta"])
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    monkeypatch.setattr(torch, "is_autocast_enabled", lambda _: False)
    run, batch = begun(tmp_path, "meta", ema_decay=0.9, model=model)
    with HostWaits() as waits:
        for _ in range(2):
            assert run._update(batch).is_meta
    assert waits.operators == []
    assert waits.copies == 2 * len(batch)


def test_the_average_is_exponential_and_begins_with_the_first_step(tmp_path: Path) -> None:
    run, batch = begun(tmp_path, ema_decay=0.75)
    expected: dict[str, Tensor] = {}
    for _ in range(3):
        run._update(batch)
        now = run.model.state_dict()
        expected = {name: value + 0.75 * (expected.get(name, value) - value) for name, value in now.items()}
    for name, value in run.average.state_dict().items():
        if value.is_floating_point():
            torch.testing.assert_close(value, expected[name], msg=name)
        else:
            assert value == 3, name


def test_two_processes_do_not_train_in_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = start(tmp_path, steps=100_000)
    try:
        while not ((tmp_path / LOG).exists() and log_lines(tmp_path)):  # until its data worker watches it
            assert first.poll() is None
            time.sleep(0.05)
        monkeypatch.setattr(run_folder, "PATIENCE", 0.1)
        with pytest.raises(AnyNetError, match="another process is training there"):
            train(replace(RECIPE, steps=100_000), tmp_path, data=Planes(10), resume=True)
    finally:
        first.kill()
        first.communicate()
    monkeypatch.undo()
    with pytest.raises(AnyNetError, match="steps was 100000"):  # not the lock, which went with its process
        train(replace(RECIPE, steps=5), tmp_path, data=Planes(10), resume=True)


KILLED = r"a worker (was killed \(Killed\)|failed or was killed), perhaps for lack of memory: go on with --resume and "


def test_a_killed_worker_is_told(tmp_path: Path) -> None:
    class Deadly(Planes):
        def __getitem__(self, index: int) -> StereoSample:  # type: ignore[override]
            if multiprocessing.parent_process() is not None:
                os.kill(os.getpid(), signal.SIGKILL)
            return super().__getitem__(index)

    with pytest.raises(AnyNetError, match=KILLED):
        train(replace(RECIPE, workers=1), tmp_path, data=Deadly(70))  # more than are decoded beforehand


def test_a_folder_with_a_run_is_not_overwritten(tmp_path: Path) -> None:
    recipe = replace(RECIPE, steps=2)
    train(recipe, tmp_path, data=Planes(4))
    with pytest.raises(AnyNetError, match="holds a run already"):
        train(recipe, tmp_path, data=Planes(4))
    with pytest.raises(AnyNetError, match=r"learning_rate was 0.002 when the run began, so it cannot be 0.1"):
        train(replace(recipe, learning_rate=0.1), tmp_path, data=Planes(4), resume=True)


def test_a_checkpoint_without_its_recipe_is_kept(stopped):
    recipe, out = stopped
    (out / RECIPE_FILE).unlink()
    before = (out / CHECKPOINT).read_bytes()
    with pytest.raises(AnyNetError, match="holds a run already"):
        train(replace(recipe, learning_rate=0.1), out, data=Planes(10))
    assert (out / CHECKPOINT).read_bytes() == before
    train(recipe, out, resume=True, data=Planes(10))
    assert [line["step"] for line in log_lines(out)] == [1, 2, 3]


def test_a_first_step_that_fails_leaves_the_folder_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_memory(*_: object) -> None:
        raise torch.OutOfMemoryError

    with monkeypatch.context() as patch:
        patch.setattr(loop._Run, "_computed", no_memory)
        with pytest.raises(torch.OutOfMemoryError):
            train(RECIPE, tmp_path, data=Planes(4))
    train(replace(RECIPE, steps=1), tmp_path, data=Planes(4))


def test_stage_weights_must_fit_the_network(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected 4, one per stage, got 3"):
        train(replace(RECIPE, stage_weights=(1.0, 1.0, 1.0)), tmp_path, data=Planes(4))


def test_a_mistake_in_the_options_leaves_the_folder_free(tmp_path: Path) -> None:
    right = replace(RECIPE, steps=1)
    for wrong, message in (
        (replace(right, stage_weights=(1.0,)), "stage_weights"),
        (replace(right, weights="nowhere"), "expected a file of weights"),
        (replace(right, crop_size=(64, 512)), "does not fit"),
        (replace(right, steps=None), "steps or epochs"),
    ):
        with pytest.raises(AnyNetError, match=message):
            train(wrong, tmp_path, data=Planes(4))
    train(right, tmp_path, data=Planes(4))


def test_stages_without_weight_neither_run_nor_change(tmp_path: Path) -> None:
    torch.manual_seed(RECIPE.seed)
    before = AnyNet().state_dict()
    after = load_file(train(replace(RECIPE, steps=2, stage_weights=(1.0, 0.5, 0.0, 0.0)), tmp_path, data=Planes(4)))
    assert all(len(line["losses"]) == 2 for line in log_lines(tmp_path))
    for part, changes in (
        ("first_stage", True),
        ("residual_stages.0", True),
        ("residual_stages.1", False),
        ("refinement", False),
    ):
        same = [torch.equal(after[name], value) for name, value in before.items() if name.startswith(part)]
        assert not any(same) if changes else all(same), part


def test_partial_weights_begin_a_larger_network(tmp_path: Path) -> None:
    first = FirstStageConfig(hourglass=1)
    small = train(replace(RECIPE, steps=1, network=AnyNetConfig(first_stage=first)), tmp_path / "small", data=Planes(4))
    network = AnyNetConfig(first_stage=FirstStageConfig(hourglass=2, fine_costs=True, excitation=True))
    recipe = replace(RECIPE, steps=1, learning_rate=1e-9, weights=str(small), load_partial=True, network=network)
    large = load_checkpoint(train(recipe, tmp_path / "large", data=Planes(4)))
    assert large.config == network
    for name, value in load_file(small).items():
        if "running" not in name and "num_batches" not in name:
            torch.testing.assert_close(large.state_dict()[name], value, rtol=0, atol=1e-7)


def test_an_input_scale_is_taken_or_refused(tmp_path: Path) -> None:
    small = replace(RECIPE, steps=1, batch_size=1)
    scaled = replace(small, input_scale=2.0, weights="paper", load_partial=True)
    found = load_checkpoint(train(scaled, tmp_path / "partial", data=Planes(2))).config
    assert found == scaled.network.with_input_scale(2)
    weights = train(replace(small, model="nvtiny", input_scale=0.5), tmp_path / "baseline", data=Planes(2))
    with pytest.raises(AnyNetError, match="expected no input_scale with a baseline's weights, got 2"):
        train(replace(small, input_scale=2.0, weights=str(weights)), tmp_path / "other", data=Planes(2))


def test_nothing_to_train_on(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected pairs to train on"):
        train(RECIPE, tmp_path, data=Planes(0))
    sample = Planes(1)[0]
    unknown = [replace(sample, valid=np.zeros_like(sample.valid))]
    nothing = "expected pairs with known disparities that count, got none; plane 0: no known disparity"
    with pytest.raises(AnyNetError, match=f"data: {nothing}"):
        train(RECIPE, tmp_path, data=unknown)
    with pytest.raises(AnyNetError, match=f"validation mine: {nothing}"):
        train(RECIPE, tmp_path, data=Planes(4), validation={"mine": unknown})  # before the steps, not after them
    for factor, found in ((-1, "all known disparities are negative"), (256, "the known disparities are 5120")):
        wrong = [replace(sample, disparity=sample.disparity * np.float32(factor))]
        with pytest.raises(AnyNetError, match=rf"data: .*; plane 0: no pixel counts \(0 < d < 192\): {found}"):
            train(RECIPE, tmp_path, data=wrong)
    assert not (tmp_path / LOG).exists()


@pytest.fixture
def stopped(tmp_path):
    """A run of which two of three steps are done."""
    recipe = replace(RECIPE, steps=3, checkpoint_every=2)

    class Stopped(Exception):
        pass

    def stop(run):
        raise Stopped

    with pytest.MonkeyPatch.context() as patch:
        update = loop._Run._update
        patch.setattr(loop._Run, "_update", lambda run, batch: stop(run) if run.step == 2 else update(run, batch))
        with pytest.raises(Stopped):
            train(recipe, tmp_path, data=Planes(10))
    assert torch.load(tmp_path / CHECKPOINT, weights_only=True)["step"] == 2
    return recipe, tmp_path


def test_a_run_goes_on_with_as_many_pairs(stopped):
    recipe, out = stopped
    with pytest.raises(AnyNetError, match=r"checkpoint\.pt: expected 10 pairs, as when the run began, got 11"):
        train(recipe, out, resume=True, data=Planes(11))
    state = torch.load(out / CHECKPOINT, weights_only=True)
    del state["samples"]  # of an earlier version
    torch.save(state, out / CHECKPOINT)
    train(recipe, out, resume=True, data=Planes(11))


def _damaged(content: bytes) -> dict[str, bytes]:
    def saved(value) -> bytes:
        buffer = io.BytesIO()
        torch.save(value, buffer)
        return buffer.getvalue()

    state = torch.load(io.BytesIO(content), weights_only=True)
    return {
        "empty": b"",
        "truncated": content[: len(content) // 2],
        "text": b"text",
        "list": saved([1]),
        "lacking": saved({"step": 1}),
        "negative": saved({**state, "step": -1}),
        "beyond": saved({**state, "step": 10**6}),
        "no number": saved({**state, "step": "2"}),
        "other weights": saved({**state, "model": {}}),
        "other optimizer": saved({**state, "optimizer": {"state": {}, "param_groups": []}}),
        "code": saved(os.system),
    }


def test_a_damaged_checkpoint_is_told_on_resuming(stopped):
    recipe, out = stopped
    damaged = _damaged((out / CHECKPOINT).read_bytes())
    for name, content in damaged.items():
        (out / CHECKPOINT).write_bytes(content)
        with pytest.raises(AnyNetError, match=r"checkpoint\.pt: [^\n]+$") as caught:
            train(recipe, out, resume=True, data=Planes(10))
        assert str(out) in str(caught.value), name
    (out / CHECKPOINT).unlink()
    os.mkfifo(out / CHECKPOINT)
    with pytest.raises(AnyNetError, match="expected a file, got a pipe"):
        train(recipe, out, resume=True, data=Planes(10))


def test_what_a_killed_run_left_is_removed_and_a_damaged_log_goes_on(stopped):
    recipe, out = stopped
    (out / ".0123456789abcdef.part").write_bytes(b"half")
    (out / LOG).write_bytes((out / LOG).read_bytes() + b'\xff\0{"step"\n[]\n{}\n{"step": null}\n{"step": 1')
    train(recipe, out, resume=True, data=Planes(10))
    assert list(out.glob(".*.part")) == []
    assert [line["step"] for line in log_lines(out)] == [1, 2, 3]


@pytest.mark.parametrize(
    "content", [b"{", b"[]", b"\xff\xfe", b"[" * 5000, b'{"network": 3}', b'{"batch_size": "many"}']
)
def test_a_broken_recipe_is_told_on_resuming(tmp_path, capsys, content):
    (tmp_path / "recipe.json").write_bytes(content)
    assert cli.main(["train", "--out", str(tmp_path), "--data", "render:2", "--resume"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("anynet: ")
    assert "recipe.json" in line
    with pytest.raises(AnyNetError, match=r"recipe\.json"):
        train(RECIPE, tmp_path, resume=True, data=Planes(2))


@pytest.mark.parametrize("resume", [False, True])
def test_weights_from_elsewhere_are_not_overwritten(tmp_path: Path, resume: bool) -> None:
    (tmp_path / WEIGHTS).write_bytes(b"mine")
    with pytest.raises(AnyNetError, match=r"weights\.safetensors is of no run, and would be overwritten"):
        train(replace(RECIPE, steps=1), tmp_path, resume=resume, data=Planes(4))
    assert (tmp_path / WEIGHTS).read_bytes() == b"mine"


def test_each_of_several_data_sets_has_truth(tmp_path: Path) -> None:
    for column in ("left", "right"):
        write_image(tmp_path / f"{column}.png", np.zeros((96, 160, 3), np.uint8))
    write_disparity(tmp_path / "none.pfm", np.full((96, 160), np.nan, np.float32))
    (tmp_path / "pairs.csv").write_text("left,right,disparity\nleft.png,right.png,none.pfm\n")
    none = f"csv:{tmp_path / 'pairs.csv'}"
    recipe = replace(RECIPE, steps=1, data=("render:1?height=96&width=160", none))
    with pytest.raises(AnyNetError, match=r"data csv:.*: expected pairs with known disparities that count, got none"):
        train(recipe, tmp_path / "run")


def test_lengths_beyond_the_run_are_told() -> None:
    with pytest.warns(UserWarning, match="warmup_steps .100. are not fewer than the run's 3 steps"):
        replace(RECIPE, warmup_steps=100).warn_of_lengths(3)
    with pytest.warns(UserWarning, match=r"ema_decay 0\.999 averages over more .* 94 % of the result"):
        replace(RECIPE, ema_decay=0.999).warn_of_lengths(60)
