"""The GPU backend's kernels, emulated on the CPU: every thread a thread, tensor cores by their definition."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from estimators.networks.forward import Weights
from estimators.networks.weights_file import EXPONENTS
from estimators.spiking import quantise_decay, quantise_weights
from training.backends import BACKENDS
from training.backends.cuda import MOST_NEURONS, Cuda, source
from training.backends.fused import Fused
from training.backends.plain import Plain

COMPILER = shutil.which("g++")


@pytest.fixture(scope="module")
def emulated(tmp_path_factory):
    """Makes a backend whose kernels run on the CPU."""
    if COMPILER is None:
        pytest.skip("needs g++ to compile the kernels for the CPU")
    folder = tmp_path_factory.mktemp("cuda")
    (folder / "att_snn.cu").write_text(source())
    made = {}

    class Emulated:
        def __init__(self, *sizes):
            if sizes not in made:
                out = folder / f"{'-'.join(map(str, sizes))}.so"
                macros = [f"-D{k}={v}" for k, v in zip(("H0", "H1", "OUTPUTS"), sizes, strict=True)]
                code = Path(__file__).parent / "cuda_on_cpu.cpp"
                command = [COMPILER, "-std=c++20", "-O1", "-shared", "-fPIC", "-pthread", "-w", "-DINPUTS=6"]
                subprocess.run([*command, f"-I{folder}", *macros, str(code), "-o", str(out)], check=True)
                made[sizes] = ctypes.CDLL(str(out))
            self.library = made[sizes]

        def call(self, name, steps, n, *tensors):
            assert all(each.is_contiguous() for each in tensors)
            pointers = (ctypes.c_void_p * len(tensors))(*(each.data_ptr() for each in tensors))
            getattr(self.library, name)(steps, n, pointers)

        def forward_window(self, *args):
            self.call("forward", *args)

        def backward_outputs(self, *args):
            self.call("outputs", *args)

        def backward_window(self, *args):
            self.call("backward", *args)

    return lambda: Cuda(kernels=Emulated)


def network(encoding, hidden, outputs, dtype=torch.float32, seed=0, after_spike=True):
    """Weights on the chip's grid of a network that spikes, and that gradients are wanted of."""
    rng = np.random.default_rng(seed)

    def tensor(values, rounded):
        return rounded(torch.tensor(values, dtype=torch.float32)).to(dtype).requires_grad_()

    sizes = {
        "w_in": (encoding, 6),
        "w_ff": (hidden, encoding),
        "w_rec": (hidden, hidden),
        "w_out": (outputs, hidden),
        "w_after": (hidden, int(after_spike)),
    }
    scale = {"w_in": 0.25, "w_ff": 0.25, "w_rec": 0.12, "w_out": 0.25, "w_after": 0.1}
    drawn = {k: rng.normal(0, scale[k], shape).clip(-0.9, 0.9) for k, shape in sizes.items()}
    for k, every in (("w_ff", 3), ("w_rec", 4)):  # some neurons have weights of finer steps
        drawn[k] *= np.exp2(-2.0 * (np.arange(hidden) % every))[:, None]
    matrices = (
        tensor(values, lambda w, finest=-6 if k in EXPONENTS else 0: quantise_weights(w, finest))
        if values.size
        else torch.zeros(values.shape)
        for k, values in drawn.items()
    )
    taus = (
        tensor(rng.uniform(0.3, 0.97, size), quantise_decay)
        for size in (encoding, encoding, hidden, hidden, 1, 1, hidden * after_spike)
    )
    return Weights(*matrices, *taus)


def window(n, steps, seed=1):
    x = np.random.default_rng(seed).normal(size=(n, steps, 6)).round(2)
    return torch.tensor(np.round(x * 1024) / 1024)


def gradients(backend, x, weights):
    out, rates = backend.forward(x, weights)
    (out * torch.linspace(-1, 1, out.numel(), dtype=out.dtype).view_as(out)).sum().add(
        30 * rates.sum()
    ).backward()
    return out.detach(), rates.detach(), [w.grad for w in weights]


@pytest.mark.parametrize(("sizes", "after_spike"), [((20, 33, 3), True), ((40, 12, 2), False)])
def test_outputs_spikes_and_rates_are_those_of_the_compiled_backend(emulated, sizes, after_spike):
    x, backend, fused = window(11, 16), emulated(), Fused()
    weights = network(*sizes, after_spike=after_spike)
    (out, rates), (expected, of_fused) = backend.forward(x, weights), fused.forward(x, weights)
    assert torch.equal(out, expected)
    torch.testing.assert_close(rates, of_fused)
    for ours, theirs in zip(backend.spikes(), fused.spikes(), strict=True):
        assert theirs.mean() > 0.02
        np.testing.assert_array_equal(ours, theirs)
    for ours, theirs in zip(backend.peak_currents(), fused.peak_currents(), strict=True):
        assert (ours[: theirs.size] >= theirs - 1e-6).all()


@pytest.mark.parametrize("sizes", [(20, 33, 3), (40, 12, 2)])
def test_gradients_equal_those_of_plain_pytorch_in_double_precision(emulated, sizes):
    x = window(11, 16)
    _, _, found = gradients(emulated(), x, network(*sizes))
    _, _, expected = gradients(Plain(), x, network(*sizes, dtype=torch.float64))
    for name, ours, theirs in zip(Weights._fields, found, expected, strict=True):
        assert torch.linalg.norm(theirs) > 0, name
        difference = torch.linalg.norm(ours.double() - theirs) / torch.linalg.norm(theirs)
        assert difference < 1e-5, name


def test_weights_in_shared_memory_give_the_same_gradients(emulated):
    x = window(8, 4)
    _, _, found = gradients(emulated(), x, network(16, 140, 2))
    _, _, expected = gradients(Fused(), x, network(16, 140, 2))
    for name, ours, theirs in zip(Weights._fields, found, expected, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-4 * float(theirs.abs().max()), msg=name)


def test_a_window_continues_from_the_last_one_but_where_it_is_reset(emulated):
    backend, fused, weights = emulated(), Fused(), network(20, 33, 3)
    reset = np.arange(11) % 3 == 0
    for seed in (1, 2, 3):
        x = window(11, 10, seed)
        outs = [each.forward(x, weights, None if seed == 1 else reset)[0] for each in (backend, fused)]
        assert torch.equal(*outs)


def test_a_network_of_some_of_the_neurons_continues_too(emulated):
    backend, fused, weights = emulated(), Fused(), network(20, 33, 3)
    for each in (backend, fused):
        each.forward(window(11, 10), weights)
    encoding, hidden = np.array([0, 3, 4, 11]), np.array([1, 2, 30])
    few = Weights(
        weights.w_in[encoding], weights.w_ff[hidden][:, encoding], weights.w_rec[hidden][:, hidden],
        weights.w_out[:, hidden], weights.w_after[hidden], weights.syn0[encoding], weights.mem0[encoding],
        weights.syn1[hidden], weights.mem1[hidden], weights.syn2, weights.mem2, weights.syn_after[hidden],
    )  # fmt: skip
    going_on = np.zeros(11, bool)
    smaller = [
        each.connected(encoding, hidden).forward(window(11, 10, 5), few, going_on)[0]
        for each in (backend, fused)
    ]
    assert torch.equal(*smaller)


def test_what_the_gpu_cannot_do_is_one_clear_line(emulated):
    assert BACKENDS["cuda"] is Cuda
    with pytest.raises(ValueError, match="quantised networks with a recurrent delay of 1; choose fused"):
        Cuda(quantised=False)
    with pytest.raises(ValueError, match="quantised networks with a recurrent delay of 1; choose fused"):
        Cuda(recurrent_delay=2)
    with pytest.raises(ValueError, match=f"at most {MOST_NEURONS} fit"):
        emulated().forward(window(8, 2), network(8, MOST_NEURONS + 1, 2))
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match=r"backend cuda.*(CuPy|GPU)"):
            Cuda()
