"""Att-SNN on an NVIDIA GPU: the kernels of `att_snn.cu` through CuPy, weights on the CPU or the GPU.

The forward pass has the integers of the chip, on the tensor cores; gradients equal those of the other
backends to rounding. Layers are padded with zeros to multiples of 32 neurons, sequences to multiples of 8.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from estimators.networks.forward import STATE_ONE, Weights
from estimators.networks.weights_file import EXPONENT_MIN
from estimators.spiking import weight_exponents

SEQUENCES, TILE, MOST_NEURONS = 8, 32, 192
"""Sequences of a block, neurons that a layer is padded to a multiple of, and the most that a layer has."""
REGISTERS_HOLD = 128
"""Neurons of a hidden layer above which a block keeps weights of the backward pass in shared memory."""


NO_GPU = "backend cuda: PyTorch finds no GPU; choose another backend"


class Kernels(Protocol):
    """The kernels of `att_snn.cu` for a network's sizes, arguments as there: tensors, whole numbers."""

    def forward_window(self, *args: Any) -> None: ...  # noqa: D102
    def backward_outputs(self, *args: Any) -> None: ...  # noqa: D102
    def backward_window(self, *args: Any) -> None: ...  # noqa: D102


def source() -> str:
    """The kernels, CUDA C++."""
    return Path(__file__).with_name("att_snn.cu").read_text()


class OnGpu:
    """The kernels on the current GPU, in PyTorch's current stream.

    Raises:
        ValueError: CuPy is not installed, or there is no GPU.
    """

    def __init__(self, encoding: int, hidden: int, outputs: int) -> None:
        """Compile the kernels for padded layers."""
        try:
            import cupy  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            text = "backend cuda needs CuPy: pip install 'quadsim[gpu]', or choose another backend"
            raise ValueError(text) from error
        if not torch.cuda.is_available():
            raise ValueError(NO_GPU)
        sizes = {"H0": encoding, "H1": hidden, "INPUTS": 6, "OUTPUTS": outputs}
        options = ("-std=c++17", *(f"-D{name}={value}" for name, value in sizes.items()))
        module = cupy.RawModule(code=source(), options=options)
        self._cupy, self._outputs = cupy, outputs
        names = ("forward_window", "backward_outputs", "backward_window")
        self._forward, self._output, self._backward = map(module.get_function, names)
        self._threads = max(encoding, hidden) // 16 * 32
        self._shared = 16 * self._threads * (hidden // 16) if hidden > REGISTERS_HOLD else 0
        if self._shared:
            self._backward.max_dynamic_shared_size_bytes = self._shared

    def _launch(self, kernel: Any, blocks: int, threads: int, args: tuple[Tensor | int, ...], shared=0):
        values = tuple(a.data_ptr() if isinstance(a, Tensor) else np.int32(a) for a in args)
        with self._cupy.cuda.ExternalStream(torch.cuda.current_stream().cuda_stream):
            kernel((blocks,), (threads,), values, shared_mem=shared)

    def forward_window(self, steps: int, n: int, *args: Tensor | int) -> None:
        """Of `att_snn.cu`."""
        self._launch(self._forward, n // SEQUENCES, self._threads, (steps, n, *args))

    def backward_outputs(self, steps: int, n: int, *args: Tensor | int) -> None:
        """Of `att_snn.cu`."""
        self._launch(self._output, -(-n * self._outputs // 128), 128, (steps, n, *args))

    def backward_window(self, steps: int, n: int, *args: Tensor | int) -> None:
        """Of `att_snn.cu`."""
        self._launch(self._backward, n // SEQUENCES, self._threads, (steps, n, *args), self._shared)


@dataclass
class Trace:
    """What the forward pass leaves, time first; row 0 comes before the window."""

    u0: Tensor
    """Currents and potentials before the reset [state units], int32, (T + 1, n, neurons)."""
    v0: Tensor
    u1: Tensor
    v1: Tensor
    u2: Tensor
    v2: Tensor
    a1: Tensor
    """After-spike currents of the hidden layer, the same."""
    spikes: Tensor
    """Of both layers, bfloat16, (T + 1, n, neurons)."""
    totals: Tensor
    """Spikes of each layer in the window, int64, (2,)."""

    @classmethod
    def empty(cls, steps: int, n: int, sizes: tuple[int, int, int], device: torch.device) -> Trace:
        """Buffers for one window."""
        of_states = (*np.repeat(sizes, 2), sizes[1])
        states = [torch.zeros(steps + 1, n, size, dtype=torch.int32, device=device) for size in of_states]
        spikes = torch.zeros(steps + 1, n, sizes[0] + sizes[1], dtype=torch.bfloat16, device=device)
        return cls(*states, spikes=spikes, totals=torch.zeros(2, dtype=torch.int64, device=device))

    @property
    def states(self) -> list[Tensor]:
        """Currents and potentials."""
        return [getattr(self, field.name) for field in fields(self)[:7]]

    def begin(self, goes_on: Tensor) -> None:
        """Start where the last window ended, sequences whose `goes_on` (n,) is 0 from rest."""
        for rows in self.states:
            torch.mul(rows[-1], goes_on[:, None], out=rows[0])
        self.totals.zero_()


def _padded(size: int, to: int) -> int:
    return -(-size // to) * to


def _two_parts(x: Tensor) -> Tensor:
    """Numbers (m, k) as the sum of two bfloat16 ones, side by side (m, 2 k)."""
    high = x.to(torch.bfloat16)
    return torch.cat([high, (x - high).to(torch.bfloat16)], 1)


def _product(parts: Tensor, spikes: Tensor) -> Tensor:
    """Gradients, as two parts (m, 2 k), times spikes (m, sources), summed over m: (k, sources)."""
    if parts.is_cuda:
        both = torch.mm(parts.T, spikes, out_dtype=torch.float32)
    else:
        both = parts.float().T @ spikes.float()
    return both[: len(both) // 2] + both[len(both) // 2 :]


class _OnDevice(torch.autograd.Function):
    @staticmethod
    def forward(ctx, backend: Cuda, trace: Trace, goes_on: Tensor, x: Tensor, *weights: Tensor) -> Any:
        device, (encoding, hidden, outputs) = x.device, backend.padded
        w = Weights(*(each.detach().to(device) for each in weights))

        def whole(values: Tensor, one: float, *shape: int, dtype: torch.dtype = torch.int32) -> Tensor:
            filled = torch.zeros(shape, dtype=dtype, device=device)
            filled[tuple(slice(size) for size in values.shape)] = torch.round(values * one).to(dtype)
            return filled

        into = torch.zeros(hidden, encoding + hidden, dtype=torch.int8, device=device)
        shifts = torch.zeros(2, hidden, dtype=torch.int32, device=device)
        for k, (matrix, columns) in enumerate(((w.w_ff, slice(encoding)), (w.w_rec, slice(encoding, None)))):
            exponents = weight_exponents(matrix, EXPONENT_MIN)
            mantissas = matrix * torch.exp2(-exponents)
            into[:, columns] = whole(mantissas, 128, hidden, into[:, columns].shape[1], dtype=torch.int8)
            shifts[k, : len(matrix)] = (7 + exponents[:, 0]).int()
        out = whole(w.w_out, 128, outputs, hidden, dtype=torch.int8)
        own = whole(w.w_after, STATE_ONE, hidden, 1)
        in_layers = (w.syn0, w.mem0, w.syn1, w.mem1, w.syn_after)
        sizes = (encoding, encoding, hidden, hidden, hidden)
        taus = [whole(tau, 4096, size) for tau, size in zip(in_layers, sizes, strict=True)]
        last = torch.cat([whole(tau, 4096, 1) for tau in (w.syn2, w.mem2)])
        trace.begin(goes_on)
        steps, n = x.shape[:2]
        inputs = whole(w.w_in, 256, encoding, 6)
        backend.kernels.forward_window(
            steps,
            n,
            x,
            into,
            shifts,
            own,
            out,
            inputs,
            *taus,
            last,
            *trace.states,
            trace.spikes,
            trace.totals,
        )
        ctx.backend, ctx.trace, ctx.run, ctx.x = backend, trace, backend.count(), x
        ctx.values, ctx.weights = (
            (into, shifts, own.float() / STATE_ONE, out.float() / 128, taus, last),
            weights,
        )
        rates = trace.totals.float() / torch.tensor(backend.places(steps), device=device)
        return trace.v2[1:].float() / STATE_ONE, rates

    @staticmethod
    def backward(ctx, *grads: Tensor):
        backend: Cuda = ctx.backend
        trace: Trace = ctx.trace
        if backend.runs != ctx.run:
            raise RuntimeError("the workspace has run another window since this one: its trace is gone")
        into, shifts, w_after, w_out, taus, last = ctx.values
        (steps, n), (encoding, hidden, outputs) = ctx.x.shape[:2], backend.padded
        device = {"device": ctx.x.device}
        of_currents = torch.empty(steps + 1, n, 4 if outputs <= 4 else 8, **device)
        of_last = torch.empty(n * outputs, 2, **device)
        backend.kernels.backward_outputs(
            steps, n, grads[0].contiguous(), trace.u2, trace.v2, last, of_currents, of_last
        )
        costs = (grads[1] / torch.tensor(backend.places(steps), **device)).contiguous()
        down = torch.empty(steps, n, 2, hidden, dtype=torch.bfloat16, **device)
        sums = torch.empty(n // SEQUENCES, 8 * encoding + 4 * hidden, **device)
        backend.kernels.backward_window(
            steps,
            n,
            ctx.x,
            into,
            shifts,
            w_after,
            w_out,
            *(tau.float() / 4096 for tau in taus),
            costs,
            *trace.states[:4],
            trace.a1,
            of_currents,
            down,
            sums,
        )
        first, second = sums.sum(0).split([8 * encoding, 4 * hidden])
        first, second = first.view(encoding, 8), second.view(hidden, 4)
        spikes = trace.spikes[:-1].reshape(steps * n, encoding + hidden)
        of_weights = _product(down.view(steps * n, 2 * hidden), spikes)
        read = of_currents[:-1, :, :outputs].reshape(steps * n, outputs)
        of_out = _product(_two_parts(read), spikes)[:, encoding:]
        syn2, mem2 = of_last.sum(0).split(1)
        found = Weights(
            first[:, :6], of_weights[:, :encoding], of_weights[:, encoding:], of_out, second[:, 2:3],
            first[:, 6], first[:, 7], second[:, 0], second[:, 1], syn2, mem2, second[:, 3],
        )  # fmt: skip
        cut = (g[tuple(slice(size) for size in w.shape)] for g, w in zip(found, ctx.weights, strict=True))
        return None, None, None, None, *(g.to(w) for g, w in zip(cut, ctx.weights, strict=True))


class Cuda:
    """The backend on a GPU; see `Backend` and `BACKENDS`. Windows are moved there, outputs come back.

    Args:
        quantised: As on the chip; floats are not supported.
        recurrent_delay: 1.
        threads: Of the CPU; not used.
        kernels: Makes the kernels for padded layers; a test emulates them.

    Raises:
        ValueError: Floats, another delay, no CuPy or no GPU.
    """

    def __init__(
        self,
        quantised: bool = True,
        recurrent_delay: int = 1,
        threads: int = 1,
        kernels: Callable[[int, int, int], Kernels] = OnGpu,
    ) -> None:
        """Check the choices; buffers are made for each shape of a window."""
        if not quantised or recurrent_delay != 1:
            raise ValueError(
                "backend cuda is for quantised networks with a recurrent delay of 1; choose fused"
            )
        self.quantised, self.recurrent_delay, self._make = True, 1, kernels
        self._sizes: tuple[int, int, int] | None = None
        if kernels is OnGpu:
            OnGpu(TILE, TILE, 2)  # says at once what is missing
        self.runs = 0

    def forward(
        self, x: Tensor, weights: Weights[Tensor], reset: NDArray[np.bool_] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Run a window; its trace is lost when another one of its shape runs.

        Raises:
            ValueError: A layer of too many neurons.
        """
        sizes = (weights.w_in.shape[0], weights.w_ff.shape[0], weights.w_out.shape[0])
        if sizes != self._sizes:
            self._set_sizes(sizes)
        n, steps, _ = x.shape
        device = torch.device("cuda") if self._make is OnGpu else torch.device("cpu")
        if (n, steps) not in self._traces:
            size = _padded(n, SEQUENCES)
            self._traces[n, steps] = Trace.empty(steps, size, self.padded, device)
        self._last, self._n = self._traces[n, steps], n
        whole = torch.zeros(steps, _padded(n, SEQUENCES), 8, dtype=torch.int16, device=device)
        whole[:, :n, :6] = torch.round(x.to(device) * 1024).transpose(0, 1).to(torch.int16)
        goes_on = torch.zeros(whole.shape[1], dtype=torch.int32, device=device)
        if reset is not None:
            goes_on[:n] = torch.from_numpy(~reset).to(goes_on)
        out, rates = _OnDevice.apply(self, self._last, goes_on, whole, *weights)  # pyright: ignore
        return out[:, :n].transpose(0, 1).to(x.device), rates.to(x.device)

    def _set_sizes(self, sizes: tuple[int, int, int]) -> None:
        """Make kernels and forget the buffers."""
        if max(sizes[:2]) > MOST_NEURONS:
            text = f"layers of {sizes[0]} and {sizes[1]} neurons, at most {MOST_NEURONS} fit; choose fused"
            raise ValueError(f"backend cuda: {text}")
        self._sizes = sizes
        self.padded = (_padded(sizes[0], TILE), _padded(sizes[1], TILE), sizes[2])
        self.kernels = self._make(*self.padded)
        self._traces: dict[tuple[int, int], Trace] = {}

    def count(self) -> int:
        """The number of a window, counted from 1."""
        self.runs += 1
        return self.runs

    def places(self, steps: int) -> list[float]:
        """Places for a spike in the last window (neurons, steps, sequences) of each layer."""
        assert self._sizes is not None
        return [float(size * steps * self._n) for size in self._sizes[:2]]

    def spikes(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Spikes of both layers in the last window."""
        assert self._sizes is not None
        every = self._last.spikes[1:, : self._n].transpose(0, 1).float().numpy(force=True) > 0
        first, middle = self._sizes[0], self.padded[0]
        return every[..., :first], every[..., middle : middle + self._sizes[1]]

    def peak_currents(self, every: int = 1) -> tuple[NDArray[np.floating], ...]:
        """Largest currents of both layers, and after-spike ones, in the last window."""
        assert self._sizes is not None
        encoding, hidden, _ = self._sizes
        currents = ((self._last.u0, encoding), (self._last.u1, hidden), (self._last.a1, hidden))
        return tuple(
            (u[every::every, : self._n, :size].abs().amax((0, 1)).float() / STATE_ONE).numpy(force=True)
            for u, size in currents
        )

    def connected(self, encoding: NDArray[np.int64], hidden: NDArray[np.int64]) -> Cuda:
        """The backend of these neurons alone; its windows continue from the last ones here."""
        smaller = copy(self)
        smaller._sizes, smaller._traces = None, {}
        if self._sizes is None:
            return smaller
        smaller._set_sizes((encoding.size, hidden.size, self._sizes[2]))
        of_layer = [torch.from_numpy(encoding)] * 2 + [torch.from_numpy(hidden)] * 2
        of_layer += [torch.arange(self._sizes[2])] * 2 + [torch.from_numpy(hidden)]
        for (n, steps), old in self._traces.items():
            device, size = old.v0.device, old.v0.shape[1]
            new = smaller._traces[n, steps] = Trace.empty(steps, size, smaller.padded, device)
            for rows, before, neurons in zip(new.states, old.states, of_layer, strict=True):
                rows[-1, :, : neurons.numel()] = before[-1][:, neurons.to(device)]
        return smaller
