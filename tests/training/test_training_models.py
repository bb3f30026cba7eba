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
        return model.kernels._last.traces[0].u[:, :, 16:32]

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
    weights = model.weights()
    assert (
        set(weights.w_ff.abs().unique().tolist()) == set(weights.w_in.abs().unique().tolist()) == {127 / 128}
    )
