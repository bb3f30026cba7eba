"""Learn to hold a place with PPO from stable-baselines3: python examples/ppo.py [STEPS].

The agent replaces the position and velocity loops: 20 times a second it chooses roll, pitch, yaw and thrust,
and the loops below fly them on the attitude that Mahony's filter estimates. An episode starts 1.1 m off the
set-point, at 1 m/s in any direction. Its minute on one core gave

    steps  return  crashes of 20
     none    26.0  0
    loops    91.7  0
        0    26.5  0
    16384    47.6  0
    32768    81.2  0
    49152    87.6  0
    65536    90.2  0

with "none" for level flight without a pilot and "loops" for quadsim's own position and velocity loops.

Needs stable-baselines3: pip install 'quadsim[rl]'.
"""

import sys

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

import estimators
import quadsim  # noqa: F401  registers the environment
from quadsim.control.cascade import Level
from quadsim.flight.scenario import load_scenario

ENVIRONMENTS = 8
REPEAT = 10  # samples of 5 ms for which an action holds
EPISODES = 20  # to judge a policy by


class Repeat(gymnasium.Wrapper):
    """Hold each action for several samples, and average what they earn."""

    def step(self, action):
        """Fly on for `REPEAT` samples, or to the end."""
        total = 0.0
        for _ in range(REPEAT):
            observation, reward, terminated, truncated, info = self.env.step(action)
            total += reward / REPEAT
            if terminated or truncated:
                break
        return observation, total, terminated, truncated, info


def make(level: Level = "attitude") -> gymnasium.Env:
    """One environment: 5 s of hover on Mahony's filter."""
    hover = load_scenario("hover")
    start = hover.start.model_copy(update={"offset": (0.8, -0.6, 0.5), "speed": 1.0})
    scenario = hover.model_copy(update={"start": start, "duration_s": 5.0})
    estimator = estimators.create("mahony", rate_hz=200.0)
    return Repeat(gymnasium.make("quadsim/Quadrotor-v0", estimator=estimator, scenario=scenario, level=level))


def judge(name: str, model: PPO | None = None, level: Level = "attitude") -> None:
    """Print the mean return of an episode, 100 at best, and how many crashed; no model takes no action."""
    env, total, crashes = make(level), 0.0, 0
    for seed in range(EPISODES):
        observation, _ = env.reset(seed=1000 + seed)
        over = False
        while not over:
            action = np.zeros(4) if model is None else model.predict(observation, deterministic=True)[0]
            observation, reward, crashed, late, _ = env.step(action)
            total += float(reward)
            crashes += crashed
            over = crashed or late
    print(f"{name:>5}  {total / EPISODES:6.1f}  {crashes}", flush=True)


def main(steps: int) -> None:
    """Train, and print what an episode earned before, in between and at the end."""
    torch.set_num_threads(1)
    model = PPO(
        "MlpPolicy",
        DummyVecEnv([make] * ENVIRONMENTS),
        n_steps=256,
        batch_size=256,
        n_epochs=20,
        gamma=0.98,
        seed=0,
        policy_kwargs={"log_std_init": -1.5},  # explore with 0.13 rad, not 0.6
    )
    print(f"steps  return  crashes of {EPISODES}")
    judge("none")
    judge("loops", level="position")
    judge("0", model)
    while model.num_timesteps < steps:
        model.learn(steps // 4, reset_num_timesteps=False)
        judge(str(model.num_timesteps), model)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60_000)
