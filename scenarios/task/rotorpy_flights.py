"""Flights simulated by RotorPy, a simulator by other authors, as data for estimators.

Dynamics, aerodynamics, wind, trajectories and controller are those of RotorPy (Folk, Paulos & Kumar,
"RotorPy: A Python-based multirotor simulator with aerodynamics for education and research", 2023,
arXiv:2306.04485). The IMU is that of quadsim: `quadsim.imu`, applied to the body rate and the specific force
of RotorPy's state derivative. A second of flight takes about a third of a second of CPU time.
"""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.trajectories.lissajous_traj import TwoDLissajous
from rotorpy.trajectories.minsnap import MinSnap
from rotorpy.vehicles import crazyflie_params, hummingbird_params
from rotorpy.vehicles.multirotor import Multirotor
from rotorpy.wind.default_winds import SinusoidWind
from rotorpy.wind.dryden_winds import DrydenGust

from quadsim.imu.spec import ImuSpec
from quadsim.imu.stream import motion_of, simulate_readings
from quadsim.rotation import quat_rotate_inverse, wxyz_from_xyzw
from quadsim.runs.files import replace
from quadsim.runs.fingerprint import file_digest, fingerprint
from quadsim.runs.pool import run_jobs
from quadsim.vehicle import AIR_DENSITY, GRAVITY, Motor, Rotor, Vehicle, load_vehicle

Array = NDArray[np.float64]

RATE_HZ = 200.0
WARMUP_S, DURATION_S = 4.0, 60.0
"""Duration before the recording, and duration of the recording [s]."""
AIRFRAMES: dict[str, dict[str, Any]] = {
    "hummingbird": hummingbird_params.quad_params,
    "crazyflie": crazyflie_params.quad_params,
}
"""Module of RotorPy with the constants of each airframe."""
RECORDED = {
    "position": "x",
    "velocity": "v",
    "quat": "q",
    "ang_vel": "w",
    "wind": "wind",
    "rotor_vel": "rotor_speeds",
    "accel": "accel",
}
"""Arrays of a flight and their names in RotorPy's state; the acceleration is in world axes."""


class RotorpyPlan(NamedTuple):
    """Parameters of a flight."""

    airframe: str
    path: Literal["lissajous", "waypoints"]
    wind: Literal["sinusoid", "dryden"]
    yaw_rate: float
    """Constant commanded yaw rate [rad/s]. RotorPy's controller diverges at high yaw rates."""
    seed: int
    """Seed of path, wind and IMU."""


def plans(airframe: str, seed: int) -> tuple[RotorpyPlan, ...]:
    """Return four flights of an airframe: two paths in two winds, with consecutive seeds."""
    return (
        RotorpyPlan(airframe, "lissajous", "sinusoid", 0.0, seed),
        RotorpyPlan(airframe, "lissajous", "dryden", 0.3, seed + 1),
        RotorpyPlan(airframe, "waypoints", "sinusoid", -0.2, seed + 2),
        RotorpyPlan(airframe, "waypoints", "dryden", 0.0, seed + 3),
    )


def lissajous(rng: np.random.Generator) -> Any:
    """Make a Lissajous curve with peak accelerations of 2 to 4.5 m/s² on each axis."""
    amplitude, accel = rng.uniform(2.0, 4.0, 2), rng.uniform(2.0, 4.5, 2)
    (a, b), phase = np.sqrt(accel / amplitude), rng.uniform(0.0, 2.0 * np.pi)
    return TwoDLissajous(A=amplitude[0], B=amplitude[1], a=a, b=b, delta=phase, height=2.0)  # pyright: ignore


def waypoints(rng: np.random.Generator, duration_s: float) -> Any:
    """Make a minimum-snap path through random points at least 2.5 m apart, with a mean speed of 2 m/s."""
    speed, points = 2.0, [np.zeros(3)]
    while np.linalg.norm(np.diff(points, axis=0), axis=1).sum() < speed * duration_s:
        point = rng.uniform((-3.0, -3.0, -1.0), (3.0, 3.0, 1.0))
        if np.linalg.norm(point - points[-1]) > 2.5:
            points.append(point)
    return MinSnap(np.array(points), v_avg=speed, v_max=3.0 * speed, verbose=False)  # pyright: ignore


def wind_of(plan: RotorpyPlan, rng: np.random.Generator) -> Any:
    """Make RotorPy's sinusoids of up to 3 m/s and 0.3 Hz, or its Dryden turbulence around a mean wind.

    The noise of RotorPy's turbulence does not depend on the step: at 200 Hz, the standard deviation is about
    a hundredth of `sig_wind`.
    """
    if plan.wind == "sinusoid":
        frequency = rng.uniform(0.02, 0.3, 3)
        return SinusoidWind(np.array([3.0, 3.0, 1.0]), frequency, rng.uniform(0.0, 1.0, 3) / frequency)
    mean = np.append(rng.uniform(-2.0, 2.0, 2), 0.0)
    return DrydenGust(dt=1.0 / RATE_HZ, avg_wind=mean, sig_wind=np.array([100.0, 100.0, 50.0]), altitude=5.0)


def fly_plan(
    plan: RotorpyPlan, duration_s: float = DURATION_S, warmup_s: float = WARMUP_S
) -> dict[str, Array]:
    """Simulate a flight with RotorPy at 200 Hz, from hover at the start of its path.

    Args:
        plan: The flight.
        duration_s: Duration of the recording [s].
        warmup_s: Duration before the recording [s].

    Returns:
        Arrays (T, ·), each row for one instant: position [m], velocity and wind [m/s] in world axes, z up;
        quat_WB, scalar first; ang_vel [rad/s] and specific_force [m/s²], R_BW (dv/dt + g e_z), in body axes;
        rotor_vel [rad/s].
    """
    constants, dt = AIRFRAMES[plan.airframe], 1.0 / RATE_HZ
    warmup, steps = (round(each * RATE_HZ) for each in (warmup_s, duration_s))
    rng = np.random.default_rng(plan.seed)
    np.random.seed(plan.seed)  # noqa: NPY002  # RotorPy's turbulence draws from NumPy's global generator
    path = lissajous(rng) if plan.path == "lissajous" else waypoints(rng, warmup_s + duration_s)
    wind, controller = wind_of(plan, rng), SE3Control(constants)
    state = hover(constants, path.update(0.0)["x"])
    multirotor = Multirotor(constants, state)
    rows = []
    for k in range(warmup + steps):
        t = k * dt
        state["wind"] = wind.update(t, state["x"])
        reference = path.update(t) | {"yaw": plan.yaw_rate * t, "yaw_dot": plan.yaw_rate}
        command = controller.update(t, state, reference)
        rows.append(state | {"accel": multirotor.statedot(state, command, dt)["vdot"]})
        state = multirotor.step(state, command, dt)
    found = {name: np.array([row[key] for row in rows[warmup:]]) for name, key in RECORDED.items()}
    found["quat"] = wxyz_from_xyzw(found["quat"])
    accel_W = found.pop("accel") + np.array([0.0, 0.0, GRAVITY])
    return found | {"specific_force": quat_rotate_inverse(found["quat"], accel_W)}


def hover(constants: Mapping[str, Any], position: Array) -> dict[str, Array]:
    """Return RotorPy's state of an airframe that hovers at a position [m]; the quaternion is scalar-last."""
    rotors = constants["num_rotors"]
    speed = np.sqrt(constants["mass"] * GRAVITY / (rotors * constants["k_eta"]))
    still = {"v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3), "wind": np.zeros(3)}
    return {"x": position, **still, "rotor_speeds": np.full(rotors, speed)}


def vehicle(airframe: str) -> Vehicle:
    """Return an airframe with RotorPy's constants, and the outline of the vehicle with the same name."""
    constants = AIRFRAMES[airframe]
    area = (2.0 * constants[key] / AIR_DENSITY for key in ("c_Dx", "c_Dy", "c_Dz"))  # c |v| v = ½ ρ A |v| v
    turns = zip(constants["rotor_pos"].values(), constants["rotor_directions"], strict=True)
    ixx, iyy, izz = (constants[key] for key in ("Ixx", "Iyy", "Izz"))
    return Vehicle(
        name=f"rotorpy-{airframe}",
        source=f"RotorPy {version('rotorpy')}, vehicles/{airframe}_params.py",
        mass=constants["mass"],
        inertia=(ixx, iyy, min(izz, ixx + iyy)),  # that of its Crazyflie is above, which no rigid body has
        rotors=tuple(Rotor(position=tuple(hub), spin="cw" if sense > 0 else "ccw") for hub, sense in turns),
        motor=Motor(
            k_f=constants["k_eta"],
            k_m=constants["k_m"] / constants["k_eta"],
            omega_max=constants["rotor_speed_max"],
            tau_up=constants["tau_m"],
            tau_down=constants["tau_m"],
            rotor_drag=constants["k_d"],
            rolling_moment=0.0,
        ),
        frame=load_vehicle(airframe).frame.model_copy(update={"drag_area": tuple(area)}),
    )


def stored(plan: RotorpyPlan, file: Path, duration_s: float = DURATION_S) -> dict[str, Array]:
    """Load a flight from its file; simulate it if the file is missing or was made by another plan or code."""
    digest = fingerprint(plan, duration_s, version("rotorpy"), file_digest(Path(__file__)))
    if file.is_file():
        with np.load(file) as found:
            if str(found["digest"]) == digest:
                return {name: found[name] for name in found.files if name != "digest"}
    flown = fly_plan(plan, duration_s)
    replace(file, lambda part: np.savez_compressed(part, digest=digest, **flown))  # pyright: ignore
    return flown


def rotorpy_flights(
    planned: Sequence[RotorpyPlan],
    folder: Path,
    imu: ImuSpec,
    duration_s: float = DURATION_S,
    workers: int | None = None,
) -> xr.Dataset:
    """Return flights of one airframe as a dataset.

    Args:
        planned: The flights.
        folder: Folder of the stored flights.
        imu: The IMU, which is switched on at the start of the recording.
        duration_s: Length of each flight [s].
        workers: Number of processes that simulate missing flights.
    """
    airframe = planned[0].airframe
    jobs = {plan: (plan, folder / f"{airframe}-{plan.seed}.npz", duration_s) for plan in planned}
    flown = dict(run_jobs(stored, jobs, workers))
    truth = {name: np.stack([flown[plan][name] for plan in planned]) for name in flown[planned[0]]}
    seeds = [np.random.SeedSequence(plan.seed) for plan in planned]
    motion = truth["ang_vel"], truth["specific_force"]
    felt = motion_of(imu, *motion, rotor_vel=truth["rotor_vel"])
    last = {"quat": "quat_axis", "rotor_vel": "rotor"}
    everything = truth | simulate_readings(imu, felt, RATE_HZ, seeds)
    config = {"vehicle": vehicle(airframe).model_dump(mode="json"), "imu": imu.model_dump(mode="json")}
    return xr.Dataset(
        {name: (("flight", "time", last.get(name, "axis")), values) for name, values in everything.items()},
        {"wind_model": ("flight", [plan.wind for plan in planned])},
        {"rate_hz": RATE_HZ, "config": json.dumps(config)},
    )
