"""The verb `compile`: once, so that no later command has to."""

import tempfile
from importlib.util import find_spec
from pathlib import Path

from ..runs.console import output as console
from ..runs.console import progress_bar

TRAINING = {"epochs": 1, "batches": 1, "batch_size": 4, "window_s": 0.5}


def compile_code() -> None:
    """Compile simulator, estimators and, with PyTorch, the trainer, so that no later command waits for it.

    Runs each of them for a moment. Without this, each compiles what it needs when it is first used, which
    takes up to half a minute. A change of the code needs it again.

    Example: quadsim compile
    """
    import gymnasium
    import numpy as np

    import estimators
    from scenarios.bench.cell import FlightSettings
    from scenarios.bench.runner import bench

    from ..dataset.generation import generate
    from ..dataset.reading import dataset_info
    from ..flight.recipe import load_recipe

    names = [name for name in estimators.names() if "filterpy" not in name]
    recipes = ("hummingbird", "windy")

    def simulate(folder: Path) -> None:
        for name in recipes:
            dataset_info(generate(load_recipe(name), 4, 2.0, folder / name, workers=1))

    def fly(folder: Path) -> None:
        changes = {"duration_s": 0.1}
        for n in (1, 2):
            bench(["hover", "take-off"], names, folder / f"bench-{n}", FlightSettings(n), changes, workers=1)
            env = gymnasium.make_vec("quadsim/Quadrotor-v0", num_envs=n, estimator="mahony")
            env.reset(seed=0)
            env.step(np.zeros((n, 4), np.float32))

    def learn(folder: Path) -> None:
        from training.loop import train

        for model in ("att-snn", "att-rnn"):
            train(model, str(folder / recipes[0]), folder / model, "best", **TRAINING)

    with progress_bar("compile", "parts") as bar, tempfile.TemporaryDirectory() as folder:
        parts = (simulate, fly, learn) if find_spec("torch") else (simulate, fly)
        for done, part in enumerate(parts):
            bar(done, len(parts))
            part(Path(folder))
        bar(len(parts), len(parts))
    console.print("everything is compiled")
