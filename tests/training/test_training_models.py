"""Limits of the chip in training, the optimiser and the loss."""

import numpy as np
import pytest
import torch
from controllers import random_snn

from estimators.networks.forward import real_weights
from estimators.networks.layer_parameters import MATRICES, NEURON_CONSTANTS
from estimators.networks.weights_file import NetworkConfig
from training.config import make_config
from training.init import initialise_random
from training.models import CURRENT_MAX, AttSNN
from training.optim import LOOKAHEAD_ALPHA, LOOKAHEAD_K, Lookahead, error_loss, total_cost


def model_of(encoding, hidden, logits=True, **choices):
    optimisation = "layered" if logits else "paper"
    sizes = {"encoding": encoding, "hidden": hidden}
    return AttSNN(make_config(data="x", optimisation=optimisation, **sizes, **choices))


def test_currents_that_would_leave_the_chip_s_range_are_brought_back():
    rng = np.random.default_rng(0)
    x = torch.from_numpy(np.round(rng.normal(size=(2, 2000, 6)) * 1024) / 1024)
    model = model_of(16, 16)
    model.set_weights("w_in", rng.normal(0, 0.2, (16, 6)))
    model.set_weights("w_ff", -np.abs(rng.normal(0, 0.3, (16, 16))))
    with torch.no_grad():
        model.syn1.fill_(8.0)  # remembered for 3000 steps
    model.constrain()

    def currents():
        with torch.no_grad():
            model(x)
        return model.kernels.trace.u[:, :, 16:32]

    assert currents().max() > 400  # what should only be negative has wrapped round
    for _ in range(10):
        currents()
        model.limit_currents()
        model.constrain()
    assert currents().max() <= 0.0
    assert -1.05 * CURRENT_MAX < currents().min() < -0.2 * CURRENT_MAX
    with torch.no_grad():
        model.w_ff.mul_(0.5)  # and what is far from the ends is left as it is
    kept = model.w_ff.clone()
    currents()
    model.limit_currents()
    assert torch.equal(kept, model.w_ff)


@pytest.mark.parametrize("logits", [False, True])
def test_limits_of_the_chip_leave_weights_that_fit_it_as_they_are(logits):
    network = NetworkConfig(model="att-snn", encoding=20, hidden=16)
    tensors = random_snn(network, 1)
    model = model_of(network.encoding, network.hidden, logits, finest_exponent=-6)
    values = real_weights(network, tensors)._asdict()
    for name in NEURON_CONSTANTS:
        model.set_constants(name, values[name])
    for name in MATRICES:
        model.set_weights(name, values[name])
    before = model.weights()
    model.constrain()
    for value, kept in zip(before, model.weights(), strict=True):
        torch.testing.assert_close(kept, value, rtol=0, atol=0)


@pytest.mark.parametrize("logits", [False, True])
def test_a_weight_can_be_trained_to_the_ends_of_the_chips_range_and_no_further(logits):
    model = model_of(8, 8, logits)
    initialise_random(model, 0)
    with torch.no_grad():
        model.w_ff.mul_(1e6)
        model.w_in.mul_(-1e6)
    model.constrain()
    for weights in (model.weights().w_ff, model.weights().w_in):
        assert weights.abs().unique().tolist() == [127 / 128]


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
    weights = torch.nn.Parameter(torch.tensor([0.5, -2.0]))
    optimiser = Lookahead(torch.optim.Adam([weights], lr=0.1))
    before = weights.detach().clone()
    for _ in range(2):
        weights.square().sum().backward()
        optimiser.step()
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
