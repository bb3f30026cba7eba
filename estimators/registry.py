"""Making of estimators by name, with their parameters."""

import importlib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from quadsim.config.ranges import SAMPLE_RATE
from quadsim.config.toml import nearest
from quadsim.estimator import AttitudeEstimator
from quadsim.imu.spec import ImuSpec, load_imu
from quadsim.own import load_own
from quadsim.runs.fingerprint import ASSETS
from quadsim.vehicle import Vehicle, load_vehicle

from .circuit.file import is_circuit, load_circuit
from .custom import GROUP, declared, is_custom, made_by
from .filters.parameter import Parameter, checked
from .networks.weights_file import END, load_network, shipped_controllers, shipped_names
from .tuned import tuned_for

VehicleLike = str | Path | Vehicle | None
"""An airframe by name, file or model; None if it is not known."""
ImuLike = str | Path | ImuSpec | None
"""An IMU by name, file or model; None if it is not known."""


@dataclass(frozen=True)
class RegistryEntry:
    """A table of `assets/estimators.toml`."""

    description: str
    """Description in one sentence."""
    made_by: str
    """ "module:Class" in this package, which is called with name, rate_hz and values; empty for a network."""
    parameters: Mapping[str, Parameter]


def _entry(description: str, made_by: str = "", parameters: Mapping[str, Any] | None = None) -> RegistryEntry:
    return RegistryEntry(
        description, made_by, {key: Parameter(**each) for key, each in (parameters or {}).items()}
    )


_TABLES = tomllib.loads((ASSETS / "estimators.toml").read_text("utf-8"))
SHIPPED = {name: _entry(**table) for name, table in _TABLES.items()}
"""Shipped estimators, in the order of `names()`."""
FILTERPY = ("ekf-filterpy", "ukf-filterpy")
COPIES = {"ekf-filterpy": "ekf"}
"""Estimators that give the same numbers as another one and are therefore not ranked in tables with it."""
NETWORKS = tuple(name for name, entry in SHIPPED.items() if not entry.made_by)
DEFAULT_RATE_HZ = 200.0
"""Sample rate of the default parameters."""


def names() -> list[str]:
    """Return the names of all estimators."""
    return list(SHIPPED)


def parameters(name: str) -> Mapping[str, Parameter]:
    """Return the parameters of an estimator, with their defaults and the range that tuning searches.

    For your own estimator, these are the parameters that its class declares as `parameters`.

    Raises:
        ValueError: The name is unknown.
    """
    if is_custom(name):
        return declared(name)
    return _shipped(name).parameters


def is_weights(name: str) -> bool:
    """Return whether a name is a path or a shipped name of a network's weights."""
    return name.endswith(".safetensors") or (name in shipped_names() and name not in NETWORKS)


def create(
    name: str,
    rate_hz: float = 200.0,
    *,
    tuning: str | Path | None = None,
    vehicle: VehicleLike = None,
    imu: ImuLike = None,
    **params: float | str | Path | None,
) -> AttitudeEstimator:
    """Make an estimator.

    Args:
        name: One of `names()`; the weights of a network, as the path of a .safetensors file or a shipped name
            such as "att-snn-paper"; or your own estimator, as "module:Class", "path/file.py:Class" or an
            entry point of the group "quadsim.estimators". Your class is called with `rate_hz` and with its
            declared parameters as keyword arguments. If its attribute `given` contains "airframe", it is also
            called with `vehicle=`, which may be None.
        rate_hz: Samples per second.
        tuning: Source of parameters that are not given: a shipped domain or a TOML file written by `quadsim
            tune`. None selects the shipped domain of the vehicle and the IMU.
        vehicle: The airframe, by name, file or model. It selects the tuned parameters and gives ekf-drag the
            drag. Other estimators do not need it.
        imu: The IMU, by name, file or model.
        params: Parameters of the filter, or `weights` for a network.

    Raises:
        ValueError: A name or a parameter is unknown, in which case the message lists the valid ones, or a
            value is out of range.
    """
    if not isinstance(name, str):
        raise ValueError(f"name = {name!r}: should be the name of an estimator, as in names()")
    if is_weights(name):
        model = "att-snn" if is_circuit(name) else load_network(name)[0].model
        return _network(model, rate_hz, params | {"weights": name})
    if name in NETWORKS:
        SAMPLE_RATE.of("rate_hz", rate_hz)
        return _network(name, rate_hz, params)
    airframe, sensor = loaded(vehicle, imu)
    if is_custom(name):
        made = load_own(name, GROUP)
        known = {"vehicle": airframe} if "airframe" in getattr(made, "given", ()) else {}
        values = filter_values(name, rate_hz, params, tuning, airframe, sensor)
        return made_by(name, made, rate_hz, known | values)
    module, _, maker = _shipped(name).made_by.partition(":")
    SAMPLE_RATE.of("rate_hz", rate_hz)
    known = airframe_constants(name, airframe)
    values = filter_values(name, rate_hz, known | params, tuning, airframe, sensor)
    return getattr(importlib.import_module(f".{module}", __package__), maker)(name, rate_hz, values)


def loaded(vehicle: VehicleLike, imu: ImuLike) -> tuple[Vehicle | None, ImuSpec | None]:
    """Load a vehicle and an IMU, each given by name, file or model.

    Raises:
        ValueError: The vehicle or the IMU does not exist or has another type.
    """
    for key, value, model in (("vehicle", vehicle, Vehicle), ("imu", imu, ImuSpec)):
        if not isinstance(value, str | Path | model | None):
            raise ValueError(f"{key} = {value!r}: should be a name, the path of a TOML file, or the model")
    return (
        load_vehicle(vehicle) if isinstance(vehicle, str | Path) else vehicle,
        load_imu(imu) if isinstance(imu, str | Path) else imu,
    )


def tuning_misfit(name: str, tuning: str | Path | None, vehicle: VehicleLike, imu: ImuLike) -> str:
    """Describe a mismatch between the vehicle and IMU of the tuning and those of the flights.

    The result is empty without a mismatch, and if vehicle or IMU are not known. The arguments are those of
    `create`.
    """
    airframe, sensor = loaded(vehicle, imu)
    if not (name in names() or is_custom(name)) or not parameters(name) or airframe is None or sensor is None:
        return ""
    tuned = tuned_for(name, tuning, airframe, sensor)
    others = []
    if tuned is not None and tuned.vehicle not in ("", airframe.name):
        others.append(f"the {tuned.vehicle}")
    if tuned is not None and tuned.imu and load_imu(tuned.imu) != sensor:
        others.append(f"the IMU {tuned.imu}")
    return " and ".join(others)


def training_misfit(name: str, vehicle: VehicleLike) -> str:
    """Describe the airframes of a network's training if the simulated one is not among them; else empty.

    The result is also empty if the weights do not name the airframes. The name can be that of a controller.
    """
    network = name.removesuffix("-loihi")
    if network not in (*NETWORKS, *shipped_names(), *shipped_controllers()) and not network.endswith(END):
        return ""
    try:
        config = load_circuit(network)[0] if is_circuit(network) else load_network(network)[0]
        trained, (airframe, _) = config.training.get("vehicles"), loaded(vehicle, None)
    except (OSError, ValueError):  # it cannot fly, which its flight reports
        return ""
    if not isinstance(trained, list) or not trained or airframe is None or airframe.name in trained:
        return ""
    return ", ".join(f"the {each}" for each in trained)


def tuned_elsewhere(
    estimators: Iterable[str], tuning: str | Path | None, vehicle: VehicleLike, imu: ImuLike
) -> list[str]:
    """Return a sentence for each vehicle or IMU of the tuning that differs; see `tuning_misfit`."""
    found: dict[str, list[str]] = {}
    for name in estimators:
        found.setdefault(tuning_misfit(name, tuning, vehicle, imu), []).append(name)
    return [f"Tuned for {o}, not for what flew: {', '.join(who)}." for o, who in found.items() if o]


def parameter_sets(params: Mapping[str, ArrayLike]) -> list[dict[str, float]]:
    """Convert columns (p,) to p dictionaries; raise ValueError if the lengths differ."""
    columns = [np.atleast_1d(np.asarray(column, np.float64)) for column in params.values()]
    rows = np.stack(columns, axis=1).tolist() if columns else [[]]
    return [dict(zip(params, row, strict=True)) for row in rows]


def filter_values(
    name: str,
    rate_hz: float,
    params: Mapping[str, object],
    tuning: str | Path | None = None,
    vehicle: Vehicle | None = None,
    imu: ImuSpec | None = None,
) -> dict[str, float]:
    """Return all parameters of an estimator, in order: the given, tuned or default value."""
    spec = parameters(name)
    given = checked(name, spec, params)
    if not spec:
        return given
    tuned = tuned_for(name, tuning, vehicle, imu)
    found = {} if tuned is None else checked(f"{tuning or 'tuning'}: {name}", spec, tuned.values)
    tuned_rate = DEFAULT_RATE_HZ if tuned is None else tuned.rate_hz
    values = {
        key: given.get(key, each.carried(found.get(key, each.default), tuned_rate / rate_hz))
        for key, each in spec.items()
    }
    if missing := [key for key, value in values.items() if math.isnan(value)]:
        raise ValueError(
            f"{name} needs the drag of the airframe: give vehicle= (a shipped name or a TOML file), or "
            f"{' and '.join(missing)}"
        )
    return values


def airframe_constants(name: str, vehicle: Vehicle | None) -> dict[str, float]:
    """Return the parameters of an estimator that follow from a vehicle."""
    if name != "ekf-drag" or vehicle is None:
        return {}
    from .filters.drag.ekf_drag import drag_of

    return drag_of(vehicle)


def _shipped(name: str) -> RegistryEntry:
    if name not in SHIPPED:
        known = dict.fromkeys([*names(), *shipped_names()])
        raise ValueError(f'unknown estimator "{name}"; {nearest(name, known)}')
    return SHIPPED[name]


def needs_vehicle(name: str) -> bool:
    """Return whether an estimator has parameters that only a vehicle gives."""
    return any(math.isnan(each.default) for each in parameters(name).values())


def _network(name: str, rate_hz: float, params: Mapping[str, object]) -> AttitudeEstimator:
    from .circuit.circuit_estimator import circuit_estimator
    from .networks.network import create_network

    for key in params:
        if key != "weights":
            raise ValueError(f'{name} has no parameter "{key}"; {nearest(key, ["weights"])}')
    weights = params.get("weights")
    weights = name if weights is None else weights
    if not isinstance(weights, str | Path):
        raise ValueError(f"{name}: weights = {weights!r} is not a path")
    if is_circuit(weights):
        config, circuit = load_circuit(weights)
        return circuit_estimator(name, circuit, config.steps_per_sample, rate_hz)
    return create_network(name, rate_hz, weights=weights)
