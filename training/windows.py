"""Windows of flights as a `torch.utils.data.Dataset`, for your own training loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from quadsim.dataset.reading import open_dataset
from quadsim.held_out import unreserved
from quadsim.rotation import roll_pitch_from_quat


class Windows(Dataset[tuple[Tensor, Tensor]]):
    """Windows of the complete flights of a dataset, in single precision.

    An item is a pair: readings (steps, 6), which are gyro [rad/s] and accel [m/s²], and true roll and pitch
    (steps, 2) [rad]. Flights that ended early are left out.

    Args:
        path: A dataset written by `quadsim generate`.
        steps: Number of samples in a window. The rest of each flight is left out.
        held_out: Allow the data of a benchmark task, which must not be used for training.

    Raises:
        ValueError: The path is not a dataset, the data belong to a task and `held_out` is not set, or no
            flight is as long as a window.
    """

    def __init__(self, path: str | Path, steps: int, held_out: bool = False) -> None:
        data = open_dataset(path)
        if not held_out:
            unreserved(int(data.attrs["seed"]))
        data = data.isel(flight=np.flatnonzero(data["valid_steps"].to_numpy() == data.sizes["time"]))
        count = data.sizes["time"] // steps
        if not count or not data.sizes["flight"]:
            raise ValueError(f"{path}: no whole flight of {steps} samples")
        data = data.isel(time=slice(count * steps))
        readings = np.concatenate([data["gyro"], data["accel"]], axis=-1)
        truth = roll_pitch_from_quat(data["quat"].to_numpy().astype(float))
        self.readings, self.truth = (
            torch.from_numpy(np.reshape(each, (-1, steps, each.shape[-1])).astype(np.float32))
            for each in (readings, truth)
        )

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.readings)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        """Return readings (steps, 6) and true roll and pitch (steps, 2)."""
        return self.readings[index], self.truth[index]
