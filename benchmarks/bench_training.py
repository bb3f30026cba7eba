"""One training step of Att-SNN, forward and backward over 40 windows of 10 s: fused kernel and plain PyTorch.

Run from the repository: `python -m benchmarks.bench_training [--threads 2]`. All variants take turns in one
run on the same network and batch; what counts is the ratio. The dense floor is the time that the matrix
products of the step would take if every weight were used in every step.
"""

from __future__ import annotations

import argparse
import os
import resource
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

from estimators.spiking import Weights, forward, quantise_decay, quantise_weights
from training.kernels import Workspace, attsnn

BATCH, STEPS, HIDDEN = 40, 2000, 100


def network(seed: int = 0) -> Weights:
    """Random weights at which both layers spike in a few per cent of the steps."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    shapes = ((HIDDEN, 6), (HIDDEN, HIDDEN), (HIDDEN, HIDDEN), (2, HIDDEN))
    scales = (0.12, 0.03, 0.01, 0.1)
    w = [quantise_weights(torch.tensor(rng.normal(0, k, s))) for s, k in zip(shapes, scales, strict=True)]
    tau = [quantise_decay(torch.tensor(rng.uniform(0.5, 0.98, k))) for k in (*[HIDDEN] * 4, 1, 1)]
    return Weights(*(x.float().requires_grad_() for x in (*w, *tau)))


def fused(x: torch.Tensor, weights: Weights, space: Workspace) -> tuple[float, torch.Tensor]:
    start = time.perf_counter()
    out, rates = attsnn(x, weights, space)
    out.square().mean().backward()
    return time.perf_counter() - start, rates


def plain(x: torch.Tensor, weights: Weights) -> float:
    start = time.perf_counter()
    out, _, _ = forward(x, weights)
    out.square().mean().backward()
    return time.perf_counter() - start


def dense_floor() -> float:
    """Forward, spike-gradient and weight-gradient products of all layers, at this core's speed."""
    a, b = torch.rand(BATCH * 50, HIDDEN), torch.rand(HIDDEN, HIDDEN)
    a @ b
    start = time.perf_counter()
    for _ in range(10):
        a @ b
    rate = 10 * 2 * BATCH * 50 * HIDDEN**2 / (time.perf_counter() - start)
    products = 2 * (2 * HIDDEN**2 + 8 * HIDDEN) * 3 * BATCH * STEPS
    return products / rate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2, help="threads of the second fused variant")
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    torch.set_num_threads(1)
    weights = network()
    x = torch.tensor(np.round(np.random.default_rng(1).normal(0, 0.3, (BATCH, STEPS, 6)) * 1024) / 1024)
    spaces = {
        "fused, quantised": Workspace(STEPS, BATCH, weights, True),
        "fused, floats": Workspace(STEPS, BATCH, weights, False),
        f"fused, quantised, {args.threads} threads": Workspace(STEPS, BATCH, weights, True, 1, args.threads),
    }
    times: dict[str, list[float]] = {name: [] for name in (*spaces, "plain PyTorch, floats", "dense floor")}
    rates = torch.zeros(2)
    for space in spaces.values():
        fused(x, weights, space)  # compiles
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    for _ in range(args.rounds):
        for name, space in spaces.items():
            seconds, rates = fused(x, weights, space)
            times[name].append(seconds)
        times["dense floor"].append(dense_floor())
        times["plain PyTorch, floats"].append(plain(x.float(), weights))
    first = min(times["fused, quantised"])
    print(f"spike rates: encoding {rates[0]:.3f}, hidden {rates[1]:.3f} per neuron and step")
    print(f"{'variant':<32} {'best [s]':>9} {'median [s]':>11} {'x fused':>8}")
    for name, values in times.items():
        print(f"{name:<32} {min(values):9.3f} {np.median(values):11.3f} {min(values) / first:8.2f}")
    print(f"peak memory: {memory:.2f} GB with three fused variants, ", end="")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB after plain PyTorch")


if __name__ == "__main__":
    main()
