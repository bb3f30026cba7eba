"""Exported networks cross-compiled for Cortex-M and run by QEMU: outputs, instructions, flash and RAM."""

import shutil
import subprocess
import sys
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pages import Part, Row, Values, confirmed
from simulated import simulated

from estimators import create
from estimators.circuit.file import is_circuit
from estimators.control.controller import create_controller
from estimators.evaluation.flights import load_flights
from estimators.export.formats import export_weights
from estimators.networks.weights_file import load_network, shipped_controllers, shipped_names
from quadsim.vehicle import GRAVITY

Array = NDArray[np.float64]
DATA = Path(__file__).parents[1] / "tests" / "data" / "cortex"
TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
"""In Debian's packages gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm."""
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
MOST = 4096
"""Samples that the program has memory for."""
ICOUNT_SHIFT = 6
"""An instruction takes 2^6 ns of the emulated clock."""
TICK_NS = 40
"""Of the system timer: the boards run at 25 MHz."""
STEPS = 2000
"""Samples of a flight that run for the page: 10 s."""
CLOCK_HZ, RATE_HZ = 168e6, 500.0
"""Of the Crazyflie's processor, and of its attitude loop."""


class Core(NamedTuple):
    """A processor and the board on which it is emulated."""

    name: str
    flags: tuple[str, ...]  #: of the compiler
    machine: str  #: of QEMU


THUMB = ("-mthumb", "-mfloat-abi=hard")
CORES = (
    Core("Cortex-M4F", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", *THUMB), "mps2-an386"),
    Core("Cortex-M7", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", *THUMB), "mps2-an500"),
)


class Size(NamedTuple):
    """What a network takes of a microcontroller [bytes]."""

    flash: int  #: code and constants, without the compiler's own library
    ram: int  #: state of one copy
    stack: int  #: most that one of its functions has on the stack, without those that it calls


class ProgramRun(NamedTuple):
    """What a program did."""

    outputs: Array  #: (T, outputs): of a controller the action, of an estimator what it writes
    instructions: NDArray[np.int64]  #: for each sample of scaling, network and output, (T, 3)


def missing_tools() -> list[str]:
    """Programs that are needed and not there."""
    return [tool for tool in TOOLS if shutil.which(tool) is None]


def build(folder: Path, source: Path, controls: bool, core: Core) -> tuple[Path, Size]:
    """Compile the export in `source`, of a controller or not, to a program in `folder`; it and its size."""
    folder.mkdir(parents=True, exist_ok=True)
    name = "snn_control" if controls else "att_snn"
    flags = [*core.flags, *STRICT, f"-I{source}"]
    controller = ["-DCONTROLLER"] if controls else []
    network, program = folder / "network.o", folder / "program.elf"
    _run(["arm-none-eabi-gcc", *flags, "-fstack-usage", "-c", source / f"{name}.c", "-o", network])
    link = ["-nostartfiles", "-specs=nosys.specs", f"-T{DATA / 'mps2.ld'}"]
    _run(["arm-none-eabi-gcc", *flags, *controller, network, DATA / "driver.c", *link, "-o", program])
    usage = [int(line.split("\t")[1]) for line in network.with_suffix(".su").read_text().splitlines()]
    probe = folder / "state.c"
    probe.write_text(f'#include "{name}.h"\n{name}_state state;\n', encoding="utf-8")
    _run(["arm-none-eabi-gcc", *flags, "-c", probe, "-o", probe.with_suffix(".o")])
    return program, Size(_sizes(network)["text"], _sizes(probe.with_suffix(".o"))["bss"], max(usage))


def run_program(program: Path, core: Core, samples: Array) -> ProgramRun:
    """Run a program on the emulated board; an instruction takes a fixed time there, which its timer measures.

    Samples are body rate and specific force (T, 6), of a controller with the set-point before them (T, 10).
    """
    if len(samples) > MOST:
        raise ValueError(f"{len(samples)} samples, the program has memory for {MOST}")
    np.append(float(len(samples)), samples).tofile(program.parent / "samples.bin")
    semihosting = ["-semihosting-config", "enable=on,target=native", "-icount", f"shift={ICOUNT_SHIFT}"]
    board = ["qemu-system-arm", "-M", core.machine, "-nographic", *semihosting]
    _run([*board, "-kernel", program], program.parent)
    outputs = np.fromfile(program.parent / "outputs.bin").reshape(MOST, -1)
    ticks = np.fromfile(program.parent / "counts.bin", np.uint32).reshape(MOST, -1)
    instructions = np.rint(ticks * (TICK_NS / 2**ICOUNT_SHIFT)).astype(np.int64)
    return ProgramRun(outputs[: len(samples)], instructions[: len(samples)])


def _sizes(binary: Path) -> dict[str, int]:
    names, values = _run(["arm-none-eabi-size", binary]).splitlines()
    return {name: int(value) for name, value in zip(names.split()[:3], values.split()[:3], strict=True)}


def _run(command: list[Any], folder: Path | None = None) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: {done.stderr}")
    return done.stdout


# --- the page ---------------------------------------------------------------------------------------


def networks() -> list[str]:
    """The shipped networks in the chip's integers."""
    found = [name for name in shipped_names() if is_circuit(name)]
    for name in [*shipped_names(), *shipped_controllers()]:
        if name not in found:
            config, _ = load_network(name)
            if config.model == "att-snn" and config.quantised and config.recurrent_delay == 1:
                found.append(name)
    return found


def samples(data: Path) -> tuple[Array, Array]:
    """Body rate and specific force of a test flight, (STEPS, 3) each."""
    flights = load_flights([simulated("test", data)])
    return flights.gyro[0, :STEPS].astype(float), flights.accel[0, :STEPS].astype(float)


def set_points() -> Array:
    """Slow sinusoids of roll, pitch and yaw rate, and hover thrust, (STEPS, 4)."""
    t = np.arange(STEPS)[:, None] / 200.0
    return np.sin(t * [1.0, 1.3, 0.7, 0.9]) * [0.3, 0.3, 0.5, 1.0] + np.array([0.0, 0.0, 0.0, GRAVITY])


def emulated(name: str, gyro: Array, accel: Array) -> Array:
    """Outputs of the emulated chip, (STEPS, outputs)."""
    if name in shipped_controllers():
        controller = create_controller(f"{name}-loihi", 200.0)
        controller.reset(1)
        return controller.sequence(set_points()[None], gyro[None], accel[None])[0]
    est = create("att-snn-loihi", weights=name)
    found = []
    for rate, force in zip(gyro, accel, strict=True):
        out = est.update(rate[None], force[None])
        found.append(out[0] if est.up is None else est.up[0])
    return np.array(found)


def measure_on_core(name: str, core: Core, gyro: Array, accel: Array) -> tuple[Size, ProgramRun]:
    """A network on a core."""
    controls, readings = name in shipped_controllers(), [gyro, accel]
    with tempfile.TemporaryDirectory() as folder:
        export_weights(name, Path(folder) / "c", "c99")
        program, size = build(Path(folder) / "build", Path(folder) / "c", controls, core)
        return size, run_program(program, core, np.concatenate([set_points()] * controls + readings, axis=1))


def instruction_counts(data: Path) -> Iterator[Row]:
    """A row for each network and core."""
    gyro, accel = samples(data)
    for name in networks():
        ours = emulated(name, gyro, accel)
        for core in CORES:
            size, done = measure_on_core(name, core, gyro, accel)
            claim = f"{name} on {core.name}: outputs that differ from the emulator's"
            wrong = confirmed(claim, int((done.outputs != ours).sum()))
            total = done.instructions.sum(axis=1)
            sizes = f"{size.flash / 1024:.1f}", f"{(size.ram + size.stack) / 1024:.1f}"
            steps = [f"{int(each):,}".replace(",", " ") for each in (np.median(total), total.max())]
            share = f"{100 * np.median(total) * RATE_HZ / CLOCK_HZ:.1f} %"
            yield f"`{name}`", core.name, *steps, share, *sizes, f"{wrong} of {ours.size}"


def microcontrollers(part: Part, given: Namespace) -> Values:
    """Compile and run the shipped networks."""
    if missing := missing_tools():
        sys.exit(
            f"{', '.join(missing)}: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
        )
    return {"counts": list(instruction_counts(given.data)), "steps": str(STEPS)}
