"""The command `compile`, which compiles all code in advance."""

import tempfile
from importlib.util import find_spec
from pathlib import Path

from ..runs.console import output as console
from ..runs.console import progress_bar
from .options import Workers

TRAINING = {"epochs": 1, "batches": 1, "batch_size": 4, "window_s": 0.5}


def compile_code(workers: Workers = None) -> None:
    """Compile simulator, estimators and (with PyTorch) the trainer, so that later commands start at once.

    Without this, each part is compiled when it is first used. Repeat the command after a change of the code.

    Example: quadsim compile
    """
    from scenarios.bench.controllers import default_estimators
    from scenarios.compilation import compile_estimators

    compile_estimators(default_estimators(), workers)
    if find_spec("torch"):
        with progress_bar("compile", "models") as bar, tempfile.TemporaryDirectory() as folder:
            from training.loop import train

            from ..dataset.generation import generate
            from ..flight.recipe import load_recipe

            flights = generate(load_recipe("hummingbird"), 4, 2.0, Path(folder) / "flights.zarr", workers=1)
            for k, model in enumerate(("att-snn", "att-rnn")):
                bar(k, 2, model)
                train(model, str(flights), Path(folder) / model, "paper", **TRAINING)
            bar(2, 2)
    console.print("everything is compiled")
