import numpy as np
import pytest
import torch
from plain_network import Plain

from estimators.spiking import Weights, quantise_decay, quantise_weights
from training.fused import Fused


def random_weights(h0, h1, seed=0, quantised=True, dtype=torch.float64, gain=1.0, after_spike=True):
    rng = np.random.default_rng(seed)
    shapes = [(h0, 6), (h1, h0), (h1, h1), (2, h1), (h1, 1)][: 4 + after_spike]
    scales = [0.3, 3.0 / h0, 1.0 / h1, 0.3, 0.1][: 4 + after_spike]
    w = [torch.tensor(rng.normal(size=s) * k * gain) for s, k in zip(shapes, scales, strict=True)]
    tau = [torch.tensor(1 - np.exp(rng.uniform(-4, -0.2, size))) for size in (h0, h0, h1, h1, 1, 1)]
    of_after = torch.tensor(1 - np.exp(rng.uniform(-4, -0.2, h1 * after_spike)))
    if quantised:
        w = [quantise_weights(x) for x in w]
        tau, of_after = [quantise_decay(x) for x in tau], quantise_decay(of_after)
    w = w if after_spike else [*w, torch.zeros(h1, 0)]
    return Weights(*(x.to(dtype).requires_grad_() for x in (*w, *tau, of_after)))


def random_input(n, steps, seed=1):
    rng = np.random.default_rng(seed)
    return torch.tensor(np.round(rng.normal(size=(n, steps, 6)) * 1024) / 1024)


def gradients(output, rates, weights, seed=2):
    target = torch.tensor(np.random.default_rng(seed).normal(size=output.shape), dtype=output.dtype)
    loss = (output * target).sum() + 3.0 * rates[0] - 2.0 * rates[1] ** 2
    return torch.autograd.grad(loss, tuple(weights), materialize_grads=True)


SMALL = [(5, 60, 13, 9, 1), (1, 4, 3, 4, 1)]
EVERY_WAY = [
    (quantised, delay, size, after_spike)
    for quantised in (False, True)
    for delay in (1, 2)
    for size, after_spike in zip(SMALL, (True, False), strict=True)
]
FULL_SIZE = (8, 90, 100, 100, 2)


@pytest.mark.parametrize(
    ("quantised", "delay", "size", "after_spike"),
    [*EVERY_WAY, (False, 2, FULL_SIZE, False), (True, 1, FULL_SIZE, True)],
)
def test_fused_kernels_equal_plain_pytorch(quantised, delay, size, after_spike):
    n, steps, h0, h1, threads = size
    weights = random_weights(h0, h1, quantised=quantised, after_spike=after_spike)
    x = random_input(n, steps)
    reference, fused = Plain(quantised, delay), Fused(quantised, delay, threads)
    expected, expected_rates = reference.forward(x, weights)
    output, rates = fused.forward(x, weights)
    np.testing.assert_allclose(rates.detach(), expected_rates.detach(), rtol=1e-12)
    for mine, theirs in zip(fused.spikes(), reference.spikes(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for mine, theirs in zip(fused.peak_currents(), reference.peak_currents(), strict=True):
        theirs = theirs[: mine.size]
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
    parts = [
        kernels.forward(x[:, 40 * k : 40 * k + 40], weights, resets[k])[0].detach().clone() for k in range(3)
    ]
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
    assert kernels._last.traces[0].v1.min() == -(2**23 - 1) / 2**14
    reset = np.ones(3, bool)
    parts = [
        kernels.forward(x[:, 400 * k : 400 * k + 400], weights, reset & (k == 0))[0].detach()
        for k in range(3)
    ]
    np.testing.assert_array_equal(torch.cat(parts, 1), whole)


def test_quantised_float32_window_equals_the_float64_one():
    wide = random_weights(100, 100)
    narrow = Weights(*(w.detach().float().requires_grad_() for w in wide))
    x = random_input(4, 300)
    np.testing.assert_array_equal(
        Fused().forward(x, narrow)[0].detach(), Fused().forward(x, wide)[0].detach().float()
    )


def test_a_trace_that_is_overwritten_is_not_used():
    weights, x, kernels = random_weights(5, 5), random_input(2, 10), Fused()
    first, _ = kernels.forward(x, weights)
    kernels.forward(x, weights)
    with pytest.raises(RuntimeError, match="another window"):
        first.sum().backward()
