"""Train an agent to hold a position with PPO from Stable-Baselines3.

    python examples/ppo.py [--steps 65536] [--seeds 1] [--recipe control] [--out reports/ppo]

The agent replaces the position and velocity loops. At 20 Hz, it commands roll, pitch, yaw and thrust to the
inner loops, which use the attitude estimate of Mahony's filter. An episode of 5 s starts 1.1 m from the
set-point, at 1 m/s in any direction. All vehicles fly as one batch. With `--recipe`, the second half of the
training uses the winds and the randomisation of that recipe.

The script writes `ppo.csv`, a policy for each seed, and the learning curve `ppo.png`. The curve shows the
mean return of new episodes, at most 100, compared with the action 0 (level flight at hover thrust) and with
quadsim's own loops.

Install Stable-Baselines3 with pip install 'quadsim[rl]'.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from stable_baselines3 import PPO

from quadsim.control.records import Level
from quadsim.dataset.figures import STYLE
from quadsim.env.policy import Policy, PolicySpec, save_policy
from quadsim.env.sb3 import SB3VecEnv, policy_of
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import Scenario, changed, load_scenario
from quadsim.runs.files import save_figure, write_csv

VEHICLES = 16  # that learn at once
DECISIONS = 128  # of each between two updates of the policy
REPEAT = 10  # samples of 5 ms for which an action holds
EPISODES = 20  # to judge a policy by
JUDGED = 1000  # their seed
BASELINES = ("no action", "quadsim's loops")
ESTIMATOR = "mahony"


def scenario_of(recipe: str | None) -> Scenario:
    """Return a scenario with a displaced start, 5 s of hover, and winds and randomisation of a recipe."""
    hover = load_scenario("hover")
    start = hover.start.model_copy(update={"offset": (0.8, -0.6, 0.5), "speed": 1.0})
    drawn = load_recipe(recipe) if recipe else hover
    parts = {"start": start, "duration_s": 5.0, "wind": drawn.wind, "randomisation": drawn.randomisation}
    return changed(hover, parts)


def vehicles(n: int, scenario: Scenario, level: Level = "attitude") -> SB3VecEnv:
    """Make vehicles that fly a scenario as one batch."""
    return SB3VecEnv(n, REPEAT, estimator=ESTIMATOR, scenario=scenario, level=level)


def no_action(observations: np.ndarray) -> np.ndarray:
    """Return the action 0: level flight at hover thrust or, at level position, the set-point."""
    return np.zeros((len(observations), 4))


def judge(
    scenario: Scenario,
    policy: Callable[[np.ndarray], np.ndarray] = no_action,
    level: Level = "attitude",
    seed: int = JUDGED,
) -> tuple[float, int]:
    """Return the mean return of an episode, and the number of crashes in `EPISODES`."""
    batch = vehicles(EPISODES, scenario, level)
    batch.seed(seed)
    observation = batch.reset()
    total, flying, crashes = np.zeros(EPISODES), np.ones(EPISODES, bool), 0
    while flying.any():
        observation, earned, done, infos = batch.step(policy(observation))
        total += np.where(flying, earned, 0.0)
        crashes += sum(not infos[k]["TimeLimit.truncated"] for k in np.flatnonzero(done & flying))
        flying &= ~done
    return float(total.mean()), crashes


def learn(seed: int, steps: int, recipe: str | None) -> Iterator[tuple[int, Policy]]:
    """Train with a seed; yield the number of actions and the policy after every two updates."""
    training = {"example": "ppo.py", "seed": seed, "steps": steps, "recipe": recipe}
    spec = PolicySpec(level="attitude", estimator=ESTIMATOR, repeat=REPEAT, training=training)
    model = PPO(
        "MlpPolicy",
        vehicles(VEHICLES, scenario_of(None)),
        learning_rate=1e-3,
        n_steps=DECISIONS,
        batch_size=512,
        n_epochs=10,
        gamma=0.98,
        seed=seed,
        policy_kwargs={"log_std_init": -1.5},  # explore with 0.13 rad, not 0.6
        device="cpu",
    )
    yield 0, policy_of(model, spec)
    while model.num_timesteps < steps:
        if recipe and 2 * model.num_timesteps >= steps:
            windy, recipe = vehicles(VEHICLES, scenario_of(recipe)), None
            windy.seed(seed)
            model.set_env(windy)
        model.learn(2 * VEHICLES * DECISIONS, reset_num_timesteps=False)
        yield model.num_timesteps, policy_of(model, spec)


@matplotlib.rc_context(STYLE)
def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Draw the return over the number of actions, one line per seed, with the two references."""
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
    """Train with each seed, print the returns, and write policies and curve."""
    parser = argparse.ArgumentParser(description="Learn to hold a place with PPO.")
    parser.add_argument("--steps", type=int, default=65_536, help="decisions of a training")
    parser.add_argument("--seeds", type=int, default=1, help="trainings")
    parser.add_argument("--recipe", help="whose winds and randomisation to fly in; default: none")
    parser.add_argument("--out", type=Path, default=Path("reports/ppo"), help="folder for what is written")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    scenario, rows = scenario_of(given.recipe), list[dict[str, Any]]()

    def note(who: str, decisions: int, result: tuple[float, int]) -> None:
        print(f"{who:16} {decisions:6} {result[0]:6.1f} {result[1]:3}", flush=True)
        rows.append({"who": who, "decisions": decisions, "return": result[0], "crashes": result[1]})

    print(f"{'':16} decisions, return, crashes of {EPISODES}")
    for who, level in zip(BASELINES, ("attitude", "position"), strict=True):
        note(who, 0, judge(scenario, level=level))
    for seed in range(given.seeds):
        for decisions, policy in learn(seed, given.steps, given.recipe):
            note(f"PPO, seed {seed}", decisions, judge(scenario, policy))
        save_policy(given.out / f"seed-{seed}.safetensors", policy)
    write_csv(given.out / "ppo.csv", rows)
    save_figure(given.out / "ppo.png", draw(rows), dpi=110)
    print(given.out / "ppo.png")


if __name__ == "__main__":
    main()
