"""Every estimator has one look, and no two are mixed up, with colour vision or without.

Colour difference: CIEDE2000. Colour blindness: Machado, Oliveira & Fernandes, "A physiologically-based model
for simulation of color vision deficiency", IEEE TVCG 15 (2009), severity 1.0. Contrast: WCAG 2.2, 1.4.11.
"""

import re
from importlib.resources import files
from itertools import combinations

import pytest
from matplotlib.lines import Line2D

from estimators import names
from estimators.appearance import DASHES, FIXED, HUES, MARKERS, look, looks
from estimators.networks.weights_file import shipped_names

Color = pytest.importorskip("coloraide").Color
FAR = 10.0
"""ΔE00 that is seen at a glance; 1 is just noticed side by side."""
CONTRAST = 3.0
OWN = [f"mine:Filter{k}" for k in range(len(DASHES))]
EVERY = [*looks([*FIXED, *OWN]).values()]


def difference(one, other, vision="normal"):
    """ΔE00 of two "#rrggbb" as they look."""
    seen = (Color(each) for each in (one, other))
    if vision != "normal":
        seen = (each.filter(vision, 1.0, method="machado").clip() for each in seen)
    return next(seen).delta_e(next(seen), method="2000")


def far(one, other):
    return all(difference(one, other, vision) >= FAR for vision in ("normal", "protan", "deutan"))


def backgrounds():
    """What the reports' charts are drawn on, in both themes."""
    css = (files("scenarios") / "report" / "report.css").read_text(encoding="utf-8")
    return sorted(set(re.findall(r"--card: (#[0-9a-f]{6})", css)))


def test_every_name_and_shipped_weights_have_a_look_of_their_own():
    assert set(FIXED) <= {*names(), *shipped_names()}
    assert len({*looks([*names(), *shipped_names()]).values()}) == len({*names(), *shipped_names()})
    assert len(set(EVERY)) == len(EVERY)


def test_no_two_hues_are_mixed_up_with_any_colour_vision():
    for one, other in combinations([*HUES, look("truth").colour], 2):
        assert far(one, other), (one, other)


def test_two_looks_differ_in_hue_or_in_dash_and_marker():
    for one, other in combinations(EVERY, 2):
        apart = one.dash != other.dash and one.marker != other.marker
        assert apart or far(one.colour, other.colour), (one, other)


def test_every_colour_shows_on_white_and_on_the_dark_theme():
    assert "#ffffff" in backgrounds()
    assert len(backgrounds()) > 1
    for colour in {each.colour for each in EVERY}:
        for background in ("#ffffff", *backgrounds()):
            assert Color(colour).contrast(background) >= CONTRAST, (colour, background)


def test_the_truth_is_grey():
    assert difference(look("truth").colour, "#7b7b7b") < FAR / 2
    assert not any(each.colour == look("truth").colour for name, each in FIXED.items() if name != "truth")


def test_the_network_on_the_chip_looks_like_its_floats_but_for_dash_and_marker():
    floats, chip = look("att-snn"), look("att-snn-loihi")
    assert floats.colour == chip.colour
    assert floats.dash != chip.dash
    assert floats.marker != chip.marker


def test_a_users_estimators_have_hues_that_no_other_in_the_figure_has_while_there_are_such():
    few = looks(["mine:Filter", "runs/a/weights.safetensors", "runs/b/weights.safetensors", "mahony", "ekf"])
    assert len({each.colour for each in few.values()}) == len(few)
    assert few["mine:Filter"] == look("mine:Filter")
    assert looks([*reversed(OWN), *FIXED]) == looks([*FIXED, *OWN])
    many = [f"mine:{k}" for k in range(len(HUES) * len(DASHES) + 1)]
    assert len(set(looks(many).values())) == len(many) - 1
    assert not any(each.colour == look("mine:Filter").colour for each in FIXED.values())


def test_matplotlib_and_the_browser_draw_every_dash_and_marker():
    shapes = (files("scenarios") / "report" / "js" / "markers.js").read_text(encoding="utf-8")
    assert set(re.findall(r'^  "?(.)"?: "M', shapes, re.MULTILINE)) == set(MARKERS)
    for each in EVERY:
        line = Line2D([0], [0], **each.points)
        assert (line.get_color(), line.get_marker()) == (each.colour, each.marker)
        assert line.is_dashed() == bool(each.dash)
    assert len(set(DASHES)) == len(DASHES)
