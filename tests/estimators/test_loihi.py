from pathlib import Path

import numpy as np
import pytest

from estimators.loihi.neurons import LoihiLayer, LoihiNetwork, decay, wrap

GOLDEN = Path(__file__).parents[1] / "data" / "loihi"
CASES = ["a_single_bias", "b_rec100_het", "c_att_like"]


def golden_network(case):
    layers = []
    for k in range(int(case["n_layers"])):
        exponent = case["bias_seq_exp_L0"] if k == 0 and "bias_seq_exp_L0" in case else case[f"L{k}_bias_exp"]
        layers.append(
            LoihiLayer(
                w_in=case.get(f"L{k}_W_in"),
                w_rec=case.get(f"L{k}_W_rec"),
                du=case[f"L{k}_du"],
                dv=case[f"L{k}_dv"],
                vth=case[f"L{k}_vth"],
                bias_mant=case[f"L{k}_bias_mant"],
                bias_exp=exponent,
            )
        )
    return LoihiNetwork(layers)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("n", [1, 3])
def test_emulator_equals_the_golden_vectors(name, n):
    case = dict(np.load(GOLDEN / f"case_{name}.npz"))
    golden = np.load(GOLDEN / f"golden_lava_{name}.npz")
    net = golden_network(case)
    net.reset(n)
    spikes, bias = case.get("s_in"), case.get("bias_seq_mant_L0")
    steps = golden["L0_u"].shape[0]
    seen = {key: np.zeros((n, *golden[key].shape), np.int64) for key in golden}
    for t in range(steps):
        net.step(
            None if spikes is None else np.tile(spikes[t], (n, 1)),
            bias_mant=None if bias is None else bias[t],
        )
        for k in range(len(net.sizes)):
            for state, key in ((net.u, "u"), (net.v, "v"), (net.s, "s")):
                seen[f"L{k}_{key}"][:, t] = state[k]
    for key, values in seen.items():
        np.testing.assert_array_equal(values, np.broadcast_to(golden[key], values.shape), err_msg=key)


def test_decay_rounds_toward_zero():
    assert decay(5, 1) == 4
    assert decay(-5, 1) == -4
    assert decay(123, 0) == 123
    assert decay(-123, 4096) == 0


def test_wrap_is_twos_complement():
    assert wrap((1 << 21) - 1, 21) == (1 << 21) - 1
    assert wrap(1 << 21, 21) == -(1 << 21)
    assert wrap(-(1 << 23) - 1, 23) == (1 << 23) - 1


def test_dendritic_sum_wraps_and_membrane_clips():
    net = LoihiNetwork([LoihiLayer(w_in=np.full((1, 200), 254), du=4096, dv=0, vth=131071)])
    net.reset()
    ones = np.ones((1, 200))
    net.step(ones)
    net.step(ones)
    assert net.u[0][0, 0] == ((254 * 200) << 6) - (1 << 22)
    for _ in range(30):
        net.step(ones)
    assert net.v[0][0, 0] == -(2**23 - 1)


def test_spike_reaches_the_next_layer_after_exactly_one_step():
    one = np.array([[254]])
    net = LoihiNetwork([LoihiLayer(w_in=one, vth=1), LoihiLayer(w_in=one, vth=1)])
    net.reset()
    seen = []
    for t in range(4):
        net.step([[1 if t == 0 else 0]])
        seen.append((int(net.s[0][0, 0]), int(net.s[1][0, 0])))
    assert seen == [(0, 0), (1, 0), (0, 1), (0, 0)]


def test_reset_starts_from_zero():
    case = dict(np.load(GOLDEN / "case_b_rec100_het.npz"))
    net = golden_network(case)
    net.reset(2)
    first = [net.step(np.tile(s, (2, 1))).copy() for s in case["s_in"][:50]]
    net.reset(2)
    again = [net.step(np.tile(s, (2, 1))).copy() for s in case["s_in"][:50]]
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"w_in": [[3]]}, "w_in: weight mantissa 3 is odd"),
        ({"w_in": [[256]]}, r"w_in: value 256, allowed are -256\.\.\.254"),
        ({"w_in": [[0.5]]}, "w_in: has values that are not whole numbers"),
        ({"w_in": [2, 2]}, r"w_in: shape \(2,\)"),
        ({"w_in": [[2]], "w_rec": [[2, 2]]}, r"w_rec: shape \(1, 2\), should be \(1, 1\)"),
        ({"w_in": [[2]], "du": 4097}, r"du: value 4097, allowed are 0\.\.\.4096"),
        ({"w_in": [[2]], "dv": [1, 2]}, r"dv: shape \(2,\)"),
        ({"w_in": [[2]], "vth": -1}, "vth: value -1"),
        ({"w_in": [[2]], "bias_mant": 5000}, "bias_mant: value 5000"),
        ({"w_in": [[2]], "bias_exp": 8}, "bias_exp: value 8"),
    ],
)
def test_what_the_chip_cannot_hold_is_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        LoihiLayer(**kwargs)


def test_layers_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="layer 1: w_in has 3 inputs, but layer 0 has 2 neurons"):
        LoihiNetwork([LoihiLayer(w_in=np.zeros((2, 1))), LoihiLayer(w_in=np.zeros((1, 3)))])
    net = LoihiNetwork([LoihiLayer(w_in=np.zeros((2, 1)))])
    with pytest.raises(ValueError, match=r"spikes_in: shape \(1, 4\), should be \(1, 1\)"):
        net.step(np.zeros((1, 4)))


def test_weights_of_an_exponent_are_that_many_bits_smaller():
    weight = np.array([[100], [100], [-100]])
    net = LoihiNetwork([LoihiLayer(w_in=weight, exp_in=[0, -6, -3], dv=4096, vth=131071)])
    net.step([[1]])
    net.step()
    np.testing.assert_array_equal(net.u[0], [[100 << 6, 100, -100 << 3]])
