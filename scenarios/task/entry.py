"""An entry of a task: its card, what it got, and the file that says so."""

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
"""Where the filters of other packages that ship are made."""
TAKE_ROTOR_SPEEDS = ("imm",)
"""Estimators that ship and use them; every other filter accepts them and does not."""


@dataclass(frozen=True)
class Card:
    """What an entry is, and what it is given."""

    name: str
    """In the table: a shipped name, the name of a class, or of a file of weights."""
    source: str
    """As `--estimator` was given it."""
    about: str
    """The first line of its class's docstring."""
    rate_hz: float
    """Samples per second."""
    given: tuple[str, ...]
    """Beside the IMU: airframe, initial attitude, rotor_vel, mag; the tracks follow these."""
    parameter_count: int
    """Numbers that were learnt or tuned: a class says `parameter_count`, else those that it declares."""
    operations: float | None
    """Operations per sample: stated by the class in `operations`, or else counted in its Python source."""
    packages: dict[str, str]
    """Installed packages that its file imports, and their versions."""

    @property
    def compiled(self) -> bool:
        """Whether what it computes is, or may be, in a package that is not of Python source."""
        shipped = SHIPPED.get(self.source)
        return bool(self.packages) or (shipped is not None and shipped.made_by.startswith(PACKAGED))

    @property
    def track(self) -> str:
        """What it was given, in words."""
        return " + ".join(["IMU", *self.given])

    @property
    def knowledge(self) -> tuple[Knowledge, ...]:
        """What it is given beside readings."""
        return tuple(each for each in get_args(Knowledge) if each in self.given)


@dataclass(frozen=True)
class Cost:
    """What a sample of one vehicle costs."""

    ns: float
    """Time in Python, median over samples [ns]."""
    footprint: int
    """State and parameters [bytes], as NeuroBench's footprint: numbers in arrays that the instance holds."""
    operations: float | None
    """Of a network on the chip synaptic events (NeuroBench: effective accumulates); else operations on
    numbers; None where they are not known."""
    nanojoules: float | None
    """Modelled energy [nJ]."""
    model: str
    """How operations and energy were found."""


@dataclass(frozen=True)
class PartScore:
    """One part without a loop."""

    values: dict[str, float] = field(default_factory=dict)
    """RMS of the inclination error of each flight or trial [deg]."""
    note: str = ""
    """Why there is no mean."""
    flaw: str = ""
    """Why the entry must not be ranked."""

    @property
    def errors(self) -> Summary | None:
        """The errors, where they have a mean."""
        return Summary(np.array(list(self.values.values()))) if self.values and not self.note else None


@dataclass(frozen=True)
class LoopFlight:
    """A flight in closed loop."""

    scenario: str
    seed: int
    cause: str
    """Of the crash; empty without one."""
    flown_s: float
    error_deg: float | None


@dataclass(frozen=True)
class Entry:
    """A file entry.json."""

    version: str
    """Of the task."""
    task: str
    """Digest of what the task says."""
    code: str
    """Digest of the code that flew and scored."""
    entry: str
    """Digest of the entry's own files."""
    data: dict[str, str]
    """Digests of the parts' data."""
    card: Card
    cost: Cost | None
    parts: dict[str, PartScore]
    flights: tuple[LoopFlight, ...]
    """Of the closed loop; none where it was not flown."""
    reasons: tuple[str, ...]
    """Why it is not ranked, each to follow its name; empty if it is."""


ENTRY = TypeAdapter(Entry)
"""Writes an entry as JSON, and reads it."""


def card_of(source: str, rate_hz: float) -> Card:
    """The card of an estimator, by its name, file or class.

    Raises:
        ValueError: No such class, or its `given` holds something that cannot be given.
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
    """Digest of an entry's own files; of what ships its name: the code's digest has the rest."""
    files = [Path(source)] if source.endswith(".safetensors") else own_sources(source)
    return fingerprint(Path(source).name, [content_digest(file.read_bytes()) for file in files])


def load_entry(path: Path) -> Entry:
    """An entry from its file.

    Raises:
        ValueError: It is not one.
    """
    try:
        return ENTRY.validate_json(path.read_bytes())
    except ValidationError as error:
        raise ValueError(f"{path}: not an entry of a task; run it again") from error


def is_network(source: str) -> bool:
    """Whether an estimator is a network, one that ships or a file of weights."""
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
