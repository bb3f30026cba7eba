import pytest
import torch

from training.config import make_config
from training.optim import LOOKAHEAD_ALPHA, LOOKAHEAD_K, Lookahead, error_loss, total_cost


def start():
    torch.manual_seed(0)
    weights = torch.nn.Parameter(torch.randn(5))
    return weights, Lookahead(torch.optim.Adam([weights], lr=0.1))


def descend(weights, optimiser, steps):
    for _ in range(steps):
        optimiser.zero_grad()
        (weights.square().sum() + weights.sum()).backward()
        optimiser.step()


def test_slow_weights_go_half_way_every_six_steps():
    weights = torch.nn.Parameter(torch.tensor([0.0]))
    optimiser = Lookahead(torch.optim.SGD([weights], lr=1.0))
    seen = []
    for _ in range(12):
        weights.grad = torch.tensor([-1.0])
        optimiser.step()
        seen.append(weights.item())
    assert (LOOKAHEAD_K, LOOKAHEAD_ALPHA) == (6, 0.5)
    assert seen == [1.0, 2.0, 3.0, 4.0, 5.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 6.0]


def test_evaluated_weights_are_the_slow_ones():
    weights, optimiser = start()
    before = weights.detach().clone()
    descend(weights, optimiser, 2)
    fast = weights.detach().clone()
    with optimiser.evaluated():
        torch.testing.assert_close(weights.detach(), before)
    torch.testing.assert_close(weights.detach(), fast)


def test_the_loss_is_quadratic_up_to_the_threshold_and_linear_beyond():
    error = torch.tensor([[[0.03, 0.04], [0.3, -0.4], [0.0, 0.0]]], dtype=torch.float64, requires_grad=True)
    wanted = torch.zeros_like(error)
    assert error_loss(error, wanted).item() == pytest.approx((0.05**2 + 0.5**2) / 6)
    assert error_loss(error, wanted, huber_threshold=1.0).item() == pytest.approx((0.05**2 + 0.5**2) / 6)
    loss = error_loss(error, wanted, huber_threshold=0.1)
    assert loss.item() == pytest.approx((0.05**2 / 2 + 0.1 * (0.5 - 0.1 / 2)) / 3)
    loss.backward()
    pulls = error.grad.norm(dim=-1)[0] * 3
    torch.testing.assert_close(pulls, torch.tensor([0.05, 0.1, 0.0], dtype=torch.float64))


def test_spikes_cost_what_exceeds_their_target_and_fewer_earn_nothing():
    config = make_config(data="x", rate_cost=3.0, rate_targets=(0.1, 0.2))
    right = torch.zeros(1, 4, 2)
    for rates, excess in (([0.05, 0.1], 0.0), ([0.15, 0.1], 0.05), ([0.15, 0.4], 0.25)):
        assert total_cost(right, right, torch.tensor(rates), config).item() == pytest.approx(3.0 * excess)
