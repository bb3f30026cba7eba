"""Learn to hold a place with PPO from stable-baselines3.

    python examples/ppo.py [--steps 65536] [--seeds 1] [--out reports/ppo]

The agent replaces the position and velocity loops. At 20 Hz it chooses roll, pitch, yaw and
thrust, and the loops below fly them on the attitude that Mahony's filter estimates. An episode of 5 s starts
1.1 m from the set-point, at 1 m/s in any direction. All vehicles of a training fly as one batch.

Writes `ppo.csv` and the learning curve `ppo.png`: the mean return of episodes that no training saw, 100 at
best, beside that of no action (level flight at hover thrust) and that of quadsim's own loops.

Needs stable-baselines3: pip install 'quadsim[rl]'.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import quadsim  # noqa: F401  registers the environment
from quadsim.control.records import Level
from quadsim.dataset.figures import STYLE
from quadsim.flight.scenario import load_scenario
from quadsim.runs.files import save_figure, write_csv

VEHICLES = 16  # that learn at once
DECISIONS = 128  # of each between two updates of the policy
REPEAT = 10  # samples of 5 ms for which an action holds
EPISODES = 20  # to judge a policy by
JUDGED = 1000  # their seed
BASELINES = ("no action", "quadsim's loops")


class Batch(VecEnv):
    """The batched environment as stable-baselines3 takes it, with actions that hold for `REPEAT` samples."""

    def __init__(self, n: int, level: Level = "attitude") -> None:
        hover = load_scenario("hover")
        start = hover.start.model_copy(update={"offset": (0.8, -0.6, 0.5), "speed": 1.0})
        scenario = hover.model_copy(update={"start": start, "duration_s": 5.0})
        self.env = gymnasium.make_vec(
            "quadsim/Quadrotor-v0", num_envs=n, estimator="mahony", scenario=scenario, level=level
        )
        super().__init__(n, self.env.single_observation_space, self.env.single_action_space)

    def reset(self) -> np.ndarray:
        """Begin all episodes; what the environment returns besides observations stays in it."""
        observation, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next step."""
        self.actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Fly `REPEAT` samples, and average what they earn.

        The environment restarts a vehicle in the sample after its end: after an end in the last, all
        fly one more. A vehicle that has restarted takes no action until the next step.
        """
        n = self.num_envs
        earned, done, ended = np.zeros(n), np.zeros(n, bool), np.zeros(n, bool)
        infos: list[dict[str, Any]] = [{} for _ in range(n)]
        sample = 0
        while sample < REPEAT or ended.any():
            action = np.where(done[:, None], 0.0, self.actions)
            observation, reward, crashed, late, _ = self.env.step(action)
            earned += np.where(done, 0.0, reward) / REPEAT
            ended = crashed | late
            for k in np.flatnonzero(ended & ~done):
                late_only = bool(late[k] and not crashed[k])
                infos[k] = {"terminal_observation": observation[k], "TimeLimit.truncated": late_only}
            done |= ended
            sample += 1
        return observation, earned, done, infos

    def close(self) -> None:
        """Free the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the batch, once for each vehicle."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the vehicles share one environment."""
        raise NotImplementedError("vehicles of a batch have no attributes of their own")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: the vehicles share one environment."""
        raise NotImplementedError("vehicles of a batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No vehicle has a wrapper of its own."""
        return [False] * len(list(self._get_indices(indices)))


def judge(model: PPO | None = None, level: Level = "attitude") -> tuple[float, int]:
    """Mean return of an episode, and how many of `EPISODES` crashed; no model takes no action."""
    batch = Batch(EPISODES, level)
    batch.seed(JUDGED)
    observation = batch.reset()
    total, flying, crashes = np.zeros(EPISODES), np.ones(EPISODES, bool), 0
    while flying.any():
        action = (
            np.zeros((EPISODES, 4)) if model is None else model.predict(observation, deterministic=True)[0]
        )
        observation, earned, done, infos = batch.step(action)
        total += np.where(flying, earned, 0.0)
        crashes += sum(not infos[k]["TimeLimit.truncated"] for k in np.flatnonzero(done & flying))
        flying &= ~done
    return float(total.mean()), crashes


def learn(seed: int, steps: int) -> Iterator[dict[str, Any]]:
    """Train with a seed, and judge before and after each two updates of the policy."""
    model = PPO(
        "MlpPolicy",
        Batch(VEHICLES),
        n_steps=DECISIONS,
        batch_size=256,
        n_epochs=20,
        gamma=0.98,
        seed=seed,
        policy_kwargs={"log_std_init": -1.5},  # explore with 0.13 rad, not 0.6
        device="cpu",
    )
    while True:
        earned, crashes = judge(model)
        yield {
            "who": f"PPO, seed {seed}",
            "decisions": model.num_timesteps,
            "return": earned,
            "crashes": crashes,
        }
        if model.num_timesteps >= steps:
            return
        model.learn(2 * VEHICLES * DECISIONS, reset_num_timesteps=False)


@matplotlib.rc_context(STYLE)
def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Return against decisions: one line a seed, and the two that learn nothing."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    curves: dict[str, list[tuple[int, float]]] = {}
    for each in rows:
        curves.setdefault(each["who"], []).append((each["decisions"], each["return"]))
    learnt = {who: points for who, points in curves.items() if who not in BASELINES}
    for who, points in learnt.items():
        axes.plot(*np.transpose(points), marker=".", label=who)
    last = max(points[-1][0] for points in learnt.values())
    for who in BASELINES:
        level = curves[who][0][1]
        axes.axhline(level, color="#555555", linestyle="--", linewidth=1.0)
        axes.annotate(who, (last, level), (0, 4), textcoords="offset points", ha="right", color="#555555")
    axes.set(
        xlabel="decisions, 20 a second of flight and vehicle",
        ylabel="mean return of an episode",
        ylim=(0, 100),
    )
    axes.legend(loc="center right")
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    """Train with each seed, print what episodes earn, and write the curve."""
    parser = argparse.ArgumentParser(description="Learn to hold a place with PPO.")
    parser.add_argument("--steps", type=int, default=65_536, help="decisions of a training")
    parser.add_argument("--seeds", type=int, default=1, help="trainings")
    parser.add_argument("--out", type=Path, default=Path("reports/ppo"), help="folder of ppo.csv and ppo.png")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    rows: list[dict[str, Any]] = []

    def note(row: dict[str, Any]) -> None:
        print(f"{row['who']:16} {row['decisions']:6} {row['return']:6.1f} {row['crashes']:3}", flush=True)
        rows.append(row)

    print(f"{'':16} decisions, return, crashes of {EPISODES}")
    for who, level in zip(BASELINES, ("attitude", "position"), strict=True):
        earned, crashes = judge(level=level)
        note({"who": who, "decisions": 0, "return": earned, "crashes": crashes})
    for seed in range(given.seeds):
        for row in learn(seed, given.steps):
            note(row)
    given.out.mkdir(parents=True, exist_ok=True)
    write_csv(given.out / "ppo.csv", rows)
    save_figure(given.out / "ppo.png", draw(rows), dpi=110)
    print(given.out / "ppo.png")


if __name__ == "__main__":
    main()
