import numpy as np
import pytest
import torch

from estimators.spiking import (
    STATE_ONE,
    Weights,
    forward,
    quantise_decay,
    quantise_weights,
    states,
    superspike,
    weight_exponents,
)


def chain(w_rec=0.0, tau=0.5, w_after=None):
    """One encoder that fires on every large input, one hidden neuron, one output."""
    one = torch.ones(1, 1, dtype=torch.float64)
    taus = [torch.full((1,), tau, dtype=torch.float64)] * 6
    after, tau_after = (one[:, :0], one[0, :0]) if w_after is None else (one * w_after, taus[0])
    w_in = torch.cat([one] + [0 * one] * 5, 1)
    return Weights(w_in, one * 0.75, one * w_rec, one, after, *taus, tau_after)


def test_superspike_is_a_step_with_the_gradient_of_the_paper():
    x = torch.tensor([-0.3, 0.0, 0.2], requires_grad=True)
    y = superspike(x)
    y.sum().backward()
    assert y.tolist() == [0.0, 0.0, 1.0]
    np.testing.assert_allclose(x.grad, 1 / (1 + 20 * np.abs([-0.3, 0.0, 0.2])) ** 2, rtol=1e-6)


def test_a_sample_reaches_the_output_in_the_third_step():
    x = torch.zeros(1, 5, 6, dtype=torch.float64)
    x[0, 0, 0] = 1.0
    out, encoding, hidden = forward(x, chain(tau=0.1))
    assert encoding[0, :, 0].tolist() == [1, 0, 0, 0, 0]
    assert hidden[0, :, 0].tolist() == [0, 1, 0, 0, 0]
    np.testing.assert_allclose(out[0, :3, 0], [0.0, 0.0, 1.0])


def test_neuron_follows_the_written_equations():
    x = torch.zeros(1, 40, 6, dtype=torch.float64)
    x[0, :, 0] = torch.linspace(0, 0.3, 40, dtype=torch.float64)
    _, encoding, _ = forward(x, chain(tau=0.8))
    u = v = 0.0
    for t in range(40):
        u = 0.8 * u + float(x[0, t, 0])
        v = 0.8 * v + u
        assert bool(encoding[0, t, 0]) == (v > 0.5)
        v = 0.0 if v > 0.5 else v


@pytest.mark.parametrize("w_after", [-0.4, 0.3])
def test_a_spike_leaves_a_current_in_its_own_neuron_that_decays(w_after):
    x = torch.zeros(1, 30, 6, dtype=torch.float64)
    x[0, 0, 0] = 1.0
    every = states(x, chain(tau=0.5, w_after=w_after))
    spikes = np.array([float(each.s1) for each in every])
    assert spikes.sum() >= 1
    expected = [w_after * sum(spikes[k] * 0.5 ** (t - 1 - k) for k in range(t)) for t in range(30)]
    np.testing.assert_allclose([float(each.a1) for each in every], expected, atol=1e-15)
    without = states(x, chain(tau=0.5))
    assert torch.equal(every[0].v1, without[0].v1)
    assert (every[10].v1 - without[10].v1) * w_after > 0


def test_recurrent_delay_of_two_is_the_papers_convention():
    """v[t+1] = τ v[t] + i[t], i[t+1] = τ i[t] + W s[t], spikes of v: as printed in the paper."""
    rng = np.random.default_rng(0)
    w_ff, w_rec = rng.normal(0, 0.5, (7, 5)), rng.normal(0, 0.5, (7, 7))
    w_in = rng.normal(0, 0.5, (5, 6))
    x = torch.tensor(rng.normal(size=(1, 200, 6)))
    tau = 0.75
    taus = [torch.full((k,), tau, dtype=torch.float64) for k in (5, 5, 7, 7, 1, 1)]
    w = Weights(
        torch.tensor(w_in),
        torch.tensor(w_ff),
        torch.tensor(w_rec),
        torch.ones(2, 7, dtype=torch.float64),
        torch.zeros(7, 0),
        *taus,
        torch.zeros(0),
    )
    _, encoding, hidden = forward(x, w, recurrent_delay=2)
    v, i = np.zeros(7), np.zeros(7)
    spikes = np.zeros(7)
    for t in range(200):
        v, i = tau * v * (1 - spikes) + i, tau * i + w_rec @ spikes
        spikes = (v > 0.5).astype(float)
        np.testing.assert_array_equal(hidden[0, t].numpy(), spikes)
        # The paper's encoding layer, too, uses its old current: it spikes one step later than this one.
        i = i + w_ff @ encoding[0, t].numpy()


def test_grid_of_the_chip():
    w = quantise_weights(torch.tensor([[0.0, 0.1, 1.0, 3.0, -3.0]], dtype=torch.float64)) * 256
    assert w.tolist() == [[0, 26, 254, 254, -256]]
    d = (1 - quantise_decay(torch.tensor([0.0, 0.5, 0.99999], dtype=torch.float64))) * 4096
    assert d.tolist() == [4096, 2048, 1]


def test_rounding_lets_gradients_through():
    for finest in (0, -6):
        w = torch.tensor([[0.1, -0.003]], requires_grad=True)
        quantise_weights(w, finest).sum().backward()
        assert w.grad.tolist() == [[1.0, 1.0]]


def test_a_row_of_small_weights_has_finer_steps_down_to_the_finest():
    w = torch.tensor(
        [[0.9, 0.003], [0.1, 0.003], [1e-3, 0.003], [0.0, 0.0], [3.0, -3.0]], dtype=torch.float64
    )
    assert weight_exponents(w, -6).tolist() == [[0], [-3], [-6], [-6], [0]]
    assert weight_exponents(w, 0).tolist() == [[0]] * 5
    fine = quantise_weights(w, -6)
    step = torch.exp2(weight_exponents(w, -6)) / 128
    assert (fine / step == torch.round(fine / step)).all()
    assert ((fine - w)[:4].abs() <= step[:4] / 2).all()
    assert torch.equal(quantise_weights(fine, -6), fine)


def test_quantised_states_are_whole():
    x = torch.zeros(1, 30, 6, dtype=torch.float64)
    x[0, :, 0] = 0.25
    exact = chain(w_after=0.3)._asdict()
    w = Weights(*(quantise_weights(k) if n.startswith("w") else k for n, k in exact.items()))
    out, _, _ = forward(x, w, quantised=True)
    scaled = out * STATE_ONE
    np.testing.assert_array_equal(scaled, torch.round(scaled))
