import numpy as np
import pytest
import torch

from estimators.networks.forward import real_weights
from estimators.networks.weights_file import load_network
from training.config import make_config
from training.init import ESTIMATOR_START, initialise_from_data, initialise_random
from training.models import CURRENT_MAX, AttSNN


def test_a_sensor_upside_down_is_within_the_range_of_the_outputs():
    model = model_of(24, 24, outputs="up", initialisation="solved")
    x = np.round(np.random.default_rng(0).normal(size=(2, 600, 6)).cumsum(1) * 20) / 1024
    initialise_from_data(model, x, np.broadcast_to([0.0, 0.0, -1.0], (2, 600, 3)), 0, ESTIMATOR_START)
    up = model(torch.from_numpy(x))[0].detach().numpy()[:, 300:].mean((0, 1))
    np.testing.assert_allclose(up, [0.0, 0.0, -1.0], atol=0.2)


def model_of(encoding, hidden, logits=True, **choices):
    optimisation = "layered" if logits else "paper"
    sizes = {"encoding": encoding, "hidden": hidden}
    return AttSNN(make_config(data="x", optimisation=optimisation, **sizes, **choices))


@pytest.mark.parametrize("symmetric", [False, True])
def test_currents_that_would_leave_the_chip_s_range_are_brought_back(symmetric):
    rng = np.random.default_rng(0)
    x = torch.from_numpy(np.round(rng.normal(size=(2, 2000, 6)) * 1024) / 1024)
    model = model_of(16, 16, symmetric=symmetric)
    model.set_weights("w_in", rng.normal(0, 0.2, (16, 6)))
    model.set_weights("w_ff", -np.abs(rng.normal(0, 0.3, (16, 16))))
    with torch.no_grad():
        model.syn1.fill_(8.0)  # remembered for 3000 steps
    model.constrain()

    def currents():
        with torch.no_grad():
            model(x)
        return model.kernels._last.traces[0].u[:, :, 16:32]

    assert currents().max() > 400  # what should only be negative has wrapped round
    for _ in range(10):
        currents()
        model.limit_currents()
        model.constrain()
    assert currents().max() <= 0.0
    assert -1.05 * CURRENT_MAX < currents().min() < -0.2 * CURRENT_MAX
    for name in model.sharing:
        w = getattr(model, name).detach().numpy()
        np.testing.assert_array_equal(model.shared(name, w), w)
    with torch.no_grad():
        model.w_ff.mul_(0.5)  # and what is far from the ends is left as it is
    kept = model.w_ff.clone()
    currents()
    model.limit_currents()
    assert torch.equal(kept, model.w_ff)


@pytest.mark.parametrize("logits", [False, True])
def test_limits_of_the_chip_leave_weights_that_fit_it_as_they_are(logits):
    network, tensors = load_network("att-snn-hummingbird")
    how = {"outputs": network.outputs, "finest_exponent": -6, "after_spike": True}
    model = model_of(network.encoding, network.hidden, logits, **how)
    values = real_weights(network, tensors)._asdict()
    for name in model.taus:
        model.set_taus(name, values[name])
    for name in model.matrices:
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
    weights = model.weights()
    assert (
        set(weights.w_ff.abs().unique().tolist()) == set(weights.w_in.abs().unique().tolist()) == {127 / 128}
    )
