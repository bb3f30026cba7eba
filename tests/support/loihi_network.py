"""Layers in a chain on the emulated chip, stepped together."""

import numpy as np

from estimators.loihi.neurons import DECAY_ONE, VTH_EXP, NeuronState, list_spikes, neurons_of, step
from quadsim.runs.compiled import njit

DEFAULTS = {"w_in": None, "w_rec": None, "du": DECAY_ONE, "dv": DECAY_ONE, "vth": 128, "bias_mant": 0}
DEFAULTS |= {"bias_exp": 0, "exp_in": 0, "exp_rec": 0, "w_after": 0, "d_after": DECAY_ONE, "exp_after": 0}


class LoihiNetwork:
    """Layers with the mantissas and exponents of `estimators.loihi.chip.LoihiLayer`, and biases.

    In one step every layer reads the spikes of the step before. The network's inputs come first, as neurons
    that repeat their bias.
    """

    def __init__(self, layers):
        def filled(layer):
            layer = DEFAULTS | {name: value for name, value in layer.items() if value is not None}
            w_in = layer.pop("w_in")
            size = max(map(np.size, layer.values())) if w_in is None else len(w_in)
            w_rec = layer.pop("w_rec")
            vectors = {name: np.broadcast_to(np.asarray(value, int), size) for name, value in layer.items()}
            w_in = np.zeros((size, 0), int) if w_in is None else np.asarray(w_in, int)
            return vectors | {"w_in": w_in, "w_rec": np.zeros((size, size), int) if w_rec is None else w_rec}

        self.layers = [filled(layer) for layer in layers]
        inputs = self.layers[0]["w_in"].shape[1]
        self.edges = np.cumsum([0, inputs, *(len(layer["w_in"]) for layer in self.layers)])
        self.weights = np.zeros((1, self.edges[-1], self.edges[-1] - inputs), np.int16)
        for k, layer in enumerate(self.layers, 1):
            below, own = slice(*self.edges[k - 1 : k + 1]), slice(*self.edges[k : k + 2])
            targets = slice(own.start - inputs, own.stop - inputs)
            if layer["w_in"].shape[1]:
                self.weights[0, below, targets] = layer["w_in"].T << (VTH_EXP + layer["exp_in"])
            self.weights[0, own, targets] = np.transpose(layer["w_rec"]) << (VTH_EXP + layer["exp_rec"])

        def joined(of_inputs, rows):
            return np.concatenate([np.full(inputs, of_inputs), *rows]).astype(np.int32)

        self.table = np.stack(
            [
                *(joined(DECAY_ONE, [layer[name] for layer in self.layers]) for name in ("du", "dv")),
                joined(0, [layer["vth"] << VTH_EXP for layer in self.layers]),
                joined(0, [layer["bias_mant"] << layer["bias_exp"] for layer in self.layers]),
                joined(0, [layer["w_after"] << (VTH_EXP + layer["exp_after"]) for layer in self.layers]),
                joined(DECAY_ONE, [layer["d_after"] for layer in self.layers]),
            ]
        )
        self.reset()

    def reset(self, n=1):
        first, targets = self.edges[1], self.edges[-1] - self.edges[1]
        self.state = NeuronState(*(np.zeros((n, k), np.int32) for k in (first, targets, targets, targets)))

    def step(self, spikes_in=None, bias_mant=None):
        """One step; biases of the first layer in this step only, None: its own."""
        table, first = self.table.copy(), self.edges[1]
        if bias_mant is not None:
            table[3, first : self.edges[2]] = bias_mant << self.layers[0]["bias_exp"]
        arriving = np.zeros(first) if spikes_in is None else spikes_in
        drive = np.broadcast_to(arriving, self.state.first_v.shape).astype(np.int32)
        step_all(self.weights, table, drive, self.state)

    @property
    def u(self):
        return self.by_layer(self.state.u)

    @property
    def v(self):
        """Potentials after the reset."""
        return self.by_layer(np.where(self.fired, 0, self.state.v))

    @property
    def s(self):
        return self.by_layer(self.fired)

    @property
    def fired(self):
        return self.state.v > self.table[2, self.edges[1] :]

    def by_layer(self, values):
        return np.split(values, self.edges[2:-1] - self.edges[1], axis=1)


@njit(cache=True)
def step_all(weights, table, drive, states):
    """One step of all copies, whose states are rows."""
    neurons = neurons_of(weights, drive.shape[1], table)
    spikes, sums = np.empty(weights.shape[1] + 2, np.int32), np.zeros(weights.shape[2], np.int32)
    for n in range(drive.shape[0]):
        copy = NeuronState(states.first_v[n], states.u[n], states.v[n], states.a[n])
        list_spikes(neurons, copy.first_v, copy.v, spikes)
        step(neurons, drive[n], copy, spikes, spikes, sums)
