"""Checks and measurements of an entry before its runs: rules, time, size and energy."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from estimators import create
from estimators.analysis.activity import record
from estimators.analysis.circuit import measure_circuit
from estimators.analysis.energy import FLOAT_PICOJOULES, costs, counts
from estimators.checking import check_estimator
from estimators.circuit.file import is_circuit, load_circuit
from estimators.evaluation.flights import Flights
from estimators.networks.forward import OnLoihi
from estimators.networks.weights_file import load_network
from quadsim.estimator import AttitudeEstimator, receives_truth
from quadsim.own import named_errors

from .entry import Card, SampleCost, is_network
from .operations import counted_operations
from .specification import Task
from .task_data import groups

TIMED = 1000
"""Number of timed samples."""
PATIENCE_S = 120.0
"""Time limits for compilation and for all checks together [s]."""
CHIP_S = 10.0
"""Duration of the flight on which a network's operations are counted [s]."""
IN_FLOATS = "att-rnn"
"""Name of the shipped circuit in floats."""
TREE_DEPTH = 6
"""Depth to which an instance is searched for numbers."""

_watched: list[str] = []
_opened: list[str] = []
_hooked: list[bool] = []


class Examined(NamedTuple):
    """Result of the examination of an entry."""

    cost: SampleCost | None
    reasons: tuple[str, ...]
    runs: bool  #: whether it may run on the parts


def examine(task: Task, card: Card, folder: Path) -> Examined:
    """Check and measure an entry on flights of a task, whose data folder it must not open."""
    flights = next(groups(task, task.parts[0], folder)).flights
    reasons, opened, cost, passed = list[str](), list[str](), None, False
    too_long = f"took more than {PATIENCE_S:g} s for its checks"
    try:
        with watching(folder) as opened, deadline(PATIENCE_S, too_long), named_errors(card.name):
            made = create(card.source, card.rate_hz, vehicle="hummingbird")
            if receives_truth(made):
                reasons.append("received the true attitude")
            cost = cost_of(card, made, flights)
            if cost.ns > task.most_ms * 1e6:
                raise ValueError(f"{cost.ns / 1e6:.3g} ms per sample; {task.most_ms:g} ms are allowed")
            check_estimator(card.source, card.rate_hz, accurate=False)
            passed = True
    except ValueError as error:
        reasons.append(f"did not pass the checks: {error}")
    return Examined(cost, (*reasons, *opened_files(opened)), passed)


def cost_of(card: Card, made: AttitudeEstimator, flights: Flights) -> SampleCost:
    """Return the cost of a sample of one vehicle: measured, counted, or stated by the card."""
    one = flights.readings.map(lambda each: each[:1, :TIMED])
    sensors = tuple(name for name in one.others if name in card.given)
    made.reset(1, roll_pitch=None)
    taken = []
    for t in range(one.gyro.shape[1]):
        sample = one.map(lambda each, t=t: each[:, t].copy())
        if receives_truth(made):
            made.observe(flights.quat[:1, t].copy())  # pyright: ignore[reportAttributeAccessIssue]
        begin = time.perf_counter_ns()
        sample.give(made.update, sensors)
        taken.append(time.perf_counter_ns() - begin)
    operations, nanojoules, model = energy_of(card, flights)
    return SampleCost(
        ns=float(np.median(taken)),
        footprint=footprint(made),
        operations=operations,
        nanojoules=nanojoules,
        model=model,
    )


def energy_of(card: Card, flights: Flights) -> tuple[float | None, float | None, str]:
    """Return operations per sample, their modelled energy [nJ], and the method."""
    chip = "counted on the emulated chip; Davies et al. 2018"
    source = card.source
    if is_network(source) and source != IN_FLOATS:
        piece = flights.map(lambda each: each[:1, : round(CHIP_S * flights.rate_hz)])
        if is_circuit(source):
            config, parameters = load_circuit(source)
            found = measure_circuit(config, parameters, piece)
            steps = config.steps_per_sample
            return found.synaptic_events * steps, found.nanojoules * steps, chip
        config, tensors = load_network(source)
        if config.model == "att-snn":
            core = OnLoihi(config, tensors)
            counted = counts(core.cores, record(core, piece.gyro, piece.accel))
            return counted["synaptic event"], sum(each.nanojoules for each in costs(counted)), chip
    operations, how = card.operations, "as its class says"
    if operations is None and not is_network(source) and not card.compiled:
        operations, how = counted_operations(source, card.rate_hz), "counted in its Python source"
    if is_network(source):  # in floats: NeuroBench's dense synaptic operations, each a product and a sum
        operations, how = 2.0 * card.parameter_count, "two for each weight"
    if operations is None:
        return None, None, ""
    return operations, operations * FLOAT_PICOJOULES / 1e3, f"{how}; Horowitz 2014, arithmetic alone"


def footprint(made: object) -> int:
    """Return the size of all numbers of an instance, in arrays, tensors, lists and objects [bytes]."""
    seen: set[int] = set()

    def size(value: Any, depth: int) -> int:
        if id(value) in seen or depth > TREE_DEPTH:
            return 0
        seen.add(id(value))
        if isinstance(value, np.ndarray | np.generic):
            return value.nbytes
        if isinstance(value, bool | int | float):
            return 8
        if hasattr(value, "element_size"):  # a tensor of PyTorch
            return value.element_size() * value.nelement()
        if isinstance(value, dict):
            return sum(size(each, depth + 1) for each in value.values())
        if isinstance(value, list | tuple):
            return sum(size(each, depth + 1) for each in value)
        code = isinstance(value, ModuleType | type | FunctionType) or type(value).__module__.startswith(
            "numba"
        )
        parts = {} if code else getattr(value, "__dict__", None)
        return size(parts, depth) if isinstance(parts, dict) else 0

    return size(made, 0)


# --- what an entry must not do --------------------------------------------------------------------


@contextmanager
def watching(*folders: Path) -> Iterator[list[str]]:
    """Record which files below some folders are opened by Python within this context."""
    if not _hooked:
        sys.addaudithook(_audit)
        _hooked.append(True)
    _opened.clear()
    _watched[:] = [os.path.realpath(folder) + os.sep for folder in folders]
    found: list[str] = []
    try:
        yield found
    finally:
        _watched.clear()
        found += dict.fromkeys(_opened)


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _watched and isinstance(arguments[0], str | bytes):
        path = os.path.realpath(os.fsdecode(arguments[0]))
        if path.startswith(tuple(_watched)):
            _opened.append(path)


def opened_files(opened: list[str]) -> list[str]:
    """Return the reason why an entry that opened data files is not ranked."""
    return [f"opened {Path(opened[0]).name}, which holds the task's data"] if opened else []


@contextmanager
def deadline(seconds: float, why: str) -> Iterator[None]:
    """Raise a TimeoutError in this context after a time, if signals are available."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: object) -> None:
        raise TimeoutError(why)

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
