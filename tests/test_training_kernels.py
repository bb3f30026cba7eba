import numpy as np
import pytest
import torch

from estimators.spiking import Weights, forward, quantise_decay, quantise_weights
from training.backends.fused import Workspace, attsnn


def random_weights(h0, h1, seed=0, quantised=True, dtype=torch.float64, gain=1.0):
    rng = np.random.default_rng(seed)
    shapes = [(h0, 6), (h1, h0), (h1, h1), (2, h1)]
    scales = [0.3, 3.0 / h0, 1.0 / h1, 0.3]
    w = [torch.tensor(rng.normal(size=s) * k * gain) for s, k in zip(shapes, scales, strict=True)]
    tau = [torch.tensor(1 - np.exp(rng.uniform(-4, -0.2, size))) for size in (h0, h0, h1, h1, 1, 1)]
    if quantised:
        w = [quantise_weights(x) for x in w]
        tau = [quantise_decay(x) for x in tau]
    return Weights(*(x.to(dtype).requires_grad_() for x in (*w, *tau)))


def random_input(n, steps, seed=1):
    rng = np.random.default_rng(seed)
    return torch.tensor(np.round(rng.normal(size=(n, steps, 6)) * 1024) / 1024)


def gradients(output, rates, weights, seed=2):
    target = torch.tensor(np.random.default_rng(seed).normal(size=output.shape), dtype=output.dtype)
    loss = (output * target).sum() + 3.0 * rates[0] - 2.0 * rates[1] ** 2
    return torch.autograd.grad(loss, tuple(weights))


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("delay", [1, 2])
@pytest.mark.parametrize(
    ("n", "steps", "h0", "h1", "threads"), [(5, 60, 13, 9, 1), (1, 4, 3, 4, 1), (8, 90, 100, 100, 2)]
)
def test_fused_network_equals_the_pytorch_loop(quantised, delay, n, steps, h0, h1, threads):
    weights, x = random_weights(h0, h1, quantised=quantised), random_input(n, steps)
    expected, encoding, hidden = forward(x, weights, quantised, delay)
    space = Workspace(steps, n, weights, quantised, delay, threads)
    output, rates = attsnn(x, weights, space)
    expected_rates = torch.stack([encoding.mean(), hidden.mean()])
    np.testing.assert_allclose(rates.detach(), expected_rates.detach(), rtol=1e-12)
    for spikes, name in ((encoding, "s0"), (hidden, "s1")):
        lists = np.concatenate([getattr(trace, name)[2:] for trace in space.traces], 1)
        mine = np.zeros(spikes.shape)
        for t in range(steps):
            for b in range(n):
                mine[b, t, lists[t, b, 1 : 1 + lists[t, b, 0]]] = 1
        np.testing.assert_array_equal(mine, spikes.detach().numpy())
    if steps > 10:
        assert 0.01 < encoding.mean() < 0.9
        assert 0.01 < hidden.mean() < 0.9
    np.testing.assert_allclose(output.detach(), expected.detach(), rtol=0, atol=0 if quantised else 1e-11)
    mine_all, theirs_all = gradients(output, rates, weights), gradients(expected, expected_rates, weights)
    for name, mine, theirs in zip(Weights._fields, mine_all, theirs_all, strict=True):
        scale = max(1.0, float(theirs.abs().max()))
        np.testing.assert_allclose(mine / scale, theirs / scale, rtol=0, atol=1e-10, err_msg=name)


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("delay", [1, 2])
def test_carried_windows_are_one_long_window_but_for_sequences_that_start_anew(quantised, delay):
    weights, x = random_weights(12, 10, quantised=quantised), random_input(3, 120)
    whole = attsnn(x, weights, Workspace(120, 3, weights, quantised, delay))[0].detach()
    space = Workspace(40, 3, weights, quantised, delay)
    fresh = [np.array(rows) for rows in ([True] * 3, [False] * 3, [False, True, False])]
    parts = [
        attsnn(x[:, 40 * k : 40 * k + 40], weights, space, fresh[k])[0].detach().clone() for k in range(3)
    ]
    joined, atol = torch.cat(parts, 1), 0 if quantised else 1e-11
    np.testing.assert_allclose(joined[::2], whole[::2], rtol=0, atol=atol)
    anew = attsnn(x[:, 80:], weights, Workspace(40, 3, weights, quantised, delay))[0].detach()
    np.testing.assert_allclose(joined[1, :80], whole[1, :80], rtol=0, atol=atol)
    np.testing.assert_allclose(joined[1, 80:], anew[1], rtol=0, atol=atol)


def test_windows_carry_neurons_whose_potential_is_at_the_chip_s_limit():
    weights, x = random_weights(12, 10), random_input(3, 1200)
    with torch.no_grad():
        weights.w_ff[:5], weights.w_ff[5:] = -1.0, 127 / 128
        weights.syn1[:], weights.mem1[:] = 4095 / 4096, 4095 / 4096
    long, short = Workspace(1200, 3, weights), Workspace(400, 3, weights)
    whole = attsnn(x, weights, long)[0].detach()
    assert long.traces[0].v1.min() == -(2**23 - 1) / 2**14
    fresh = np.ones(3, bool)
    parts = [
        attsnn(x[:, 400 * k : 400 * k + 400], weights, short, fresh & (k == 0))[0].detach() for k in range(3)
    ]
    np.testing.assert_array_equal(torch.cat(parts, 1), whole)


def test_quantised_float32_window_equals_the_float64_one():
    wide = random_weights(100, 100)
    narrow = Weights(*(w.detach().float().requires_grad_() for w in wide))
    x = random_input(4, 300)
    np.testing.assert_array_equal(
        attsnn(x, narrow, Workspace(300, 4, narrow))[0].detach(),
        attsnn(x, wide, Workspace(300, 4, wide))[0].detach().float(),
    )


def test_a_trace_that_is_gone_is_not_used():
    weights, x = random_weights(5, 5), random_input(2, 10)
    space = Workspace(10, 2, weights)
    first, _ = attsnn(x, weights, space)
    attsnn(x, weights, space)
    with pytest.raises(RuntimeError, match="another window"):
        first.sum().backward()
    with pytest.raises(ValueError, match=r"batch: \(2, 9\)"):
        attsnn(x[:, :9], weights, space)
