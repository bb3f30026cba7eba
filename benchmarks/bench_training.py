"""One training step of Att-SNN: `python -m benchmarks.bench_training`.

Forward and backward over 40 windows of 10 s. All variants take turns, a step each, on the same network and
batch. Before that, each is held against the fused kernel on a short batch: the same outputs, up to rounding
(Norse delivers spikes within the step, so its outputs come two steps earlier). The dense floor is the time
that the matrix products of the step would take if every weight were used in every step.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from estimators.networks.layer_parameters import DECAY, NEURON_CONSTANTS, THRESHOLD, Weights
from training.fused import Fused
from training.models import quantise_constant, quantise_weights

from .timing import in_turns, spent

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from plain_network import states  # pyright: ignore[reportMissingImports]  (a folder of the tests)

BATCH, STEPS, HIDDEN = 40, 2000, 100
FUSED, NORSE = "fused, quantised", "Norse cells, floats"

Network = Callable[[Tensor], Tensor]


def random_weights(seed: int = 0) -> Weights:
    """Random weights at which both layers spike in a few per cent of the steps."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    shapes = ((HIDDEN, 6), (HIDDEN, HIDDEN), (HIDDEN, HIDDEN), (2, HIDDEN))
    scales = (0.12, 0.03, 0.01, 0.1)
    w = [quantise_weights(torch.tensor(rng.normal(0, k, s))) for s, k in zip(shapes, scales, strict=True)]
    tau = [quantise_constant(torch.tensor(rng.uniform(0.5, 0.98, k)), DECAY) for k in (*[HIDDEN] * 4, 1, 1)]
    return Weights(*(x.float().requires_grad_() for x in (*w, *tau)))


def inputs(n: int, steps: int) -> Tensor:
    """Scaled readings (n, steps, 6) in steps of 2^-10."""
    return torch.tensor(np.round(np.random.default_rng(1).normal(0, 0.3, (n, steps, 6)) * 1024) / 1024)


def fused(quantised: bool = True) -> Network:
    weights, kernels = random_weights(), Fused(quantised)
    return lambda x: kernels.forward(x, weights)[0]


def plain() -> Network:
    weights = random_weights()
    return lambda x: torch.stack([each.v2 for each in states(x.float(), weights)], 1)


def norse() -> Network:
    """Norse's cells with dt = 1; it multiplies currents by 1 - τ_mem, which the weights make up for."""
    from norse.torch import LICell, LIFCell, LIFParameters, LIFRecurrentCell, LIParameters

    w = random_weights()
    rate = {name: (1 - getattr(w, name).detach()).requires_grad_() for name in NEURON_CONSTANTS}
    w_in, w_ff, w_rec, w_out = (
        (getattr(w, name) / (1 - getattr(w, mem))[:, None]).detach().requires_grad_()
        for name, mem in (("w_in", "mem0"), ("w_ff", "mem1"), ("w_rec", "mem1"), ("w_out", "mem2"))
    )
    zero, threshold = torch.tensor(0.0), torch.tensor(THRESHOLD)
    encoding = LIFCell(LIFParameters(rate["syn0"], rate["mem0"], zero, threshold, zero), dt=1.0)
    recurrent = LIFParameters(rate["syn1"], rate["mem1"], zero, threshold, zero)
    hidden = LIFRecurrentCell(
        HIDDEN, HIDDEN, recurrent, input_weights=w_ff, recurrent_weights=w_rec, autapses=True, dt=1.0
    )
    readout = LICell(LIParameters(rate["syn2"], rate["mem2"], zero), dt=1.0)

    def run(x: Tensor) -> Tensor:
        states, out = [None, None, None], []
        drive = (x.float() @ w_in.T).unbind(1)  # a slice a step would make the backward quadratic
        for t in range(x.shape[1]):
            s, states[0] = encoding(drive[t], states[0])
            s, states[1] = hidden(s, states[1])
            y, states[2] = readout(s @ w_out.T, states[2])
            out.append(y)
        return torch.stack(out, 1)

    return run


VARIANTS: dict[str, Callable[[], Network]] = {
    FUSED: fused,
    "fused, floats": lambda: fused(quantised=False),
    "plain PyTorch, floats": plain,
    NORSE: norse,
}
EARLY = 2
"""Steps by which Norse's outputs come before ours."""


def train_step(network: Network, x: Tensor) -> None:
    """Forward and backward."""
    network(x).square().mean().backward()


def dense_floor() -> tuple[float, float]:
    """Forward, spike-gradient and weight-gradient products of all layers at this speed: wall, CPU [s]."""
    a, b = torch.rand(BATCH * 50, HIDDEN), torch.rand(HIDDEN, HIDDEN)
    out = a @ b  # one buffer for all products: a new one each time would measure the memory allocator
    shares = 2 * (2 * HIDDEN**2 + 8 * HIDDEN) * 3 * BATCH * STEPS / (20 * 2 * BATCH * 50 * HIDDEN**2)
    wall, cpu = spent(lambda: [torch.mm(a, b, out=out) for _ in range(20)])
    return shares * wall, shares * cpu


def same_outputs(variant: str, n: int = 4, steps: int = 200) -> bool:
    """Whether a variant computes what the fused kernel does, on a short batch."""
    x, early = inputs(n, steps), EARLY * (variant == NORSE)
    found = VARIANTS[variant]()(x).detach()
    expected = fused(quantised="quantised" in variant)(x).detach()
    return bool((found[:, : steps - early] - expected[:, early:]).abs().max() < 1e-4)


def measure(rounds: int = 9) -> pd.DataFrame:
    """Let all variants take turns; a row of the table for each.

    Raises:
        ValueError: A variant computes something else than the fused kernel.
    """
    torch.set_num_threads(1)
    x, jobs = inputs(BATCH, STEPS), {}
    for name, variant in VARIANTS.items():
        if not same_outputs(name):
            raise ValueError(f"{name}: its outputs differ from the fused kernel's")
        network = variant()
        train_step(network, x)
        jobs[name] = lambda network=network: spent(lambda: train_step(network, x))
    times = in_turns(jobs | {"dense floor": dense_floor}, rounds)
    found = pd.DataFrame({name: np.median(each, axis=0) for name, each in times.items()}, ["wall", "cpu"]).T
    return found.add_suffix("_s").join((found / found.loc[FUSED]).add_suffix("_ratio"))


if __name__ == "__main__":
    print(measure().round(4))
