from pathlib import Path

import numpy as np
import pytest

from estimators.loihi import LoihiLayer, LoihiNetwork

GOLDEN = Path(__file__).parents[1] / "data" / "loihi"
CASES = ["a_single_bias", "b_rec100_het", "c_att_like"]


def golden_network(case):
    names = ("du", "dv", "vth", "bias_mant", "bias_exp")
    layers = [
        {name: case[f"L{k}_{name}"] for name in names}
        | {"w_in": case.get(f"L{k}_W_in"), "w_rec": case.get(f"L{k}_W_rec")}
        for k in range(int(case["n_layers"]))
    ]
    layers[0]["bias_exp"] = case.get("bias_seq_exp_L0", layers[0]["bias_exp"])
    return LoihiNetwork([LoihiLayer(**layer) for layer in layers])


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("n", [1, 3])
def test_emulator_equals_the_golden_vectors(name, n):
    case = dict(np.load(GOLDEN / f"case_{name}.npz"))
    golden = np.load(GOLDEN / f"golden_lava_{name}.npz")
    net = golden_network(case)
    net.step()  # which a reset forgets
    net.reset(n)
    spikes, bias = case.get("s_in"), case.get("bias_seq_mant_L0")
    steps = golden["L0_u"].shape[0]
    seen = {key: np.zeros((n, *golden[key].shape), np.int64) for key in golden}
    for t in range(steps):
        net.step(
            None if spikes is None else np.tile(spikes[t], (n, 1)),
            bias_mant=None if bias is None else bias[t],
        )
        for k in range(len(net.layers)):
            for state, key in ((net.u, "u"), (net.v, "v"), (net.s, "s")):
                seen[f"L{k}_{key}"][:, t] = state[k]
    for key, values in seen.items():
        np.testing.assert_array_equal(values, np.broadcast_to(golden[key], values.shape), err_msg=key)


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
    with pytest.raises(ValueError, match="spikes_in: spikes are 0 or 1"):
        net.step([[np.nan]])
    with pytest.raises(ValueError, match="bias_mant: has values that are not whole numbers"):
        net.step(bias_mant=[np.nan, 0])
