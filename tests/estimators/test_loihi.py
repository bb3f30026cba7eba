from pathlib import Path

import numpy as np
import pytest
from loihi_network import LoihiNetwork

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
    return LoihiNetwork(layers)


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
