"""What the paper says, from `quoted.toml`."""

import tomllib
from pathlib import Path
from typing import Any

TITLE = (
    "S. Stroobants, J. Dupeyroux and G. C. H. E. de Croon, *Neuromorphic computing for attitude estimation "
    "onboard quadrotors*, 2022, [arXiv:2304.08802](https://arxiv.org/abs/2304.08802)"
)
CODE = (
    "[tudelft/neuromorphic_attitude_estimation](https://github.com/tudelft/neuromorphic_attitude_estimation)"
)
_ALL: dict[str, Any] = tomllib.loads(Path(__file__).with_name("quoted.toml").read_text(encoding="utf-8"))

FOLDS: dict[str, tuple[list[float], list[float]]] = {
    row["fold"]: (row["train"], row["test"]) for row in _ALL["table1"]
}
"""Table 1: mean and SD on training and test flights [deg] by fold; "sim", "px4": trained on these alone."""
METHODS: dict[tuple[str, str], tuple[list[float], list[float]]] = {
    (row["method"], row["start"]): (row["train"], row["test"]) for row in _ALL["table2"]
}
"""Table 2: median, mean and SD on training and test flights [deg], by method and start."""
LOSSES: dict[str, float] = _ALL["losses"]
CONVERGE_S: dict[str, float] = _ALL["converge_s"]
ACTIVITY: dict[str, Any] = _ALL["activity"]
LAYER: dict[str, float] = _ALL["recurrent_layer"]


def mean_deg(method: str, start: str = "unknown") -> float:
    """Mean error on the test flights [deg]."""
    return METHODS[method, start][1][1]


def operations(neurons: int, inputs: int) -> dict[str, int]:
    """Operations a step of a layer by the paper's formulas."""
    m, n = neurons, inputs
    return {"snn": m * m + m * n + 2 * m, "gru": 3 * m * m + 3 * m * n + 3 * m}
