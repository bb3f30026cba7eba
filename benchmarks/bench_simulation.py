"""How close the simulator comes to the speed of its engine, and how it compares with rotorpy.

    python benchmarks/bench_simulation.py            # one thread, rounds interleaved, medians and ratios
    pip install rotorpy                              # for the last row

Everything is measured in one run, a fraction of a second of each job in turn. A ratio is the median of the
ratios within the rounds, so that a machine that slows down for a while slows both sides of it.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

import quadsim  # noqa: F401  registers the environment
from quadsim.dataset.generation import generate
from quadsim.flight.simulate import FlightConfig, simulate_flights
from quadsim.imu.spec import load_imu
from quadsim.engine import vehicle_model
from quadsim.vehicle import load_vehicle

RATE = 200.0
ROUNDS = 15


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def raw_steps(model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> Callable[[], object]:
    def work() -> None:
        mujoco.mj_resetData(model, data)
        data.ctrl[2] = load_vehicle("hummingbird").mass * 9.81
        mujoco.mj_step(model, data, nstep=steps)

    return work


def rotorpy_flight(duration: float) -> Callable[[], object] | None:
    try:
        from rotorpy.controllers.quadrotor_control import SE3Control
        from rotorpy.environments import Environment
        from rotorpy.trajectories.circular_traj import ThreeDCircularTraj
        from rotorpy.vehicles.hummingbird_params import quad_params
        from rotorpy.vehicles.multirotor import Multirotor
    except ImportError:
        return None

    def work() -> None:
        Environment(
            vehicle=Multirotor(quad_params),
            controller=SE3Control(quad_params),
            trajectory=ThreeDCircularTraj(radius=np.array([2, 2, 0])),
            sim_rate=int(RATE),
        ).run(
            t_final=duration, use_mocap=False, terminate=False, plot=False, animate_bool=False, verbose=False
        )

    return work


def main() -> None:
    config = FlightConfig(vehicle=load_vehicle("hummingbird"), imu=load_imu("adis16448"), warmup_s=0.0)
    seeds = np.random.SeedSequence(0).spawn(64)
    model = vehicle_model(config.vehicle, 1 / RATE, "RK4", contact=False)
    data = mujoco.MjData(model)
    steps, flights, flight_steps, env_steps, rotor_s = 20000, 64, 2000, 4000, 0.5
    env = gymnasium.make("quadsim/Quadrotor-v0", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    action = env.action_space.sample() * 0

    def env_loop() -> None:
        env.reset(seed=0)
        for _ in range(env_steps):
            env.step(action)

    jobs: dict[str, tuple[Callable[[], object], float]] = {
        "raw mj_step, RK4, in C": (raw_steps(model, data, steps), steps),
        "bulk: controller, noise, recording": (
            lambda: simulate_flights(config, seeds, flight_steps, RATE),
            flights * flight_steps,
        ),
        "gymnasium step, n = 1": (env_loop, env_steps),
    }
    rotorpy = rotorpy_flight(rotor_s)
    if rotorpy:
        jobs["rotorpy: controller, IMU, recording"] = (rotorpy, rotor_s * RATE)
    for work, _ in jobs.values():
        work()  # compile and warm up
    times = {name: np.empty(ROUNDS) for name in jobs}
    for i in range(ROUNDS):
        for name, (work, count) in jobs.items():
            times[name][i] = seconds(work) / count * 1e6
    raw, bulk = (times[name] for name in list(jobs)[:2])

    table = Table("job", "µs a step", "raw / job", "job / raw", "job / bulk")
    table.title = f"one thread, median of {ROUNDS} rounds"
    for name, spent in times.items():
        ratios = (raw / spent, spent / raw, spent / bulk)
        table.add_row(name, f"{np.median(spent):.2f}", *(f"{np.median(ratio):.2f}" for ratio in ratios))
    console = Console()
    console.print(table)
    with tempfile.TemporaryDirectory() as folder:
        recipe = config.model_copy(update={"warmup_s": 4.0})
        spent = seconds(lambda: generate(recipe, 35, 100.0, Path(folder) / "paper.zarr", workers=2))
    console.print(f"35 flights of 100 s at 200 Hz to disk, two processes started from nothing: {spent:.1f} s")


if __name__ == "__main__":
    main()
