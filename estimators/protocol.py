"""Estimators by name: make one, run it over sequences, run many parameter sets at once."""

import importlib
import importlib.util
import logging
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.config import nearest
from quadsim.estimator import AttitudeEstimator
from quadsim.imu import ImuSpec, load_imu
from quadsim.ranges import SAMPLE_RATE
from quadsim.vehicle import GRAVITY, Vehicle, load_vehicle

from . import ekf
from .complementary import ADAPTIVE, COMPLEMENTARY
from .ekf import EKF
from .ekf_drag import EKF_DRAG, drag_of
from .eskf import ESKF
from .filters import Algorithm, Filter, Parameter, checked, paired, start
from .madgwick import MADGWICK
from .mahony import MAHONY
from .truth import Truth
from .tuned import misfit, tuned_for

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

COMPILED: dict[str, Algorithm] = {
    a.name: a for a in (COMPLEMENTARY, ADAPTIVE, MAHONY, MADGWICK, EKF, ESKF, EKF_DRAG)
}
FILTERPY = ("ekf-filterpy", "ukf-filterpy")
NETWORKS = ("att-rnn", "att-snn", "att-snn-loihi")
DEFAULT_RATE_HZ = 200.0
"""Sample rate to which the untuned defaults belong."""


def names() -> list[str]:
    """Every name that `create` knows."""
    return ["truth", *COMPILED, *FILTERPY, "vqf", *NETWORKS]


def parameters(name: str) -> Mapping[str, Parameter]:
    """Numeric parameters of an estimator, with their defaults and the range in which tuning looks for them.

    Raises:
        ValueError: For an unknown name.
    """
    _known(name)
    if name in COMPILED:
        return COMPILED[name].parameters
    if name in FILTERPY:
        return ekf.PARAMETERS
    if name == "vqf":
        from .vqf_filter import PARAMETERS

        return PARAMETERS
    return {}


def is_weights(name: str) -> bool:
    """Whether a name is the path of a network's weights."""
    return name.endswith(".safetensors")


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
        name: One of `names()`, the path of a network's weights, which ends in .safetensors, or
            "module:Class" of your own estimator, which is made with `rate_hz`.
        rate_hz: Samples per second.
        tuning: Where parameters come from that are not given: a shipped domain or a TOML file made by
            `quadsim tune`; None for the shipped domain of the vehicle and the IMU.
        vehicle: The airframe, by its name, file or model: shipped parameters are those tuned for it, where
            there are such, and ekf-drag takes its drag from there. The others need none.
        imu: The IMU, likewise.
        params: The filter's own parameters; for a network `weights`.

    Raises:
        ValueError: For an unknown name or parameter, naming the valid ones, and for values out of range.
    """
    if is_weights(name):
        from .weights_file import load_network

        return _network(load_network(name)[0].model, rate_hz, params | {"weights": name})
    if ":" in name:
        return own(name, rate_hz)
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
        from .filterpy_filters import FilterpyFilter

        return FilterpyFilter("ekf" if name == "ekf-filterpy" else "ukf", rate_hz, **values)
    if name == "vqf":
        from .vqf_filter import VqfFilter

        return VqfFilter(rate_hz, values)
    return Filter(COMPILED[name], rate_hz, values)


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


def own(name: str, rate_hz: float) -> AttitudeEstimator:
    """A user's estimator, "module:Class".

    Raises:
        ValueError: No such module or class, or it is no estimator.
    """
    module, _, attribute = name.partition(":")
    try:
        made = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"{name} is no module:Class: {error}") from error
    try:
        return tried(name, made(rate_hz))
    except TypeError as error:
        raise ValueError(f"{name} is made with one argument, rate_hz: {error}") from error


def tried(name: str, est: AttitudeEstimator) -> AttitudeEstimator:
    """A user's estimator, after a reset of two vehicles and an update at rest.

    Raises:
        ValueError: It is no estimator: what it lacks, or what it did.
    """
    if missing := [each for each in ("reset", "update") if not callable(getattr(est, each, None))]:
        raise ValueError(f"{name} is no estimator: it has no {' and no '.join(missing)}")
    try:
        est.reset(n=2, roll_pitch=None)
        found = np.asarray(est.update(np.zeros((2, 3)), np.tile([0.0, 0.0, GRAVITY], (2, 1))), np.float64)
    except Exception as error:  # whatever a user's class does
        raise ValueError(
            f"{name}: reset(n=2, roll_pitch=None) and update(gyro, accel), each (2, 3), end with "
            f"{type(error).__name__}: {error}"
        ) from error
    if found.shape != (2, 2):
        raise ValueError(
            f"{name}: update returns an array of shape {found.shape} for two vehicles; roll and pitch, "
            "(2, 2) [rad], are required"
        )
    return est


def own_source(name: str) -> Path | None:
    """File of the module that "module:Class" names; None for other names, and where there is none."""
    try:
        spec = importlib.util.find_spec(name.partition(":")[0]) if ":" in name else None
    except (ImportError, ValueError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None else None


def tuning_misfit(
    name: str, tuning: str | Path | None, vehicle: str | Path | Vehicle, imu: str | Path | ImuSpec
) -> str:
    """In words, what an estimator's parameters were tuned for and does not fly; empty where all is as tuned.

    Args:
        name: Estimator.
        tuning: As in `create`.
        vehicle: What is flown, as in `create`.
        imu: What it carries, as in `create`.
    """
    airframe, sensor = loaded(vehicle, imu)
    if name not in names() or not parameters(name) or airframe is None or sensor is None:
        return ""
    tuned = tuned_for(name, tuning, airframe, sensor)
    return "" if tuned is None else misfit(tuned, airframe, sensor)


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
        vehicle: What flew, as in `create`.
        imu: What it carried, as in `create`.
    """
    found: dict[str, list[str]] = {}
    if vehicle is not None and imu is not None:
        for name in estimators:
            if other := tuning_misfit(name, tuning, vehicle, imu):
                found.setdefault(other, []).append(name)
    return [f"Tuned for {other}, not for what flew: {', '.join(who)}." for other, who in found.items()]


def run(
    est: AttitudeEstimator,
    gyro: ArrayLike,
    accel: ArrayLike,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
) -> Array:
    """Reset an estimator and run it over n sequences; the same numbers as `update` in a loop.

    Args:
        est: The estimator.
        gyro: Body rate (n, T, 3) [rad/s]; NaN where a sample is missing.
        accel: Specific force in body axes (n, T, 3) [m/s²]; NaN where a sample is missing.
        roll_pitch: Attitude one sample before the first, (n, 2) [rad]; None where it is not known.
        quat: True quat_WB (n, T, 4), for an estimator that observes the truth.

    Returns:
        Roll and pitch (n, T, 2) [rad].

    Raises:
        ValueError: For shapes that do not fit, or an estimator that observes the truth and is given none.
    """
    out = run_quietly(est, gyro, accel, roll_pitch, quat)
    skipped = missing_samples(est)
    if skipped > 0:
        logger.warning(
            "%d of %d samples were missing or beyond any sensor's range; the estimator went on from its "
            "prediction",
            skipped,
            out[..., 0].size,
        )
    return out


def run_quietly(
    est: AttitudeEstimator,
    gyro: ArrayLike,
    accel: ArrayLike,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
) -> Array:
    """`run`, for a caller that reports `missing_samples` itself."""
    gyro, accel = paired(gyro, accel)
    est.reset(len(gyro), roll_pitch=roll_pitch)
    observe = getattr(est, "observe", None)
    sequence = getattr(est, "sequence", None)
    if observe is not None:
        return _run_observing(est, observe, gyro, accel, quat)
    if sequence is not None:
        return sequence(gyro, accel)
    steps = zip(np.moveaxis(gyro, 1, 0), np.moveaxis(accel, 1, 0), strict=True)
    return np.stack(
        [est.update(rate.copy(), force.copy()) for rate, force in steps], axis=1
    )  # its own to change


def missing_samples(est: AttitudeEstimator) -> int:
    """Samples of all vehicles since `reset` that were missing in part or whole."""
    return int(np.sum(getattr(est, "skipped", 0)))


def run_batch(
    name: str,
    params: Mapping[str, ArrayLike],
    gyro: ArrayLike,
    accel: ArrayLike,
    rate_hz: float = 200.0,
    roll_pitch: ArrayLike | None = None,
    vehicle: str | Path | Vehicle | None = None,
) -> Array:
    """Run p parameter sets of one estimator over n sequences.

    Args:
        name: One of `names()`.
        params: Parameter name to values (p,); the others keep their default.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force in body axes (n, T, 3) [m/s²].
        rate_hz: Samples per second.
        roll_pitch: Attitude one sample before the first, (n, 2) [rad]; None where it is not known.
        vehicle: As in `create`.

    Returns:
        Roll and pitch (p, n, T, 2) [rad].
    """
    gyro, accel = paired(gyro, accel)
    if name not in COMPILED:
        estimators = [
            create(name, rate_hz, tuning=None, vehicle=None, imu=None, **each)
            for each in parameter_sets(params)
        ]
        return np.stack([run(est, gyro, accel, roll_pitch) for est in estimators])
    matrix = parameter_matrix(name, params, rate_hz, airframe_constants(name, vehicle))
    states = start(COMPILED[name], matrix, len(gyro), roll_pitch)
    out = np.empty((len(states), gyro.shape[1], 2))
    COMPILED[name].sequence(states, matrix, 1.0 / rate_hz, gyro, accel, out)
    return out.reshape(len(matrix), *gyro.shape[:2], 2)


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
        raise ValueError(f'unknown estimator "{name}"; {nearest(name, names())}')


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
    elsewhere = {key: found.get(key, each.default) for key, each in spec.items()}
    ratio = tuned_rate / rate_hz
    values = {key: given.get(key, spec[key].carried(value, ratio)) for key, value in elsewhere.items()}
    if missing := [key for key, value in values.items() if math.isnan(value)]:
        raise ValueError(
            f"{name} needs a vehicle, for its drag: give --vehicle (in Python vehicle=), a shipped name or a "
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
    from .networks import create_network  # imports torch, which no other estimator needs

    for key in params:
        if key != "weights":
            raise ValueError(f'{name} has no parameter "{key}"; {nearest(key, ["weights"])}')
    weights = params.get("weights")
    if not isinstance(weights, str | Path | None):
        raise ValueError(f"{name}: weights = {weights!r} is not a path")
    return create_network(name, rate_hz, weights=weights)


def _run_observing(
    est: AttitudeEstimator, observe, gyro: Array, accel: Array, quat: ArrayLike | None
) -> Array:
    if quat is None:
        raise ValueError("this estimator observes the truth: give run(..., quat=) of shape (n, T, 4)")
    truth = np.asarray(quat, dtype=np.float64)
    if truth.shape != (*gyro.shape[:2], 4):
        raise ValueError(f"quat has shape {truth.shape}; it must be {(*gyro.shape[:2], 4)}")
    out = np.empty((*gyro.shape[:2], 2))
    for t in range(gyro.shape[1]):
        observe(truth[:, t])
        out[:, t] = est.update(gyro[:, t], accel[:, t])
    return out
