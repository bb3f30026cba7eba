"""One colour, dash and marker per estimator, the same in every figure, page and report.

The hues are distinct for normal sight, protanopia and deuteranopia, and show on white and on the reports'
dark background; tests/estimators/test_appearance.py has the measures. Estimators that share a hue differ in
dash and in marker.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple
from zlib import crc32

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
