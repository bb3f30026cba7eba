"""Estimators by name: make one with its parameters."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.config.ranges import SAMPLE_RATE
from quadsim.config.toml import nearest
from quadsim.estimator import AttitudeEstimator
from quadsim.imu.spec import ImuSpec, load_imu
from quadsim.vehicle import Vehicle, load_vehicle

from .custom import declared, is_custom, own
from .filters import ekf
from .filters.algorithm import Algorithm, Filter, Parameter, checked
from .filters.complementary import ADAPTIVE, COMPLEMENTARY
from .filters.drag.ekf_drag import EKF_DRAG, drag_of
from .filters.drag.imm import IMM, InteractingModels
from .filters.ekf import EKF
from .filters.eskf import ESKF
from .filters.madgwick import MADGWICK
from .filters.mahony import MAHONY
from .networks.weights_file import END, load_network, shipped_controllers, shipped_names
from .truth import Truth
from .tuned import tuned_for

Array = NDArray[np.float64]

COMPILED: dict[str, Algorithm] = {
    a.name: a for a in (COMPLEMENTARY, ADAPTIVE, MAHONY, MADGWICK, EKF, ESKF, EKF_DRAG, IMM)
}
FILTERPY = ("ekf-filterpy", "ukf-filterpy")
COPIES = {"ekf-filterpy": "ekf"}
"""Estimators that repeat another's numbers, to compare with: no table ranks them beside it."""
NETWORKS = ("att-rnn", "att-snn", "att-snn-loihi")
DESCRIPTIONS = {
    "truth": "The true attitude: the bound that no estimator passes.",
    "complementary": "Complementary filter with a fixed gain.",
    "complementary-adaptive": "Complementary filter that trusts the accelerometer less in motion.",
    "mahony": "Mahony's nonlinear complementary filter, with gyroscope bias.",
    "madgwick": "Madgwick's gradient descent, with gyroscope bias.",
    "ekf": "Extended Kalman filter of roll, pitch and gyroscope bias.",
    "eskf": "Error-state Kalman filter that adapts to motion.",
    "ekf-drag": "Extended Kalman filter with the airframe's drag; needs a vehicle.",
    "imm": "Interacting multiple models: filters for several airframes and motions at once.",
    "ekf-filterpy": "The same extended Kalman filter by filterpy, to compare with.",
    "ukf-filterpy": "Unscented Kalman filter by filterpy; slow.",
    "vqf": "VQF (Laidig & Seel 2023), six axes.",
    "att-rnn": "Two GRU layers: the spiking network's twin.",
    "att-snn": "Spiking network for any six-axis IMU.",
    "att-snn-loihi": "The same network on the emulated chip, bit for bit.",
}
"""A sentence on each estimator."""
DEFAULT_RATE_HZ = 200.0
"""Sample rate to which the untuned defaults belong."""


def names() -> list[str]:
    """Every name that `create` knows."""
    return ["truth", *COMPILED, *FILTERPY, "vqf", *NETWORKS]


def parameters(name: str) -> Mapping[str, Parameter]:
    """Numeric parameters of an estimator, with their defaults and the range in which tuning looks for them.

    Those of your own estimator are what its class declares as `parameters`.

    Raises:
        ValueError: For an unknown name.
    """
    if is_custom(name):
        return declared(name)
    _known(name)
    if name in COMPILED:
        return COMPILED[name].parameters
    if name in FILTERPY:
        return ekf.PARAMETERS
    if name == "vqf":
        from .filters.packaged import PARAMETERS

        return PARAMETERS
    return {}


def is_weights(name: str) -> bool:
    """Whether a name is that of a network's weights: a path, or a name under which some ship."""
    return name.endswith(".safetensors") or (name in shipped_names() and name not in NETWORKS)


def create(
    name: str,
    rate_hz: float = 200.0,
    *,
    tuning: str | Path | None = None,
    vehicle: str | Path | Vehicle | None = None,
    imu: str | Path | ImuSpec | None = None,
    **params: float | str | Path | None,
) -> AttitudeEstimator:
    """Make an estimator.

    Args:
        name: One of `names()`, a network's weights, by the path of a .safetensors file or by a name under
            which some ship, such as "att-snn-hummingbird"; or your own estimator: "module:Class",
            "path/file.py:Class" or an entry point of the group "quadsim.estimators". It is made with
            `rate_hz`, and with the parameters that its class declares as keywords.
        rate_hz: Samples per second.
        tuning: Where parameters come from that are not given: a shipped domain or a TOML file made by
            `quadsim tune`; None for the shipped domain of the vehicle and the IMU.
        vehicle: The airframe, by its name, file or model: shipped parameters are those tuned for it, where
            there are such, and ekf-drag takes its drag from there. The others need none.
        imu: The IMU, by its name, file or model.
        params: The filter's own parameters; for a network `weights`.

    Raises:
        ValueError: For an unknown name or parameter, naming the valid ones, and for values out of range.
    """
    if is_weights(name):
        from .networks.weights_file import load_network

        return _network(load_network(name)[0].model, rate_hz, params | {"weights": name})
    if is_custom(name):
        spec, parts = declared(name), loaded(vehicle, imu)
        return own(
            name,
            rate_hz,
            _values(name, rate_hz, params, tuning, *parts) if spec else checked(name, {}, params),
        )
    _known(name)
    SAMPLE_RATE.of("rate_hz", rate_hz)
    if name == "truth":
        checked(name, {}, params)
        return Truth(rate_hz)
    if name in NETWORKS:
        return _network(name, rate_hz, params)
    airframe, sensor = loaded(vehicle, imu)
    known = airframe_constants(name, airframe)
    values = _values(name, rate_hz, known | params, tuning, airframe, sensor)
    if name in FILTERPY:
        from .filters.packaged import FilterpyFilter

        return FilterpyFilter("ekf" if name == "ekf-filterpy" else "ukf", rate_hz, **values)
    if name == "vqf":
        from .filters.packaged import VqfFilter

        return VqfFilter(rate_hz, values)
    made = InteractingModels if name == IMM.name else Filter
    return made(COMPILED[name], rate_hz, values)


def loaded(
    vehicle: str | Path | Vehicle | None, imu: str | Path | ImuSpec | None
) -> tuple[Vehicle | None, ImuSpec | None]:
    """A vehicle and an IMU, each given by its name, file or model.

    Raises:
        ValueError: There is no such one, or what was given is neither.
    """
    for key, value, model in (("vehicle", vehicle, Vehicle), ("imu", imu, ImuSpec)):
        if not isinstance(value, str | Path | model | None):
            raise ValueError(f"{key} = {value!r}: should be a name, the path of a TOML file, or the model")
    return (
        load_vehicle(vehicle) if isinstance(vehicle, str | Path) else vehicle,
        load_imu(imu) if isinstance(imu, str | Path) else imu,
    )


def tuning_misfit(
    name: str, tuning: str | Path | None, vehicle: str | Path | Vehicle, imu: str | Path | ImuSpec
) -> str:
    """In words, what an estimator's parameters were tuned for and does not fly; empty where all is as tuned.

    Args:
        name: Estimator.
        tuning: As in `create`.
        vehicle: The simulated vehicle, as in `create`.
        imu: What it carries, as in `create`.
    """
    airframe, sensor = loaded(vehicle, imu)
    if not (name in names() or is_custom(name)) or not parameters(name) or airframe is None or sensor is None:
        return ""
    tuned = tuned_for(name, tuning, airframe, sensor)
    if tuned is None:
        return ""
    others = [f"the {tuned.vehicle}" * bool(tuned.vehicle and tuned.vehicle != airframe.name)]
    others += [f"the IMU {tuned.imu}" * bool(tuned.imu and load_imu(tuned.imu) != sensor)]
    return " and ".join(filter(None, others))


def training_misfit(name: str, vehicle: str | Path | Vehicle) -> str:
    """In words, the airframes that a network was trained on, where that which flies is none of them.

    Empty where it is, or where the weights do not say; a name may be a controller's, too.

    Args:
        name: Of an estimator or a controller, as `create` and `create_controller` take it.
        vehicle: The simulated vehicle, as in `create`.
    """
    network = name.removesuffix("-loihi")
    if network not in (*shipped_names(), *shipped_controllers()) and not network.endswith(END):
        return ""
    try:
        trained, (airframe, _) = load_network(network)[0].training.get("vehicles"), loaded(vehicle, None)
    except (OSError, ValueError):  # it cannot fly, which its flight reports
        return ""
    if not isinstance(trained, list) or not trained or airframe is None or airframe.name in trained:
        return ""
    return ", ".join(f"the {each}" for each in trained)


def tuned_elsewhere(
    estimators: Iterable[str],
    tuning: str | Path | None,
    vehicle: str | Path | Vehicle | None,
    imu: str | Path | ImuSpec | None,
) -> list[str]:
    """A sentence for each other vehicle or IMU that parameters were tuned for; none where that is not known.

    Args:
        estimators: Names of estimators.
        tuning: As in `create`.
        vehicle: The simulated vehicle, as in `create`.
        imu: Its IMU, as in `create`.
    """
    found: dict[str, list[str]] = {}
    if vehicle is not None and imu is not None:
        for name in estimators:
            if other := tuning_misfit(name, tuning, vehicle, imu):
                found.setdefault(other, []).append(name)
    return [f"Tuned for {other}, not for what flew: {', '.join(who)}." for other, who in found.items()]


def parameter_sets(params: Mapping[str, ArrayLike]) -> list[dict[str, float]]:
    """Columns (p,) as p dictionaries.

    Raises:
        ValueError: If the columns differ in length.
    """
    if not params:
        return [{}]
    columns = [np.atleast_1d(np.asarray(column, dtype=np.float64)) for column in params.values()]
    if len({column.shape for column in columns}) > 1 or columns[0].ndim != 1:
        shapes = ", ".join(f"{key} {column.shape}" for key, column in zip(params, columns, strict=True))
        raise ValueError(f"all parameters must have one shape (p,): {shapes}")
    return [dict(zip(params, map(float, row), strict=True)) for row in zip(*columns, strict=True)]


def parameter_matrix(
    name: str, params: Mapping[str, ArrayLike], rate_hz: float, known: Mapping[str, float] | None = None
) -> Array:
    """All parameters of p sets of a compiled filter, (p, k): given, else known, else tuned or default."""
    sets = parameter_sets(params)
    return np.array([list(_values(name, rate_hz, dict(known or {}) | each, None).values()) for each in sets])


def _known(name: str) -> None:
    if name not in names():
        known = dict.fromkeys([*names(), *shipped_names()])
        raise ValueError(f'unknown estimator "{name}"; {nearest(name, known)}')


def _values(
    name: str,
    rate_hz: float,
    params: Mapping[str, object],
    tuning: str | Path | None,
    vehicle: Vehicle | None = None,
    imu: ImuSpec | None = None,
) -> dict[str, float]:
    """Every parameter of a filter, in order: what is given, else tuned, else the default."""
    spec = parameters(name)
    given = checked(name, spec, params)
    tuned = tuned_for(name, tuning, vehicle, imu)
    found = {} if tuned is None else checked(f"{tuning or 'tuning'}: {name}", spec, tuned.values)
    tuned_rate = DEFAULT_RATE_HZ if tuned is None else tuned.rate_hz
    values = {
        key: given.get(key, each.carried(found.get(key, each.default), tuned_rate / rate_hz))
        for key, each in spec.items()
    }
    if missing := [key for key, value in values.items() if math.isnan(value)]:
        raise ValueError(
            f"{name} needs a vehicle, for its drag: give vehicle=, a shipped name or a "
            f"TOML file, or {' and '.join(missing)}"
        )
    return values


def airframe_constants(name: str, vehicle: str | Path | Vehicle | None) -> dict[str, float]:
    """Parameters of an estimator that are known of a vehicle, given by its name, file or model.

    Raises:
        ValueError: No such vehicle, or a file that is not one.
    """
    airframe, _ = loaded(vehicle, None)
    return {} if name != "ekf-drag" or airframe is None else drag_of(airframe)


def needs_vehicle(name: str) -> bool:
    """Whether an estimator has parameters that only a vehicle gives."""
    return any(math.isnan(each.default) for each in parameters(name).values())


def _network(name: str, rate_hz: float, params: Mapping[str, object]) -> AttitudeEstimator:
    from .networks.network import create_network  # imports torch, which no other estimator needs

    for key in params:
        if key != "weights":
            raise ValueError(f'{name} has no parameter "{key}"; {nearest(key, ["weights"])}')
    weights = params.get("weights")
    if not isinstance(weights, str | Path | None):
        raise ValueError(f"{name}: weights = {weights!r} is not a path")
    return create_network(name, rate_hz, weights=weights)
