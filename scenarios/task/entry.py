"""An entry of a task: card, costs, results, and file."""

from dataclasses import dataclass, field
from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError

from estimators.circuit.file import is_circuit, load_circuit
from estimators.circuit.parameters import LEARNT
from estimators.custom import GROUP, is_custom, own_sources
from estimators.metrics import Summary
from estimators.networks.weights_file import load_network, shipped_names
from estimators.registry import NETWORKS, SHIPPED, is_weights, needs_vehicle, parameters
from quadsim.config.toml import nearest
from quadsim.estimator import OTHERS, accepted_sensors
from quadsim.own import load_own
from quadsim.runs.fingerprint import content_digest, fingerprint, read_source

from ..bench.experiment import Knowledge

FILE = "entry.json"
PACKAGED = "filters.packaged:"
"""Module of the shipped filters from other packages."""
TAKE_ROTOR_SPEEDS = ("imm",)
"""Shipped estimators that use rotor speeds; other filters accept but ignore them."""


@dataclass(frozen=True)
class Card:
    """Description of an entry."""

    name: str
    """Name in the table: a shipped name, or the name of a class or a weights file."""
    source: str
    """Value of `--estimator`."""
    about: str
    """First line of the class's docstring."""
    rate_hz: float
    """Samples per second."""
    given: tuple[str, ...]
    """Inputs other than the IMU, which determine the track: airframe, initial attitude, rotor_vel, mag."""
    parameter_count: int
    """Number of trained or tuned parameters: the class's `parameter_count`, or the number of declared
    parameters."""
    operations: float | None
    """Operations per sample: the class's `operations`, or the number counted in its Python source."""
    packages: dict[str, str]
    """Installed packages that the entry imports, with versions."""

    @property
    def compiled(self) -> bool:
        """Whether the entry may compute in compiled packages."""
        shipped = SHIPPED.get(self.source)
        return bool(self.packages) or (shipped is not None and shipped.made_by.startswith(PACKAGED))

    @property
    def track(self) -> str:
        """The inputs, in words."""
        return " + ".join(["IMU", *self.given])

    @property
    def knowledge(self) -> tuple[Knowledge, ...]:
        """The inputs other than readings."""
        return tuple(each for each in get_args(Knowledge) if each in self.given)


@dataclass(frozen=True)
class SampleCost:
    """Cost of a sample of one vehicle."""

    ns: float
    """Median time per sample in Python [ns]."""
    footprint: int
    """Size of state and parameters in arrays of the instance, as in NeuroBench's footprint [bytes]."""
    operations: float | None
    """Operations per sample: synaptic events for a network on the chip (NeuroBench: effective accumulates),
    otherwise arithmetic operations; None if unknown."""
    nanojoules: float | None
    """Modelled energy per sample [nJ]."""
    model: str
    """Method by which operations and energy were determined."""


@dataclass(frozen=True)
class PartScore:
    """Score on one part of the recorded data."""

    values: dict[str, float] = field(default_factory=dict)
    """RMS inclination error of each flight or trial [deg]."""
    note: str = ""
    """Why there is no mean; empty if there is one."""
    flaw: str = ""
    """Why the entry must not be ranked; empty if it may be."""

    @property
    def errors(self) -> Summary | None:
        """The errors, if they have a mean."""
        return Summary(np.array(list(self.values.values()))) if self.values and not self.note else None


@dataclass(frozen=True)
class LoopFlight:
    """A flight in closed loop."""

    scenario: str
    seed: int
    cause: str
    """Cause of a crash; empty without one."""
    flown_s: float
    error_deg: float | None


@dataclass(frozen=True)
class Entry:
    """Content of a file entry.json."""

    version: str
    """Version of the task."""
    task: str
    """Digest of the task."""
    code: str
    """Digest of the code of flights and scores."""
    entry: str
    """Digest of the entry's files."""
    data: dict[str, str]
    """Digests of the parts' data."""
    card: Card
    cost: SampleCost | None
    parts: dict[str, PartScore]
    flights: tuple[LoopFlight, ...]
    """Flights in closed loop; empty if it was not flown."""
    reasons: tuple[str, ...]
    """Why the entry is not ranked, as ends of sentences after its name; empty if it is ranked."""


ENTRY = TypeAdapter(Entry)
"""Converts an entry to JSON and back."""


def card_of(source: str, rate_hz: float) -> Card:
    """Make the card of an estimator, given by name, file or class.

    Raises:
        ValueError: The class does not exist, or its `given` has an invalid item.
    """
    made: Any = load_own(source, GROUP) if is_custom(source) else None
    if made is None:
        given = ["airframe"] if not is_weights(source) and needs_vehicle(source) else []
        sensors = ["rotor_vel"] if source in TAKE_ROTOR_SPEEDS else []
        about, count = "", _numbers(source)
    else:
        given = list(getattr(made, "given", ()))
        for each in given:
            if each not in get_args(Knowledge):
                raise ValueError(f'{source}: given = "{each}"; {nearest(each, get_args(Knowledge))}')
        sensors = list(accepted_sensors(getattr(made, "update", lambda gyro, accel: None)))
        about = (made.__doc__ or "").strip().split("\n")[0]
        count = int(getattr(made, "parameter_count", len(parameters(source))))
    order = [*get_args(Knowledge), *OTHERS]
    operations = getattr(made, "operations", None)
    return Card(
        name=Path(source.rpartition(":")[2]).name.removesuffix(".safetensors"),
        source=source,
        about=about,
        rate_hz=rate_hz,
        given=tuple(sorted({*given, *sensors}, key=order.index)),
        parameter_count=count,
        operations=None if operations is None else float(operations),
        packages=_packages(source),
    )


def digest_of_entry(source: str) -> str:
    """Return the digest of an entry's files; for a shipped estimator, that of its name."""
    files = [Path(source)] if source.endswith(".safetensors") else own_sources(source)
    return fingerprint(Path(source).name, [content_digest(file.read_bytes()) for file in files])


def load_entry(path: Path) -> Entry:
    """Load an entry from its file.

    Raises:
        ValueError: The file is not an entry.
    """
    try:
        return ENTRY.validate_json(path.read_bytes())
    except ValidationError as error:
        raise ValueError(f"{path}: not an entry of a task; run it again") from error


def is_network(source: str) -> bool:
    """Return whether an estimator is a network, shipped or a weights file."""
    return source in (*NETWORKS, *shipped_names()) or is_weights(source)


def _numbers(source: str) -> int:
    """Numbers that an estimator without a class of the user's has learnt, or that were tuned."""
    if not is_network(source):
        return len(parameters(source))
    if is_circuit(source):
        learnt = load_circuit(source).parameters._asdict()
        return sum(int(np.size(learnt[name])) for name in LEARNT)
    return sum(int(np.size(each)) for each in load_network(source)[1].values())


def _packages(source: str) -> dict[str, str]:
    """Installed packages that an entry's files import, with their versions."""
    installed = packages_distributions()
    statements = [
        each for file in own_sources(source) for each in read_source(file.read_text("utf-8")).imports
    ]
    imported = {parts[0].partition(".")[0] for level, parts in statements if level == 0 and parts}
    names = {installed[each][0] for each in imported if each in installed} - {"quadsim", "numpy"}
    return {name: version(name) for name in sorted(names)}
