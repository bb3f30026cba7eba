"""Colour, dash and marker of each estimator, the same in every figure, page and report.

The hues are distinct for normal sight, protanopia and deuteranopia, and visible on white and on the dark
background of reports (tests/estimators/test_appearance.py). Estimators with the same hue differ in dash and
marker.
"""

from collections.abc import Iterable
from itertools import cycle
from typing import Any, NamedTuple

SOLID: tuple[float, ...] = ()
DASHED, DASHDOT, DOTTED = (5.0, 2.0), (5.0, 1.5, 1.0, 1.5), (1.0, 1.5)
LOOSE, DOUBLE = (3.0, 3.0), (5.0, 1.5, 1.0, 1.5, 1.0, 1.5)
DASHES = (SOLID, DASHED, DASHDOT, DOTTED, LOOSE, DOUBLE)
MARKERS = "osD^vP<>X*phd"
"""Markers in matplotlib's notation; scenarios/report/js/markers.js has those of the browser."""
GREY = "#757b83"
AMBER, WINE, MAUVE, MAGENTA = "#cc8400", "#9c5460", "#b484b4", "#c0189c"
INDIGO, SKY, TEAL, GREEN = "#6054e4", "#3090fc", "#18a884", "#3c7830"
RED, CORAL, OLIVE = "#d80018", "#fc546c", "#728a5a"
HUES = (OLIVE, AMBER, WINE, MAUVE, MAGENTA, INDIGO, SKY, TEAL, GREEN, RED, CORAL)


class Look(NamedTuple):
    """Style of one estimator in figures."""

    colour: str  #: "#rrggbb"
    dash: tuple[float, ...]  #: lengths on and off [line widths]; empty for a solid line
    marker: str  #: one of `MARKERS`

    @property
    def points(self) -> dict[str, Any]:
        """Keyword arguments of matplotlib's `plot` for a line with markers."""
        dash = (0, self.dash) if self.dash else "-"
        return {"color": self.colour, "linestyle": dash, "marker": self.marker}


FIXED = {
    "truth": Look(GREY, SOLID, "o"),
    "complementary": Look(CORAL, DASHDOT, "v"),
    "complementary-adaptive": Look(CORAL, DOTTED, "<"),
    "mahony": Look(MAGENTA, SOLID, "s"),
    "madgwick": Look(WINE, DASHED, "D"),
    "ekf": Look(SKY, SOLID, "^"),
    "eskf": Look(INDIGO, DASHED, "P"),
    "ekf-drag": Look(TEAL, SOLID, "X"),
    "imm": Look(GREEN, DASHDOT, "p"),
    "ekf-filterpy": Look(SKY, DOTTED, ">"),
    "ukf-filterpy": Look(SKY, DASHED, "h"),
    "vqf": Look(MAUVE, DASHED, "d"),
    "att-rnn": Look(AMBER, DASHDOT, "*"),
    "att-rnn-paper": Look(AMBER, DOTTED, "P"),
    "att-snn": Look(RED, DASHED, "<"),
    "att-snn-loihi": Look(RED, SOLID, "o"),
    "att-snn-paper": Look(RED, DOTTED, "D"),
}
"""Styles of shipped estimators and weights."""


def look(name: str) -> Look:
    """Return the style of an estimator, for figures with at most one estimator of the user."""
    return FIXED.get(name, Look(OLIVE, SOLID, "o"))


def looks(names: Iterable[str]) -> dict[str, Look]:
    """Return the styles of the estimators in one figure; they do not depend on the order of the names.

    A user's estimators have hues that are not used otherwise in the figure, olive first. If there are no more
    hues, they differ in dash and marker.
    """
    shown = list(dict.fromkeys(names))
    taken = {look(name).colour for name in shown if name in FIXED}
    free = [hue for hue in HUES if hue not in taken]
    styles = zip(DASHES, MARKERS, strict=False)
    own = sorted(name for name in shown if name not in FIXED)
    drawn = dict(zip(own, cycle(Look(hue, *style) for style in styles for hue in free), strict=False))
    return {name: drawn.get(name) or look(name) for name in shown}
