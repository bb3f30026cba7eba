"""Take the choices of the `best` preset away one at a time: writes docs/training/ablation.csv.

Every row is a whole training over as many hours of the same flights, judged on validation flights alone;
finished rows are kept in `--runs` and taken from there.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from training_page import many_starts, within

from estimators import create
from estimators.activity import record
from estimators.flights import load_flights
from estimators.networks import OnLoihi
from estimators.pruning import error_deg, importance, pruned
from estimators.weights_file import PAPER_SCALING, load_network, parameters
from quadsim.dataset import open_dataset
from training.augment import Augmentation
from training.config import PRESETS, make_config
from training.loop import train

HERE = Path(__file__).parent
BEST: dict[str, Any] = PRESETS["best"]
ERRORS: Augmentation = BEST["augmentation"]

SIZES: tuple[tuple[int, int, int], ...] = (
    (100, 100, 0), (200, 200, 0), (200, 200, 21202), (300, 300, 0), (300, 300, 21202), (300, 300, 18500),
    (300, 300, 16000), (300, 300, 12000), (300, 300, 5000),
)  # fmt: skip
"""Neurons of both layers at the start, and the parameters that may stay (0: all)."""
FEWER = 4
"""The one of them that neurons are taken out of."""
SIZE_EPOCHS = 16

ROWS: dict[str, dict[str, Any]] = {
    "best": {},
    "best, another seed": {"seed": 1},
    "100 + 100 neurons, every connection": {"encoding": 100, "hidden": 100, "parameters": 0},
    "300 + 300 neurons, every connection": {"parameters": 0},
    "inputs as in the paper": {"inputs": PAPER_SCALING},
    "random start": {"start": "random"},
    "outputs of 1 rad per unit": {"output_scale": 1.0},
    "constant learning rate": {"decay": "none"},
    "learning rate of 0.1": {"optimiser_lr": 0.1},
    "learning rate of 0.005": {"optimiser_lr": 0.005},
    "steps as large in every layer": {"optimiser_lr": 0.02, "layer_steps": (1.0, 1.0, 1.0)},
    "no limit on the gradient": {"clip": 0.0},
    "no state carried over": {"windows_per_stream": 1},
    "streams of up to 30 s": {"windows_per_stream": 6},
    "no weights shared by symmetry": {"symmetric": False},
    "batches of 40 windows": {"batch_size": 40, "batches": 60},
    "no symmetry in the data": {"augmentation": ERRORS.model_copy(update={"yaw_symmetry": False})},
    "sensor errors as in the paper": {"augmentation": Augmentation(yaw_symmetry=True)},
    "no cost of spikes": {"rate_cost": 0.0},
    "spikes at 20 and 40 %": {"rate_cost": 0.003, "rate_targets": (0.2, 0.4)},
    "not quantised": {"quantised": False},
    "two network steps a sample": {"steps_per_sample": 2},
    "paper": {"preset": "paper", "batches": 30, "stop_early": False},
}
"""What differs from the `best` preset in each row."""


def main() -> None:
    """Train every row and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--data", default="data/train.zarr")
    parser.add_argument("--validation", default="data/val.zarr")
    parser.add_argument("--runs", type=Path, default=Path("runs/ablation"))
    parser.add_argument("--thinning", action="store_true", help="The table of sizes instead.")
    args = parser.parse_args()
    if args.thinning:
        thinning(args.runs)
        return
    rows = []
    pieces = many_starts(load_flights([open_dataset(args.validation)]))
    for name, changes in ROWS.items():
        choices: dict[str, Any] = {"preset": "best", "epochs": args.epochs} | changes
        folder = args.runs / f"{name.replace(' ', '-').replace(',', '')}-{args.epochs}"
        result = train(data=args.data, validation=args.validation, out=folder, **choices)
        times = within(create("att-snn", weights=result.weights), pieces)
        rows.append(
            {
                "row": name,
                "updates": args.epochs * make_config(**choices, data=args.data).batches,
                "val_error_deg": round(result.best.val_error_deg, 3),
                "val_settled_deg": round(result.best.val_settled_deg, 3),
                "within_s": round(float(np.median(times)), 2),
                "rate_encoding": round(result.best.rate_encoding, 3),
                "rate_hidden": round(result.best.rate_hidden, 3),
            }
        )
        write("ablation", rows)


def thinning(runs: Path) -> None:
    """Train networks of several sizes, thinned and not: writes docs/training/thinning.csv."""
    data, validation = (
        tuple(f"data/{name}{kind}.zarr" for kind in ("", "-windy")) for name in ("train", "val")
    )
    rows = []
    for encoding, hidden, most in SIZES:
        result = train(
            data=data, validation=validation, out=runs / f"from-{encoding}-{hidden}-to-{most}", preset="best",
            epochs=SIZE_EPOCHS, encoding=encoding, hidden=hidden, parameters=most,
        )  # fmt: skip
        config, tensors = load_network(result.weights)
        rows.append(
            {
                "begins": f"{encoding} + {hidden}",
                "keeps": most or "all",
                "parameters": parameters(tensors),
                "neurons": f"{config.encoding} + {config.hidden}",
                "val_error_deg": round(result.best.val_error_deg, 3),
                "rate_encoding": round(result.best.rate_encoding, 3),
                "rate_hidden": round(result.best.rate_hidden, 3),
                "epochs": SIZE_EPOCHS,
            }
        )
        write("thinning", rows)
    encoding, hidden, most = SIZES[FEWER]
    path = runs / f"from-{encoding}-{hidden}-to-{most}" / "best.safetensors"
    fewer_neurons(path, encoding + hidden, data, validation)


def fewer_neurons(path: Path, whole: int, data: Sequence[str], validation: Sequence[str]) -> None:
    """Take neurons out of a thinned network, nothing trained again: writes docs/training/neurons.csv."""
    config, tensors = load_network(path)
    seen, scored = (
        load_flights([open_dataset(each) for each in paths], count)
        for paths, count in ((data[:1], 4), (validation, None))
    )
    activity = record(OnLoihi(config, tensors), seen.gyro, seen.accel)
    ranks = importance(tensors, activity, "contribution")
    rows = []
    for share in (0.0, 0.1, 0.2, 0.3, 0.4):
        left = pruned(config, tensors, ranks, share)
        rows.append(
            {
                "neurons": f"{left[0].encoding} + {left[0].hidden}",
                "removed": round(1 - (left[0].encoding + left[0].hidden) / whole, 3),
                "parameters": parameters(left[1]),
                "val_error_deg": round(error_deg(*left, scored), 3),
            }
        )
        write("neurons", rows)


def write(name: str, rows: list[dict[str, Any]]) -> None:
    """Say the last row, and write all of them."""
    print(rows[-1], flush=True)
    with (HERE / "training" / f"{name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
