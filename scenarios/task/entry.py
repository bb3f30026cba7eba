"""An entry of a task: its card, what it got, and the file that says so."""

from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import Field, ValidationError

from estimators.circuit.file import is_circuit, load_circuit
from estimators.circuit.parameters import LEARNT
from estimators.custom import GROUP, is_custom, own_sources
from estimators.networks.weights_file import load_network, shipped_names
from estimators.registry import NETWORKS, SHIPPED, is_weights, needs_vehicle, parameters
from quadsim.config.ranges import Between, SampleRate, Share
from quadsim.config.toml import Strict, nearest
from quadsim.estimator import OTHERS, accepted_sensors
from quadsim.own import load_own
from quadsim.runs.fingerprint import content_digest, fingerprint, read_source

from ..bench.experiment import Knowledge

Angle = Annotated[float, Between(0.0, 180.0, "°")]
Count = Annotated[int, Between(0, 2**63 - 1)]
Size = Annotated[float, Between(0.0, 1e15)]

FILE = "entry.json"
PACKAGED = "filters.packaged:"
"""Where the filters of other packages that ship are made."""
TAKE_ROTOR_SPEEDS = ("imm",)
"""Estimators that ship and use them; every other filter accepts them and does not."""


class Card(Strict):
    """What an entry is, and what it is given."""

    name: str
    """In the table: a shipped name, the name of a class, or of a file of weights."""
    source: str
    """As `--estimator` was given it."""
    about: str
    """The first line of its class's docstring."""
    rate_hz: SampleRate
    """Samples per second."""
    given: tuple[str, ...]
    """Beside the IMU: airframe, initial attitude, rotor_vel, mag; the tracks follow these."""
    parameter_count: Count
    """Numbers that were learnt or tuned: a class says `parameter_count`, else those that it declares."""
    operations: Size | None
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


class Cost(Strict):
    """What a sample of one vehicle costs."""

    ns: Size
    """Time in Python, median over samples [ns]."""
    footprint: Count
    """State and parameters [bytes], as NeuroBench's footprint: numbers in arrays that the instance holds."""
    operations: Size | None
    """Of a network on the chip synaptic events (NeuroBench: effective accumulates); else operations on
    numbers; None where they are not known."""
    nanojoules: Size | None
    """Modelled energy [nJ]."""
    model: str
    """How operations and energy were found."""


class PartScore(Strict):
    """One part without a loop."""

    values: dict[str, Angle]
    """RMS of the inclination error of each flight or trial [deg]."""
    mean: Angle | None = None
    low: Angle | None = None
    """Ends of the bootstrap 95 % interval of the mean."""
    high: Angle | None = None
    note: str = ""
    """Why there is no mean."""
    flaw: str = ""
    """Why the entry must not be ranked."""


class LoopFlight(Strict):
    """A flight in closed loop."""

    scenario: str
    seed: Count
    cause: str
    """Of the crash; empty without one."""
    flown_s: Size
    error_deg: Angle | None


class LoopScore(Strict):
    """The closed loop."""

    flights: tuple[LoopFlight, ...]
    planned: Count
    """Flights that were to be flown; those that are missing count as lost."""
    crashes: Count
    crash_low: Share
    """Ends of the 95 % Wilson interval of the share."""
    crash_high: Share
    error_deg: Angle | None
    """Mean over scenarios, of flights without a crash."""
    low: Angle | None
    high: Angle | None


class Entry(Strict):
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
    cost: Cost | None = None
    parts: dict[str, PartScore] = Field(default_factory=dict)
    loop: LoopScore | None = None
    reasons: tuple[str, ...] = ()
    """Why it is not ranked, each to follow its name; empty if it is."""


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
        return Entry.model_validate_json(path.read_bytes())
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
