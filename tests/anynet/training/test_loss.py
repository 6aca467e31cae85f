from __future__ import annotations

import math

import torch

from anynet.training.loss import loss_weights, stage_losses


def test_the_loss_is_smooth_l1_over_what_trains() -> None:
    truth = torch.tensor([[[[0.0, 10, 10, 10, 250]]]])
    estimates = torch.tensor([[[[5.0, 10.5, 13, 20, 20]]]]), torch.full((1, 1, 1, 5), 10.0)
    weights = loss_weights(truth, torch.tensor([[[[1.0, 1, 1, 0.5, 1]]]]))
    assert weights.tolist() == [[[[0, 1, 1, 0.5, 0]]]]
    losses = stage_losses(estimates, truth, weights, weights.sum())
    torch.testing.assert_close(losses, torch.tensor([(0.125 + 2.5 + 0.5 * 9.5) / 2.5, 0]))


def test_small_errors_can_teach_as_much_as_others() -> None:
    truth = torch.full((1, 1, 1, 3), 10.0)
    estimate = torch.tensor([[[[10.1, 10.5, 12]]]], requires_grad=True)
    losses = stage_losses([estimate], truth, torch.ones_like(truth), torch.tensor(3.0), smooth_below=0.2)
    torch.testing.assert_close(losses, torch.tensor([(0.025 + 0.4 + 1.9) / 3]))
    losses.sum().backward()
    torch.testing.assert_close(estimate.grad, torch.tensor([[[[0.5, 1, 1]]]]) / 3, rtol=1e-4, atol=0)


def test_large_errors_can_count_by_their_logarithm() -> None:
    truth = torch.full((1, 1, 1, 3), 10.0)
    estimate = torch.tensor([[[[10.5, 12.5, 70.5]]]], requires_grad=True)
    losses = stage_losses([estimate], truth, torch.ones_like(truth), torch.tensor(3.0), robust_scale=2.0)
    expected = sum(2 * math.log(1 + x / 2) for x in (0.125, 2.0, 60.0)) / 3
    torch.testing.assert_close(losses, torch.tensor([expected]))
    losses.sum().backward()
    torch.testing.assert_close(estimate.grad, torch.tensor([[[[0.5 / (1 + 0.0625), 0.5, 1 / 31]]]]) / 3)
