"""What the paper says, as far as its numbers are known to this project. What is not here is "not quoted"."""

from __future__ import annotations

NOT_QUOTED = "not quoted"
TITLE = (
    "S. Stroobants, J. Dupeyroux and G. C. H. E. de Croon, *Neuromorphic computing for attitude estimation "
    "onboard quadrotors*, 2022, [arXiv:2304.08802](https://arxiv.org/abs/2304.08802)"
)
TEST_DEG = {"att-snn": 2.79, "att-rnn": 2.45, "complementary": 2.13}
"""Error on its test flights [deg]."""
GENERAL_DEG = "4.9 (others 2–3)"
"""Its Table 1: trained in simulation and tested on real flights; otherwise [deg]."""
CONVERGE_S = {"networks": 1.0, "filters": 7.0}
"""From 20° off: networks in less, filters in more [s] (its Fig. 6)."""
REMOVABLE = 0.25
"""Share of the neurons that can go without loss, about (its Fig. 7)."""
FLOPS_RATIO = 3.0
"""Operations of Att-RNN over those of Att-SNN, about."""
CHIP = {"µJ": 13.2, "µs": 10.0}
"""Energy and time of a step on its board of 32 chips."""
PYTORCH_US = {"SNN, plain PyTorch": 555.0, "GRU, PyTorch": 150.0}
"""Time of a step in PyTorch, on its computer (its Fig. 9)."""
