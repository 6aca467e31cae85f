"""Training runs: learning, resuming, distributing, stopping."""

from __future__ import annotations

import io
import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from planes import SMALL, Planes
from safetensors.torch import load_file

from anynet import cli
from anynet.checkpoint import load_checkpoint
from anynet.config import AnyNetConfig
from anynet.errors import AnyNetError
from anynet.network import AnyNet
from anynet.training import loop
from anynet.training.batches import batches
from anynet.training.distributed import Processes
from anynet.training.loop import CHECKPOINT, LOG, WEIGHTS, train
from anynet.training.loss import loss_weights, stage_losses
from anynet.training.recipe import Recipe

SCRIPT = Path(__file__).with_name("planes.py")
CPU = torch.device("cpu")
RECIPE = Recipe(**SMALL, workers=0)


@pytest.fixture(autouse=True)
def _threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def _start(out: Path, launcher: tuple[str, ...] = (), **options) -> subprocess.Popen[str]:
    command = [sys.executable, *launcher, str(SCRIPT), str(out), json.dumps(options)]
    path = os.pathsep.join(p for p in sys.path if p)
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.PIPE, text=True)


def _finish(process: subprocess.Popen[str]) -> None:
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors


def _lines(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / LOG).read_text().splitlines()]


def test_the_loss_falls_and_the_weights_are_measured(tmp_path):
    recipe = replace(RECIPE, steps=40, validate_every=40)
    weights = train(recipe, tmp_path, data=Planes(10), validation={"planes": Planes(2)})
    *steps, validation = _lines(tmp_path)
    assert [line["step"] for line in steps] == list(range(1, 41))
    assert np.mean([line["losses"] for line in steps[-5:]]) < 0.5 * np.mean([line["losses"] for line in steps[:5]])
    assert validation["validation"] == "planes"
    assert len(validation["d1"]) == 4
    assert weights == tmp_path / WEIGHTS


@pytest.mark.slow
def test_killed_and_resumed_gives_the_same_weights(tmp_path):
    _finish(_start(tmp_path / "whole", workers=1, ema_decay=0.9))
    killed = _start(tmp_path / "killed", workers=1, ema_decay=0.9)
    while not (tmp_path / "killed" / CHECKPOINT).exists():
        assert killed.poll() is None, killed.communicate()
        time.sleep(0.01)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert not (tmp_path / "killed" / WEIGHTS).exists(), "it was over before it was killed"
    _finish(_start(tmp_path / "killed", workers=0, ema_decay=0.9))
    whole, resumed = (load_file(tmp_path / name / WEIGHTS) for name in ("whole", "killed"))
    assert all(torch.equal(resumed[name], tensor) for name, tensor in whole.items())
    for name in ("step", "losses", "grad_norm", "learning_rate"):
        whole, resumed = ([line[name] for line in _lines(tmp_path / run)] for run in ("whole", "killed"))
        assert resumed == whole


@pytest.mark.slow
@pytest.mark.parametrize("stage_weights", [(), (1, 0, 0, 0)])
def test_two_processes_equal_one(tmp_path, stage_weights):
    options = {"steps": 3, "workers": 0, "stage_weights": stage_weights}
    _finish(_start(tmp_path / "one", **options))
    torchrun = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
    _finish(_start(tmp_path / "two", torchrun, **options))
    one, two = (load_file(tmp_path / name / WEIGHTS) for name in ("one", "two"))
    for name, tensor in one.items():
        torch.testing.assert_close(
            two[name], tensor, rtol=1e-5, atol=1e-6, msg=lambda text, name=name: f"{name}: {text}"
        )
    for first, second in zip(_lines(tmp_path / "one"), _lines(tmp_path / "two"), strict=True):
        assert second["losses"] == pytest.approx(first["losses"], rel=1e-4)
        assert second["grad_norm"] == pytest.approx(first["grad_norm"], rel=1e-4)


def test_a_batch_that_does_not_divide_is_refused():
    with pytest.raises(AnyNetError, match="a batch of 4 does not divide among 3 processes"):
        batches(Planes(4), RECIPE, range(1), Processes(0, 3, CPU))


def test_what_the_right_crop_does_not_show_weighs_less():
    planes = Planes(4)
    recipe = replace(RECIPE, batch_size=1, occluded_weight=0.25)
    found = set()
    for _, _, disparity, weights in batches(planes, recipe, range(4), Processes(0, 1, CPU)):
        shift = int(disparity.max())
        known = (disparity > 0).float()
        assert torch.equal(weights[..., :shift], 0.25 * known[..., :shift])
        assert torch.equal(weights[..., shift:], known[..., shift:])
        found |= set(weights.unique().tolist())
    assert found == {0.0, 0.25, 1.0}
    for (*_, all_equal), (*_, weights) in zip(
        batches(planes, replace(recipe, occluded_weight=1.0), range(4), Processes(0, 1, CPU)),
        batches(planes, recipe, range(4), Processes(0, 1, CPU)),
        strict=True,
    ):
        assert torch.equal(all_equal, (weights > 0).float())


def test_what_is_far_can_weigh_less():
    sample = Planes(1)[0]
    disparity = np.where(np.arange(sample.disparity.shape[1]) % 2, np.float32(0.3), sample.disparity)
    far = replace(sample, disparity=disparity, valid=np.ones_like(sample.valid))
    recipe = replace(RECIPE, batch_size=1, augment=False, occluded_weight=0.5, far_weight=0.25)
    ((*_, found, weights),) = batches([far], recipe, range(1), Processes(0, 1, CPU))
    assert set(weights[found < 0.5].tolist()) <= {0.25, 0.125}
    assert set(weights[found > 0.5].tolist()) <= {1.0, 0.5}
    assert {0.25, 1.0} <= set(weights.unique().tolist())
    with pytest.raises(AnyNetError, match=r"far_weight must be in \[0, 1\], got 2"):
        replace(RECIPE, far_weight=2)
    with pytest.raises(AnyNetError, match=r"robust_scale must be positive or 0, got -1"):
        replace(RECIPE, robust_scale=-1)


def test_the_loss_is_smooth_l1_over_what_trains():
    truth = torch.tensor([[[[0.0, 10, 10, 10, 250]]]])
    estimates = torch.tensor([[[[5.0, 10.5, 13, 20, 20]]]]), torch.full((1, 1, 1, 5), 10.0)
    weights = loss_weights(truth, torch.tensor([[[[1.0, 1, 1, 0.5, 1]]]]))
    assert weights.tolist() == [[[[0, 1, 1, 0.5, 0]]]]
    losses = stage_losses(estimates, truth, weights, weights.sum())
    torch.testing.assert_close(losses, torch.tensor([(0.125 + 2.5 + 0.5 * 9.5) / 2.5, 0]))


def test_large_errors_can_count_by_their_logarithm():
    truth = torch.full((1, 1, 1, 3), 10.0)
    estimate = torch.tensor([[[[10.5, 12.5, 70.5]]]], requires_grad=True)
    losses = stage_losses([estimate], truth, torch.ones_like(truth), torch.tensor(3.0), robust_scale=2.0)
    expected = sum(2 * math.log(1 + x / 2) for x in (0.125, 2.0, 60.0)) / 3
    torch.testing.assert_close(losses, torch.tensor([expected]))
    losses.sum().backward()
    torch.testing.assert_close(estimate.grad, torch.tensor([[[[0.5 / (1 + 0.0625), 0.5, 1 / 31]]]]) / 3)


def test_the_processes_share_the_batch_of_one():
    whole, *parts = (
        list(batches(Planes(7), RECIPE, range(5, 8), Processes(rank, count, CPU)))
        for rank, count in [(0, 1), (0, 2), (1, 2)]
    )
    for one, *shares in zip(whole, *parts, strict=True):
        for tensor, *pieces in zip(one, *shares, strict=True):
            torch.testing.assert_close(torch.cat(pieces), tensor, rtol=0, atol=0)


def test_a_loss_that_is_not_finite_stops_the_run(tmp_path, monkeypatch):
    calls = []

    def spoiled(self, left, right, stages):
        calls.append(0)
        outputs = list(self.stages(left, right))
        return [*outputs[:2], outputs[2] * float("nan"), outputs[3]] if len(calls) == 6 else outputs

    monkeypatch.setattr(AnyNet, "forward", spoiled)
    with pytest.raises(AnyNetError, match="loss of stage 3 became nan at step 6"):
        train(RECIPE, tmp_path, data=Planes(10))
    state = torch.load(tmp_path / CHECKPOINT, weights_only=True)
    assert state["step"] == 4
    assert all(tensor.isfinite().all() for tensor in state["model"].values())


def test_two_processes_do_not_train_in_one_folder(tmp_path, monkeypatch):
    first = _start(tmp_path, steps=100_000)
    try:
        while not (tmp_path / LOG).exists():
            assert first.poll() is None
            time.sleep(0.05)
        monkeypatch.setattr(loop, "PATIENCE", 0.1)
        with pytest.raises(AnyNetError, match="another process is training there"):
            train(replace(RECIPE, steps=100_000), tmp_path, data=Planes(10), resume=True)
    finally:
        first.kill()
        first.communicate()
    monkeypatch.undo()
    with pytest.raises(AnyNetError, match="steps was 100000"):  # not the lock, which went with its process
        train(replace(RECIPE, steps=5), tmp_path, data=Planes(10), resume=True)


def test_a_folder_with_a_run_is_not_overwritten(tmp_path):
    recipe = replace(RECIPE, steps=2)
    train(recipe, tmp_path, data=Planes(4))
    with pytest.raises(AnyNetError, match="holds a run already"):
        train(recipe, tmp_path, data=Planes(4))
    with pytest.raises(AnyNetError, match=r"learning_rate was 0.002 when the run began, so it cannot be 0.1"):
        train(replace(recipe, learning_rate=0.1), tmp_path, data=Planes(4), resume=True)


def test_stage_weights_must_fit_the_network(tmp_path):
    with pytest.raises(AnyNetError, match="expected 4, one per stage, got 3"):
        train(replace(RECIPE, stage_weights=(1.0, 1.0, 1.0)), tmp_path, data=Planes(4))


def test_stages_without_weight_neither_run_nor_change(tmp_path):
    torch.manual_seed(RECIPE.seed)
    before = AnyNet().state_dict()
    after = load_file(train(replace(RECIPE, steps=2, stage_weights=(1.0, 0.5, 0.0, 0.0)), tmp_path, data=Planes(4)))
    assert all(len(line["losses"]) == 2 for line in _lines(tmp_path))
    for part, changes in (("cost_nets.0", True), ("cost_nets.1", True), ("cost_nets.2", False), ("refinement", False)):
        same = [torch.equal(after[name], value) for name, value in before.items() if name.startswith(part)]
        assert not any(same) if changes else all(same), part


def test_weights_grow_into_a_larger_network(tmp_path):
    small = train(replace(RECIPE, steps=1, network=AnyNetConfig(hourglass=1)), tmp_path / "small", data=Planes(4))
    network = AnyNetConfig(hourglass=2, finer_costs=True, guided=True)
    recipe = replace(RECIPE, steps=1, learning_rate=1e-9, weights=str(small), load_partial=True, network=network)
    large = train(recipe, tmp_path / "grown", data=Planes(4))
    grown = load_checkpoint(large)
    assert grown.config == network
    for name, value in load_file(small).items():
        if "running" not in name and "num_batches" not in name:
            torch.testing.assert_close(grown.state_dict()[name], value, rtol=0, atol=1e-7)
    with pytest.raises(AnyNetError, match=r"grown.*expected weights of .*; the network has no finer_costs\.conv"):
        load_checkpoint(large, into=AnyNetConfig(hourglass=1))
    updated = load_checkpoint(large, into=replace(network, neighbours=1))
    for part in (updated.features, updated.cost_nets[0], updated.refinement):
        name = next(name for name, module in updated.named_modules() if module is part)
        for one, two in zip(part.parameters(), grown.get_submodule(name).parameters(), strict=True):
            assert torch.equal(one, two)


def test_nothing_to_train_on(tmp_path):
    with pytest.raises(AnyNetError, match="no pairs"):
        train(RECIPE, tmp_path, data=Planes(0))


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
    (out / ".checkpoint.pt.0123abcd.part").write_bytes(b"half")
    (out / LOG).write_bytes((out / LOG).read_bytes() + b'\xff\0{"step"\n[]\n{}\n{"step": null}\n{"step": 1')
    train(recipe, out, resume=True, data=Planes(10))
    assert list(out.glob(".*.part")) == []
    assert [line["step"] for line in _lines(out)] == [1, 2, 3]


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
