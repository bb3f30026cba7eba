import numpy as np
import pytest
import torch

from training.config import make_config
from training.loss import attitude_loss, total_cost
from training.optim import Lookahead, resized_state


def start():
    torch.manual_seed(0)
    weights = torch.nn.Parameter(torch.randn(5))
    return weights, Lookahead(torch.optim.Adam([weights], lr=0.1), k=3, alpha=0.5)


def descend(weights, optimiser, steps):
    for _ in range(steps):
        optimiser.zero_grad()
        (weights.square().sum() + weights.sum()).backward()
        optimiser.step()


def test_slow_weights_go_half_way_every_k_steps():
    weights = torch.nn.Parameter(torch.tensor([0.0]))
    optimiser = Lookahead(torch.optim.SGD([weights], lr=1.0), k=2, alpha=0.5)
    seen = []
    for _ in range(4):
        weights.grad = torch.tensor([-1.0])
        optimiser.step()
        seen.append(weights.item())
    assert seen == [1.0, 1.0, 2.0, 2.0]


def test_evaluated_weights_are_the_slow_ones():
    weights, optimiser = start()
    before = weights.detach().clone()
    descend(weights, optimiser, 2)
    fast = weights.detach().clone()
    with optimiser.evaluated():
        torch.testing.assert_close(weights.detach(), before)
    torch.testing.assert_close(weights.detach(), fast)


@pytest.mark.parametrize("saved_after", [3, 4])
def test_resumed_run_is_the_same_bit_for_bit(saved_after, tmp_path):
    weights, optimiser = start()
    descend(weights, optimiser, saved_after)
    torch.save({"w": weights.detach(), "o": optimiser.state_dict()}, tmp_path / "x.pt")
    descend(weights, optimiser, 7)
    again, resumed = start()
    state = torch.load(tmp_path / "x.pt", weights_only=True)
    with torch.no_grad():
        again.copy_(state["w"])
    resumed.load_state_dict(state["o"])
    descend(again, resumed, 7)
    np.testing.assert_array_equal(again.detach(), weights.detach())


def test_what_is_left_of_the_parameters_goes_on_as_among_all():
    weights, optimiser = start()
    descend(weights, optimiser, 4)
    part = torch.nn.Parameter(weights.detach()[1:4].clone())
    smaller = Lookahead(torch.optim.Adam([part], lr=0.1), k=3, alpha=0.5)
    smaller.load_state_dict(resized_state(optimiser.state_dict(), lambda k, value: value[1:4].clone()))
    descend(weights, optimiser, 5)
    descend(part, smaller, 5)
    np.testing.assert_array_equal(part.detach(), weights.detach()[1:4])


@pytest.mark.parametrize(("k", "alpha"), [(0, 0.5), (6, 0.0), (6, 1.5)])
def test_values_out_of_range_are_refused(k, alpha):
    with pytest.raises(ValueError, match=r"k: 0|alpha"):
        Lookahead(torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=1.0), k, alpha)


def test_a_small_error_of_up_costs_what_the_same_error_of_roll_and_pitch_costs():
    roll_pitch = torch.tensor([[[0.003, -0.004], [0.0, 0.002]]], dtype=torch.float64)
    truth = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(1, 2, 3)
    up = torch.stack([-roll_pitch[..., 1], roll_pitch[..., 0], torch.ones(1, 2)], -1)
    for threshold in (0.0, 0.001):
        cost = attitude_loss(up, truth, threshold).item()
        level = torch.zeros_like(roll_pitch)
        assert cost == pytest.approx(attitude_loss(roll_pitch, level, threshold).item())


def test_the_loss_is_quadratic_up_to_the_threshold_and_linear_beyond():
    error = torch.tensor([[[0.03, 0.04], [0.3, -0.4], [0.0, 0.0]]], dtype=torch.float64, requires_grad=True)
    wanted = torch.zeros_like(error)
    assert attitude_loss(error, wanted).item() == pytest.approx((0.05**2 + 0.5**2) / 6)
    assert attitude_loss(error, wanted, huber_threshold=1.0).item() == pytest.approx((0.05**2 + 0.5**2) / 6)
    loss = attitude_loss(error, wanted, huber_threshold=0.1)
    assert loss.item() == pytest.approx((0.05**2 / 2 + 0.1 * (0.5 - 0.1 / 2)) / 3)
    loss.backward()
    pulls = error.grad.norm(dim=-1)[0] * 3
    torch.testing.assert_close(pulls, torch.tensor([0.05, 0.1, 0.0], dtype=torch.float64))


def test_spikes_cost_what_exceeds_their_target_and_fewer_earn_nothing():
    config = make_config(data="x", rate_cost=3.0, rate_targets=(0.1, 0.2))
    right = torch.zeros(1, 4, 2)
    for rates, excess in (([0.05, 0.1], 0.0), ([0.15, 0.1], 0.05), ([0.15, 0.4], 0.25)):
        assert total_cost(right, right, torch.tensor(rates), config).item() == pytest.approx(3.0 * excess)
