"""The emulator against the equations written out in plain Python, whose integers have no limits."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.loihi import LoihiLayer, LoihiNetwork


def decayed(x, d):
    size = abs(x) * (4096 - d) // 4096
    return size if x >= 0 else -size


def wrapped(x, bits):
    """Two's complement by counting, not by masks."""
    turns = (x + 2**bits) // 2 ** (bits + 1)
    return x - turns * 2 ** (bits + 1)


def reference(layers, spikes, biases):
    """States of every layer after every step: (u, v, s), each a list of lists."""
    u, v, s = ([[0] * len(layer["du"]) for layer in layers] for _ in range(3))
    history, external = [], [0] * len(spikes[0])
    for t, arriving in enumerate(spikes):
        before = [external, *[list(each) for each in s]]
        for k, layer in enumerate(layers):
            for i in range(len(layer["du"])):
                total = 0
                for name, sent in (("in", before[k]), ("rec", before[k + 1])):
                    weights = layer[f"w_{name}"] or [[0] * len(sent)] * (i + 1)
                    one = 2 ** (6 + layer[f"exp_{name}"][i])
                    total += one * sum(w * x for w, x in zip(weights[i], sent, strict=True))
                u[k][i] = wrapped(decayed(u[k][i], layer["du"][i]) + wrapped(total, 21), 23)
                bias = biases[t][i] if k == 0 else layer["bias_mant"][i]
                new = decayed(v[k][i], layer["dv"][i]) + u[k][i]
                new += bias * 2 ** layer["bias_exp"][i]
                new = max(-(2**23) + 1, min(2**23 - 1, new))
                s[k][i] = int(new > layer["vth"][i] * 64)
                v[k][i] = 0 if s[k][i] else new
        external = list(arriving)
        history.append([[list(each) for each in part] for part in (u, v, s)])
    return history


@st.composite
def networks(draw):
    """One to three layers of up to six neurons, any decays, biases and weights, the extremes among them."""
    widths = draw(st.lists(st.integers(1, 6), min_size=2, max_size=4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    heavy = draw(st.booleans())  # many strong synapses: the dendritic sum and the current wrap
    fan_in = 200 if heavy else widths[0]
    layers, below = [], fan_in
    for width in widths[1:]:

        def pick(low, high, *extremes, width=width):
            return np.where(
                rng.random(width) < 0.3, rng.choice(extremes, width), rng.integers(low, high, width)
            )

        low = 60 if heavy and rng.random() < 0.5 else -128
        layers.append(
            {
                "w_in": 2 * rng.integers(low, 128, (width, below)),
                "w_rec": 2 * rng.integers(-128, 128, (width, width)) if draw(st.booleans()) else None,
                "du": pick(0, 4097, 0, 1, 4096),
                "dv": pick(0, 4097, 0, 1, 4096),
                "vth": pick(0, 3000, 0, 1, 128, 131071),
                "bias_mant": pick(-4096, 4096, -4096, 0, 4095),
                "bias_exp": pick(0, 8, 0, 6, 7),
                "exp_in": np.zeros(width, int) if heavy else pick(-6, 1, -6, 0),
                "exp_rec": pick(-6, 1, -6, 0),
            }
        )
        below = width
    steps = draw(st.integers(5, 40))
    spikes = rng.random((steps, fan_in)) < draw(st.sampled_from([0.05, 0.5, 1.0]))
    biases = rng.integers(-4096, 4096, (steps, widths[1])) * (rng.random((steps, 1)) < 0.8)
    return layers, spikes.astype(int), biases


@settings(max_examples=60, deadline=None)
@given(networks())
def test_emulator_equals_plain_python(case):
    layers, spikes, biases = case
    plain = [{k: None if x is None else x.tolist() for k, x in layer.items()} for layer in layers]
    expected = reference(plain, spikes.tolist(), biases.tolist())
    net = LoihiNetwork([LoihiLayer(**layer) for layer in layers])
    net.reset(2)
    for t, states in enumerate(expected):
        net.step(np.tile(spikes[t], (2, 1)), bias_mant=biases[t])
        for found, wanted in zip((net.u, net.v, net.s), states, strict=True):
            for k, layer in enumerate(wanted):
                np.testing.assert_array_equal(found[k], [layer, layer])
