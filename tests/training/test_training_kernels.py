import numpy as np
import pytest
import torch
from plain_network import Plain

from estimators.networks.layer_parameters import DECAY, Weights
from estimators.spiking import superspike
from training.fused import Fused
from training.models import quantise_constant, quantise_weights, weight_exponents


def random_weights(h0, h1, seed=0, quantised=True, dtype=torch.float64, gain=1.0):
    rng = np.random.default_rng(seed)
    shapes = [(h0, 6), (h1, h0), (h1, h1), (2, h1)]
    scales = [0.3, 3.0 / h0, 1.0 / h1, 0.3]
    w = [torch.tensor(rng.normal(size=s) * k * gain) for s, k in zip(shapes, scales, strict=True)]
    tau = [torch.tensor(1 - np.exp(rng.uniform(-4, -0.2, size))) for size in (h0, h0, h1, h1, 1, 1)]
    if quantised:
        w, tau = [quantise_weights(x) for x in w], [quantise_constant(x, DECAY) for x in tau]
    return Weights(*(x.to(dtype).requires_grad_() for x in (*w, *tau)))


def random_input(n, steps, seed=1):
    rng = np.random.default_rng(seed)
    return torch.tensor(np.round(rng.normal(size=(n, steps, 6)) * 1024) / 1024)


def gradients(output, rates, weights, seed=2):
    target = torch.tensor(np.random.default_rng(seed).normal(size=output.shape), dtype=output.dtype)
    loss = (output * target).sum() + 3.0 * rates[0] - 2.0 * rates[1] ** 2
    return torch.autograd.grad(loss, tuple(weights), materialize_grads=True)


SMALL = [(5, 60, 13, 9), (1, 4, 3, 4)]
EVERY_WAY = [(quantised, delay, size) for quantised in (False, True) for delay in (1, 2) for size in SMALL]
FULL_SIZE = (8, 90, 100, 100)


@pytest.mark.parametrize(
    ("quantised", "delay", "size"), [*EVERY_WAY, (False, 2, FULL_SIZE), (True, 1, FULL_SIZE)]
)
def test_fused_kernels_equal_plain_pytorch(quantised, delay, size):
    n, steps, h0, h1 = size
    weights = random_weights(h0, h1, quantised=quantised)
    x = random_input(n, steps)
    reference, fused = Plain(quantised, delay), Fused(quantised, delay)
    expected, expected_rates = reference.forward(x, weights)
    output, rates = fused.forward(x, weights)
    np.testing.assert_allclose(rates.detach(), expected_rates.detach(), rtol=1e-12)
    for mine, theirs in zip(fused.spikes(), reference.spikes(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for mine, theirs in zip(fused.peak_currents(), reference.peak_currents(), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=0 if quantised else 1e-11)
    encoding, hidden = fused.spikes()
    if steps > 10:
        assert 0.01 < encoding.mean() < 0.9
        assert 0.01 < hidden.mean() < 0.9
    np.testing.assert_allclose(output.detach(), expected.detach(), rtol=0, atol=0 if quantised else 1e-11)
    mine_all, theirs_all = gradients(output, rates, weights), gradients(expected, expected_rates, weights)
    for name, mine, theirs in zip(Weights._fields, mine_all, theirs_all, strict=True):
        scale = np.max(theirs.abs().numpy(), initial=1.0)
        np.testing.assert_allclose(mine / scale, theirs / scale, rtol=0, atol=1e-10, err_msg=name)


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("delay", [1, 2])
def test_windows_that_go_on_are_one_long_window_but_for_sequences_that_are_reset(quantised, delay):
    weights, x = random_weights(12, 10, quantised=quantised), random_input(3, 120)
    kernels = Fused(quantised, delay)
    whole = kernels.forward(x, weights)[0].detach()
    resets = [np.array(rows) for rows in ([True] * 3, [False] * 3, [False, True, False])]
    windows = zip(x.split(40, 1), resets, strict=True)
    parts = [kernels.forward(part, weights, reset)[0].detach().clone() for part, reset in windows]
    joined, atol = torch.cat(parts, 1), 0 if quantised else 1e-11
    np.testing.assert_allclose(joined[::2], whole[::2], rtol=0, atol=atol)
    anew = Fused(quantised, delay).forward(x[:, 80:], weights)[0].detach()
    np.testing.assert_allclose(joined[1, :80], whole[1, :80], rtol=0, atol=atol)
    np.testing.assert_allclose(joined[1, 80:], anew[1], rtol=0, atol=atol)


def test_windows_go_on_with_neurons_whose_potential_is_at_the_chip_s_limit():
    weights, x = random_weights(12, 10), random_input(3, 1200)
    with torch.no_grad():
        weights.w_ff[:5], weights.w_ff[5:] = -1.0, 127 / 128
        weights.syn1[:], weights.mem1[:] = 4095 / 4096, 4095 / 4096
    kernels = Fused()
    whole = kernels.forward(x, weights)[0].detach()
    assert kernels.trace.v.min() == -(2**23 - 1) / 2**14
    windows = zip(x.split(400, 1), (True, False, False), strict=True)
    parts = [kernels.forward(part, weights, np.full(3, reset))[0].detach() for part, reset in windows]
    np.testing.assert_array_equal(torch.cat(parts, 1), whole)


def test_quantised_float32_window_equals_the_float64_one():
    wide = random_weights(100, 100)
    narrow = Weights(*(w.detach().float().requires_grad_() for w in wide))
    x = random_input(4, 300)
    found, expected = (Fused().forward(x, weights)[0].detach() for weights in (narrow, wide))
    np.testing.assert_array_equal(found, expected.float())


def test_a_trace_that_is_overwritten_is_not_used():
    weights, x, kernels = random_weights(5, 5), random_input(2, 10), Fused()
    first, _ = kernels.forward(x, weights)
    kernels.forward(x, weights)
    with pytest.raises(RuntimeError, match="another window"):
        first.sum().backward()


def test_superspike_is_a_step_with_the_gradient_of_the_paper():
    x = torch.tensor([-0.3, 0.0, 0.2], requires_grad=True)
    y = superspike(x)
    y.sum().backward()
    assert y.tolist() == [0.0, 0.0, 1.0]
    np.testing.assert_allclose(x.grad, 1 / (1 + 20 * np.abs([-0.3, 0.0, 0.2])) ** 2, rtol=1e-6)


def test_recurrent_delay_of_two_is_the_papers_convention():
    """v[t+1] = τ v[t] + i[t], i[t+1] = τ i[t] + W s[t], spikes of v: as printed in the paper."""
    rng, tau = np.random.default_rng(0), 0.75
    w_ff, w_rec = rng.normal(0, 0.5, (7, 5)), rng.normal(0, 0.5, (7, 7))
    matrices = (rng.normal(0, 0.5, (5, 6)), w_ff, w_rec, np.ones((2, 7)))
    weights = *matrices, *(np.full(k, tau) for k in (5, 5, 7, 7, 1, 1))
    kernels = Fused(quantised=False, recurrent_delay=2)
    kernels.forward(torch.tensor(rng.normal(size=(1, 200, 6))), Weights(*map(torch.tensor, weights)))
    encoding, hidden = (each[0].astype(float) for each in kernels.spikes())
    v, i, spikes = np.zeros(7), np.zeros(7), np.zeros(7)
    for t in range(200):
        v, i = tau * v * (1 - spikes) + i, tau * i + w_rec @ spikes
        spikes = (v > 0.5).astype(float)
        np.testing.assert_array_equal(hidden[t], spikes)
        # The paper's encoding layer, too, uses its old current: it spikes one step later than this one.
        i = i + w_ff @ encoding[t]


def test_grid_of_the_chip():
    w = quantise_weights(torch.tensor([[0.0, 0.1, 1.0, 3.0, -3.0]], dtype=torch.float64)) * 256
    assert w.tolist() == [[0, 26, 254, 254, -256]]
    d = (1 - quantise_constant(torch.tensor([0.0, 0.5, 0.99999], dtype=torch.float64), DECAY)) * 4096
    assert d.tolist() == [4096, 2048, 1]


def test_rounding_lets_gradients_through():
    for finest in (0, -6):
        w = torch.tensor([[0.1, -0.003]], requires_grad=True)
        quantise_weights(w, finest).sum().backward()
        assert w.grad.tolist() == [[1.0, 1.0]]


def test_a_row_of_small_weights_has_finer_steps_down_to_the_finest():
    rows = [[0.9, 0.003], [0.1, 0.003], [1e-3, 0.003], [0.0, 0.0], [3.0, -3.0]]
    w = torch.tensor(rows, dtype=torch.float64)
    assert weight_exponents(w, -6).tolist() == [[0], [-3], [-6], [-6], [0]]
    assert weight_exponents(w, 0).tolist() == [[0]] * 5
    fine = quantise_weights(w, -6)
    step = torch.exp2(weight_exponents(w, -6)) / 128
    assert (fine / step == torch.round(fine / step)).all()
    assert ((fine - w)[:4].abs() <= step[:4] / 2).all()
    assert torch.equal(quantise_weights(fine, -6), fine)
