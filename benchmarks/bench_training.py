"""One training step of Att-SNN, forward and backward over 40 windows of 10 s: the fused kernel and others.

Run from the repository: `python -m benchmarks.bench_training [--out speed.csv]`; Norse and snnTorch take part
where they are installed (`pip install -c constraints.txt -e ".[bench]"`). Every variant lives in a process of
its own and all take turns, a step each, in one run on the same network and batch: what counts is the ratio of
the medians, on a busy machine that of CPU time.
Before that, each is held against the fused kernel on a short batch: the same outputs, up to rounding (the
libraries deliver spikes within the step, so theirs come two steps earlier). Memory is the most that a process
held above what it held before the first full step. The dense floor is the time that the matrix products of
the step would take if every weight were used in every step.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import os
import re
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from torch import Tensor

from estimators.networks.forward import THRESHOLD, TIME_CONSTANTS
from estimators.spiking import Weights, forward, quantise_decay, quantise_weights
from training.fused import Fused

BATCH, STEPS, HIDDEN = 40, 2000, 100
FUSED, FLOOR, PLAIN = "fused, quantised", "dense floor", "plain PyTorch, floats"
NORSE, SNNTORCH = "Norse cells, floats", "snnTorch, floats"
THREADED = "fused, quantised, 2 threads"

Network = Callable[[Tensor], Tensor]


def parameters(seed: int = 0) -> Weights:
    """Random weights at which both layers spike in a few per cent of the steps."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    shapes = ((HIDDEN, 6), (HIDDEN, HIDDEN), (HIDDEN, HIDDEN), (2, HIDDEN))
    scales = (0.12, 0.03, 0.01, 0.1)
    w = [quantise_weights(torch.tensor(rng.normal(0, k, s))) for s, k in zip(shapes, scales, strict=True)]
    tau = [quantise_decay(torch.tensor(rng.uniform(0.5, 0.98, k))) for k in (*[HIDDEN] * 4, 1, 1)]
    none = torch.zeros(HIDDEN, 0), torch.zeros(0)
    return Weights(*(x.float().requires_grad_() for x in (*w, none[0], *tau, none[1])))


def inputs(n: int, steps: int) -> Tensor:
    """Scaled readings (n, steps, 6) in steps of 2^-10."""
    return torch.tensor(np.round(np.random.default_rng(1).normal(0, 0.3, (n, steps, 6)) * 1024) / 1024)


def fused(n: int, steps: int, quantised: bool = True, threads: int = 1) -> Network:
    weights, kernels = parameters(), Fused(quantised, threads=threads)
    return lambda x: kernels.forward(x, weights)[0]


def plain(n: int, steps: int) -> Network:
    weights = parameters()
    return lambda x: forward(x.float(), weights)[0]


def norse(n: int, steps: int) -> Network:
    """Norse's cells with dt = 1; it multiplies currents by 1 - τ_mem, which the weights make up for."""
    from norse.torch import LICell, LIFCell, LIFParameters, LIFRecurrentCell, LIParameters

    w = parameters()
    rate = {name: (1 - getattr(w, name).detach()).requires_grad_() for name in TIME_CONSTANTS}
    w_in, w_ff, w_rec, w_out = (
        (getattr(w, name) / (1 - getattr(w, mem))[:, None]).detach().requires_grad_()
        for name, mem in (("w_in", "mem0"), ("w_ff", "mem1"), ("w_rec", "mem1"), ("w_out", "mem2"))
    )
    zero, threshold = torch.tensor(0.0), torch.tensor(THRESHOLD)
    encoding = LIFCell(LIFParameters(rate["syn0"], rate["mem0"], zero, threshold, zero), dt=1.0)
    hidden = LIFRecurrentCell(
        HIDDEN,
        HIDDEN,
        LIFParameters(rate["syn1"], rate["mem1"], zero, threshold, zero),
        input_weights=w_ff,
        recurrent_weights=w_rec,
        autapses=True,
        dt=1.0,
    )
    readout = LICell(LIParameters(rate["syn2"], rate["mem2"], zero), dt=1.0)

    def run(x: Tensor) -> Tensor:
        states, out = [None, None, None], []
        drive = (x.float() @ w_in.T).unbind(1)  # a slice a step would make the backward quadratic
        for t in range(steps):
            s, states[0] = encoding(drive[t], states[0])
            s, states[1] = hidden(s, states[1])
            y, states[2] = readout(s @ w_out.T, states[2])
            out.append(y)
        return torch.stack(out, 1)

    return run


def snntorch(n: int, steps: int) -> Network:
    import snntorch as library

    w = parameters()
    gradient = library.surrogate.fast_sigmoid(slope=20)

    def layer(syn: Tensor, mem: Tensor, reset: str) -> library.Synaptic:
        return library.Synaptic(
            syn.detach(), mem.detach(), THRESHOLD, gradient, learn_alpha=True, learn_beta=True,
            reset_mechanism=reset, reset_delay=False,
        )  # fmt: skip

    encoding, hidden = layer(w.syn0, w.mem0, "zero"), layer(w.syn1, w.mem1, "zero")
    readout = layer(w.syn2, w.mem2, "none")

    def run(x: Tensor) -> Tensor:
        drive = (x.float() @ w.w_in.T).unbind(1)
        u0 = v0 = s1 = u1 = v1 = torch.zeros(n, HIDDEN)
        u2 = v2 = torch.zeros(n, 2)
        out = []
        for t in range(steps):
            s0, u0, v0 = encoding(drive[t], u0, v0)
            s1, u1, v1 = hidden(s0 @ w.w_ff.T + s1 @ w.w_rec.T, u1, v1)
            _, u2, v2 = readout(s1 @ w.w_out.T, u2, v2)
            out.append(v2)
        return torch.stack(out, 1)

    return run


VARIANTS: dict[str, Callable[[int, int], Network]] = {
    FUSED: fused,
    THREADED: lambda n, steps: fused(n, steps, threads=2),
    "fused, floats": lambda n, steps: fused(n, steps, quantised=False),
    PLAIN: plain,
    SNNTORCH: snntorch,
    NORSE: norse,
}
NEEDS = {NORSE: "norse", SNNTORCH: "snntorch"}
EARLY = {NORSE: 2, SNNTORCH: 2}
"""Steps by which a library's outputs come before ours."""


def step(network: Network, x: Tensor) -> None:
    """Forward and backward."""
    network(x).square().mean().backward()


def dense_floor() -> tuple[float, float]:
    """Forward, spike-gradient and weight-gradient products of all layers at this speed: wall, CPU [s]."""
    a, b = torch.rand(BATCH * 50, HIDDEN), torch.rand(HIDDEN, HIDDEN)
    out = a @ b  # one buffer for all products: a new one each time would measure the memory allocator
    shares = 2 * (2 * HIDDEN**2 + 8 * HIDDEN) * 3 * BATCH * STEPS / (20 * 2 * BATCH * 50 * HIDDEN**2)
    wall, cpu = timed(lambda: [torch.mm(a, b, out=out) for _ in range(20)])
    return shares * wall, shares * cpu


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Wall time and CPU time of all threads [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def same_outputs(variant: str, n: int = 4, steps: int = 200) -> bool:
    """Whether a variant computes what the fused kernel does, on a short batch."""
    x, early = inputs(n, steps), EARLY.get(variant, 0)
    found = VARIANTS[variant](n, steps)(x).detach()
    expected = fused(n, steps, quantised="quantised" in variant)(x).detach()
    return bool((found[:, : steps - early] - expected[:, early:]).abs().max() < 1e-4)


def memory(field: str) -> float:
    """VmRSS (now) or VmHWM (the most so far) of this process [MB]."""
    found = re.search(rf"{field}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) / 1e3 if found else float("nan")


def serve(variant: str, pipe: Connection) -> None:
    """In a process of its own: warm up, then a step each time it is asked; its time and the memory so far."""
    torch.set_num_threads(1)
    if variant == FLOOR:
        pipe.send(True)
        while pipe.recv():
            pipe.send((*dense_floor(), 0.0))
        return
    alike = same_outputs(variant)
    step(VARIANTS[variant](4, 20), inputs(4, 20))
    before = memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # forgets the peak so far, that of compiling
    network, x = VARIANTS[variant](BATCH, STEPS), inputs(BATCH, STEPS)
    step(network, x)
    pipe.send(alike)
    while pipe.recv():
        pipe.send((*timed(lambda: step(network, x)), memory("VmHWM") - before))


def measure(rounds: int = 5, say: Callable[[str], None] = print) -> Iterator[dict[str, object]]:
    """Let all variants that are installed take turns; a row of the table for each."""
    names = [name for name in VARIANTS if name not in NEEDS or find_spec(NEEDS[name])]
    for name in sorted(NEEDS.keys() - set(names)):
        say(f"{name}: left out, {NEEDS[name]} is not installed")
    context = multiprocessing.get_context("spawn")
    pipes: dict[str, Connection] = {}
    for name in (*names, FLOOR):
        pipes[name], theirs = context.Pipe()
        context.Process(target=serve, args=(name, theirs), daemon=True).start()
        alike = pipes[name].recv()  # one after the other: no two warm up at once
        say(f"{name}: ready" + ("" if alike else ", but its outputs differ from the fused kernel's"))
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in pipes}
    peak: dict[str, float] = {}
    for _ in range(rounds):
        for name, pipe in pipes.items():
            pipe.send(True)
            *both, peak[name] = pipe.recv()
            times[name].append((both[0], both[1]))
    for pipe in pipes.values():
        pipe.send(False)
    medians = {name: np.median(values, axis=0) for name, values in times.items()}
    for name, (wall, cpu) in medians.items():
        yield {
            "variant": name,
            "wall_s": round(float(wall), 4),
            "cpu_s": round(float(cpu), 4),
            "wall_ratio": round(float(wall / medians[FUSED][0]), 2),
            "cpu_ratio": round(float(cpu / medians[FUSED][1]), 2),
            "memory_MB": round(peak[name]),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, help="also write the table as CSV")
    args = parser.parse_args()
    rows = list(measure(args.rounds))
    rates = Fused().forward(inputs(4, STEPS), parameters())[1]
    print(f"spike rates: encoding {rates[0]:.3f}, hidden {rates[1]:.3f} per neuron and step")
    print(f"{'variant':<28} {'wall [s]':>9} {'CPU [s]':>9} {'x fused':>8} {'CPU x':>7} {'memory [MB]':>12}")
    for row in rows:
        print(
            f"{row['variant']:<28} {row['wall_s']:>9.3f} {row['cpu_s']:>9.3f} {row['wall_ratio']:>8.2f} "
            f"{row['cpu_ratio']:>7.2f} {row['memory_MB']:>12}"
        )
    if args.out:
        with args.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
