"""One colour, dash and marker per estimator, the same in every figure, page and report.

The hues are distinct for normal sight, protanopia and deuteranopia, and show on white and on the reports'
dark background; tests/estimators/test_appearance.py has the measures. Estimators that share a hue differ in
dash and in marker.
"""

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SOLID: tuple[float, ...] = ()
DASHED, DASHDOT, DOTTED = (5.0, 2.0), (5.0, 1.5, 1.0, 1.5), (1.0, 1.5)
LOOSE, DOUBLE = (3.0, 3.0), (5.0, 1.5, 1.0, 1.5, 1.0, 1.5)
DASHES = (SOLID, DASHED, DASHDOT, DOTTED, LOOSE, DOUBLE)
MARKERS = "osD^vP<>X*phd"
"""As matplotlib names them; the browser's are in scenarios/report/js/markers.js."""
GREY = "#757b83"
AMBER, WINE, MAUVE, MAGENTA = "#cc8400", "#9c5460", "#b484b4", "#c0189c"
INDIGO, SKY, TEAL, GREEN = "#6054e4", "#3090fc", "#18a884", "#3c7830"
RED, CORAL, OLIVE = "#d80018", "#fc546c", "#728a5a"
HUES = (AMBER, WINE, MAUVE, MAGENTA, INDIGO, SKY, TEAL, GREEN, RED, CORAL, OLIVE)


class Look(NamedTuple):
    """How one estimator is drawn."""

    colour: str  #: "#rrggbb"
    dash: tuple[float, ...]  #: lengths on and off [line widths]; empty for a solid line
    marker: str  #: one of `MARKERS`

    @property
    def line(self) -> dict[str, Any]:
        """Keywords of matplotlib's `plot` for a line."""
        return {"color": self.colour, "linestyle": (0, self.dash) if self.dash else "-"}

    @property
    def points(self) -> dict[str, Any]:
        """Keywords of matplotlib's `plot` for a line with markers."""
        return self.line | {"marker": self.marker}


FIXED = {
    "truth": Look(GREY, SOLID, "o"),
    "complementary": Look(MAUVE, DASHDOT, "v"),
    "complementary-adaptive": Look(MAUVE, DOTTED, "<"),
    "mahony": Look(MAGENTA, SOLID, "s"),
    "madgwick": Look(WINE, DASHED, "D"),
    "ekf": Look(SKY, SOLID, "^"),
    "eskf": Look(INDIGO, DASHED, "P"),
    "ekf-drag": Look(TEAL, SOLID, "X"),
    "imm": Look(GREEN, DASHDOT, "p"),
    "ekf-filterpy": Look(SKY, DOTTED, ">"),
    "ukf-filterpy": Look(SKY, DASHED, "h"),
    "vqf": Look(CORAL, DASHED, "d"),
    "att-rnn": Look(AMBER, DASHDOT, "*"),
    "att-rnn-paper": Look(AMBER, DOTTED, "P"),
    "att-snn": Look(RED, DASHED, "<"),
    "att-snn-loihi": Look(RED, SOLID, "o"),
    "att-snn-hummingbird": Look(RED, DOUBLE, "s"),
    "att-snn-paper": Look(RED, DOTTED, "D"),
}
"""Of the estimators and weights that ship."""


class End(NamedTuple):
    """The right end of a line, and what stands beside it."""

    y: float
    text: str
    colour: str


def label_ends(axes: "Axes", ends: Sequence[End], size: float = 9.0) -> None:
    """Write names beside the right ends of lines in place of a legend; names keep their distance.

    Args:
        axes: With its limits and scales set.
        ends: The lines' ends at the right limit of the axes.
        size: Of the letters [pt].
    """
    gap = 1.3 * size / (72 * axes.get_window_extent().height / axes.figure.dpi)
    at = axes.transData + axes.transAxes.inverted()
    sorted_ends = sorted(
        (end for end in ends if isfinite(end.y)), key=lambda end: at.transform((0.0, end.y))[1]
    )
    true = [float(at.transform((0.0, end.y))[1]) for end in sorted_ends]
    places = [min(max(y, 0.0), 1.0) for y in true]
    for _ in range(100 * len(places)):
        close = [k for k in range(1, len(places)) if places[k] - places[k - 1] < 0.999 * gap]
        for k in close:
            push = 0.5 * (gap - places[k] + places[k - 1])
            places[k - 1], places[k] = places[k - 1] - push, places[k] + push
        if not close:
            break
    for end, y, place in zip(sorted_ends, true, places, strict=True):
        axes.annotate(
            end.text, (1.0, y), (1.03, place), xycoords="axes fraction", textcoords="axes fraction",
            color=end.colour, fontsize=size, va="center", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": end.colour, "linewidth": 0.7, "shrinkA": 1, "shrinkB": 0},
        )  # fmt: skip


def _left(hue: str) -> list[Look]:
    """Looks of a hue whose dash and marker no estimator of that hue has."""
    taken = [look for look in FIXED.values() if look.colour == hue]
    dashes = [dash for dash in DASHES if dash not in {look.dash for look in taken}]
    markers = [marker for marker in MARKERS if marker not in {look.marker for look in taken}]
    return [Look(hue, *style) for style in zip(dashes, markers, strict=False)]


OWN = [Look(OLIVE, *style) for style in zip(DASHES, MARKERS, strict=False)]
"""Of a user's estimators and weights."""
OWN_TOO = [look for hue in HUES for look in _left(hue) if hue != OLIVE]
"""Of a user's where there are several in a figure."""


def look(name: str) -> Look:
    """How an estimator is drawn where no more than one of a user's own is in the figure.

    Args:
        name: One of `estimators.names()` or shipped weights; the look of any other depends on its name alone.
    """
    return FIXED.get(name) or _own(name)[0]


def looks(names: Iterable[str]) -> dict[str, Look]:
    """How the estimators of one figure are drawn, in any order of their names.

    A user's own after the first get hues that no other in the figure has, while there are such, then dashes
    and markers that no other of their hue has, and last a look that is not theirs alone.
    """
    shown = list(dict.fromkeys(names))
    found = {name: FIXED[name] for name in shown if name in FIXED}
    for name in sorted(set(shown) - set(found)):
        hues = {each.colour for each in found.values()}
        free = [each for each in _own(name) if each not in found.values()]
        found[name] = next(iter([each for each in free if each.colour not in hues] or free), look(name))
    return {name: found[name] for name in shown}


def _own(name: str) -> list[Look]:
    """Looks for a user's estimator, the best first."""
    k = crc32(name.encode())
    first, then = k % len(OWN), k % len(OWN_TOO)
    return [*OWN[first:], *OWN[:first], *OWN_TOO[then:], *OWN_TOO[:then]]
