"""What a simulated step costs: `python -m benchmarks.bench_simulation`.

    pip install crazyflow   # for its rows

Beside its engine and another simulator, on one thread, jobs in turns. A ratio is the median of the ratios
within the rounds. Wall and CPU time differ where a job uses several threads, or has to wait.
"""

import os

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # crazyflow refuses to be imported without it

from collections.abc import Callable
from importlib.util import find_spec

import gymnasium
import mujoco
import numpy as np
import pandas as pd

import estimators
import quadsim  # noqa: F401  registers the environment
from quadsim.flight.mission import Mission
from quadsim.flight.recipe import Recipe
from quadsim.flight.scenario import load_scenario
from quadsim.flight.simulate import simulate_flights
from quadsim.imu.spec import load_imu
from quadsim.motion.engine import vehicle_model
from quadsim.vehicle import load_vehicle
from scenarios.bench.flight_log import fly_mission

from .timing import in_turns, spent

RATE = 200.0
CELLS = ("truth", "mahony", "ekf-drag", "att-snn-loihi")

Job = tuple[Callable[[], object], float]
"""What is timed, and how many steps of a vehicle it makes."""


def raw_steps(model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> Callable[[], object]:
    def work() -> None:
        mujoco.mj_resetData(model, data)
        data.ctrl[2] = load_vehicle("hummingbird").mass * 9.81
        mujoco.mj_step(model, data, nstep=steps)

    return work


def crazyflow_batch(n: int, integrator: str, steps: int) -> Callable[[], object]:
    """Its own position controller and first-principles model of a Crazyflie, float32, nothing recorded."""
    import jax
    from crazyflow.control import Control
    from crazyflow.dynamics import Dynamics
    from crazyflow.sim import Sim

    rates = ("freq", "state_freq", "attitude_freq", "body_rate_freq", "force_torque_freq")
    model = {"dynamics": Dynamics.first_principles, "control": Control.state, "integrator": integrator}
    sim = Sim(n_worlds=n, **model, **dict.fromkeys(rates, int(RATE)))
    command = np.zeros((n, 1, 16), np.float32)
    command[..., 2] = 1.0

    def work() -> None:
        sim.reset()
        sim.state_control(command)
        sim.step(steps)
        jax.block_until_ready(sim.data.states.pos)

    return work


def environment(n: int, steps: int) -> Job:
    """Steps of the environment, one or a batch."""
    if n == 1:
        env = gymnasium.make("quadsim/Quadrotor-v0", disable_env_checker=True).unwrapped
        action = np.zeros(4, np.float32)
    else:
        env = gymnasium.make_vec("quadsim/Quadrotor-v0", num_envs=n)
        action = np.zeros((n, 4), np.float32)
    env.reset(seed=0)

    def work() -> None:
        env.reset(seed=0)
        for _ in range(steps):
            env.step(action)

    return work, n * steps


def cell(estimator: str, n: int = 20) -> Job:
    """Flights of a benchmark's cell, logged: scenario `wind-gust`."""
    scenario = load_scenario("wind-gust")
    made = estimators.create(estimator, RATE, vehicle=scenario.vehicle, imu=scenario.imu)
    mission = Mission(scenario, made, n, RATE)
    return lambda: fly_mission(mission, seed=0), n * mission.steps


def all_jobs() -> dict[str, Job]:
    """What is timed, by name; the first two are those that ratios are to."""
    config = Recipe(vehicle=load_vehicle("hummingbird"), imu=load_imu("adis16448"), warmup_s=0.0)
    seeds = np.random.SeedSequence(0).spawn(64)
    model = vehicle_model(config.vehicle, 1 / RATE, "RK4", contact=False)
    on_mujoco = config.model_copy(update={"engine": "mujoco"})
    jobs: dict[str, Job] = {
        "raw mj_step, RK4, in C": (raw_steps(model, mujoco.MjData(model), 20000), 20000),
        "bulk: controller, IMU, recording": (lambda: simulate_flights(config, seeds, 1000, RATE), 64_000),
        "the same, engine = mujoco": (lambda: simulate_flights(on_mujoco, seeds, 250, RATE), 16_000),
        "environment, n = 1": environment(1, 4000),
        "environment, n = 64": environment(64, 2000),
        **{f"benchmark cell, {name}": cell(name) for name in CELLS},
    }
    if find_spec("crazyflow"):
        for integrator, n, steps in (("RK4", 64, 1000), ("RK4", 1024, 100), ("Euler", 1024, 100)):
            work = crazyflow_batch(n, integrator.lower(), steps)
            jobs[f"crazyflow, {integrator}, n = {n}"] = work, n * steps
    return jobs


def measure(rounds: int = 9, jobs: dict[str, Job] | None = None) -> pd.DataFrame:
    """Medians of wall and CPU time of a step [µs], and ratios of CPU time."""
    jobs = jobs or all_jobs()
    for work, _ in jobs.values():
        work()  # compile and warm up
    taken = in_turns({name: lambda work=work: spent(work) for name, (work, _) in jobs.items()}, rounds)
    wall, cpu = (
        pd.DataFrame({name: each[:, k] / jobs[name][1] * 1e6 for name, each in taken.items()}) for k in (0, 1)
    )
    raw, bulk = (cpu[name] for name in list(jobs)[:2])
    over = {"over_raw": cpu.div(raw, axis=0), "over_bulk": cpu.div(bulk, axis=0)}
    found = {"wall_us": wall, "cpu_us": cpu, **over}
    return pd.DataFrame({name: each.median() for name, each in found.items()})


if __name__ == "__main__":
    print(measure().round(2))
