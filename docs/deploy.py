"""Networks on microcontrollers, compiled and emulated.

It needs Debian's gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm.
"""

import sys
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from cortex import CORES, Core, Run, Size, build, missing_tools, run
from numpy.typing import NDArray
from pages import Part, Values, confirmed, row
from simulated import simulated

from estimators import create
from estimators.circuit.file import is_circuit
from estimators.control.controller import create_controller
from estimators.evaluation.flights import load_flights
from estimators.export.formats import export_weights
from estimators.networks.weights_file import load_network, shipped_controllers, shipped_names
from quadsim.vehicle import GRAVITY

Array = NDArray[np.float64]
STEPS = 2000
"""Samples of a flight that run: 10 s."""
CLOCK_HZ, RATE_HZ = 168e6, 500.0
"""Of the Crazyflie's processor, and of its attitude loop."""


def networks() -> list[str]:
    """The shipped networks in the chip's integers."""
    return [name for name in [*shipped_names(), *shipped_controllers()] if _on_chip(name)]


def _on_chip(name: str) -> bool:
    if is_circuit(name):
        return True
    config, _ = load_network(name)
    return config.model == "att-snn" and config.quantised and config.recurrent_delay == 1


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


def measured(name: str, core: Core, gyro: Array, accel: Array) -> tuple[Size, Run]:
    """A network on a core."""
    controls, readings = name in shipped_controllers(), [gyro, accel]
    with tempfile.TemporaryDirectory() as folder:
        export_weights(name, Path(folder) / "c", "c99")
        program, size = build(Path(folder) / "build", Path(folder) / "c", controls, core)
        return size, run(program, core, np.concatenate([set_points()] * controls + readings, axis=1))


def rows(data: Path) -> Iterator[str]:
    """A row for each network and core."""
    gyro, accel = samples(data)
    for name in networks():
        ours = emulated(name, gyro, accel)
        for core in CORES:
            size, done = measured(name, core, gyro, accel)
            claim = f"{name} on {core.name}: outputs that differ from the emulator's"
            wrong = confirmed(claim, int((done.outputs != ours).sum()))
            total = done.instructions.sum(axis=1)
            share = np.median(total) * RATE_HZ / CLOCK_HZ
            flash, ram = f"{size.flash / 1024:.1f}", f"{(size.ram + size.stack) / 1024:.1f}"
            counts = [f"{int(value):,}".replace(",", " ") for value in (np.median(total), total.max())]
            yield row(f"`{name}`", core.name, *counts, f"{share:.1%}", flash, ram, f"{wrong} of {ours.size}")


def values(part: Part, given: Namespace) -> Values:
    """Compile and run."""
    if missing := missing_tools():
        sys.exit(
            f"{', '.join(missing)}: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
        )
    return {"rows": list(rows(given.data)), "steps": str(STEPS)}
