"""Every estimator has one look, and no two are mixed up, with colour vision or without.

Colour difference: CIEDE2000, Sharma, Wu & Dalal, "The CIEDE2000 color-difference formula: implementation
notes, supplementary test data, and mathematical observations", Color Research & Application 30 (2005). Colour
blindness: Machado, Oliveira & Fernandes, "A physiologically-based model for simulation of color vision
deficiency", IEEE TVCG 15 (2009), severity 1.0. Contrast: WCAG 2.2, 1.4.11.
"""

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest
from matplotlib.lines import Line2D

from estimators import names
from estimators.appearance import DASHES, FIXED, HUES, MARKERS, look, looks
from estimators.networks.weights_file import shipped_names

FAR = 10.0
"""ΔE00 that is seen at a glance; 1 is just noticed side by side."""
CONTRAST = 3.0
OWN = [f"mine:Filter{k}" for k in range(len(DASHES))]
EVERY = [*looks([*FIXED, *OWN]).values()]
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
}
"""Linear sRGB as it looks."""
SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
SHARMA = (
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, 0, 0), (50, -1, 2), 2.3669),
    ((50, -0.001, 2.49), (50, 0.0009, -2.49), 4.8045),
    ((50, 2.5, 0), (56, -27, -3), 31.9030),
    ((63.0109, -31.0961, -5.8663), (62.8187, -29.7946, -4.0864), 1.2630),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
)
"""Pairs of L*a*b*, and their ΔE00, from Table 1 of Sharma, Wu & Dalal."""


def linear(colour):
    """Linear sRGB (3,) of "#rrggbb"."""
    c = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    """L*a*b* of linear sRGB, with the white of the display."""
    t = (SRGB_TO_XYZ @ rgb) / (SRGB_TO_XYZ @ np.ones(3))
    x, y, z = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def ciede2000(one, other):
    """ΔE00 of two L*a*b*; the numbers are those of the equations of Sharma, Wu & Dalal."""
    (L1, a1, b1), (L2, a2, b2) = one, other
    mean7 = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    stretch = 1 + 0.5 * (1 - np.sqrt(mean7 / (mean7 + 25**7)))  # (4), (5)
    C1, C2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, stretch * a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + 180) % 360 - 180 if C1 * C2 else 0.0  # (10)
    dH = 2 * np.sqrt(C1 * C2) * np.sin(np.radians(turn) / 2)
    L, C = (L1 + L2) / 2, (C1 + C2) / 2
    h = h1 + turn / 2 if C1 * C2 else h1 + h2  # (14)

    def cos(degrees):
        return np.cos(np.radians(degrees))

    T = 1 - 0.17 * cos(h - 30) + 0.24 * cos(2 * h) + 0.32 * cos(3 * h + 6) - 0.20 * cos(4 * h - 63)
    S_L = 1 + 0.015 * (L - 50) ** 2 / np.sqrt(20 + (L - 50) ** 2)
    S_C, S_H = 1 + 0.045 * C, 1 + 0.015 * C * T
    theta = 30 * np.exp(-(((h % 360 - 275) / 25) ** 2))
    R_T = -2 * np.sqrt(C**7 / (C**7 + 25**7)) * np.sin(np.radians(2 * theta))
    l, c, s = (L2 - L1) / S_L, (C2 - C1) / S_C, dH / S_H  # noqa: E741  # as in the paper
    return np.sqrt(l**2 + c**2 + s**2 + R_T * c * s)


def difference(one, other, vision):
    """ΔE00 of two "#rrggbb" as they look."""
    return ciede2000(*(lab(np.clip(VISION[vision] @ linear(each), 0, 1)) for each in (one, other)))


def far(one, other):
    return all(difference(one, other, vision) >= FAR for vision in VISION)


def contrast(one, other):
    """WCAG's contrast ratio of two "#rrggbb"."""
    dark, light = sorted(SRGB_TO_XYZ[1] @ linear(each) for each in (one, other))
    return (light + 0.05) / (dark + 0.05)


def backgrounds():
    """What the reports' charts are drawn on, in both themes."""
    css = (files("scenarios") / "report" / "report.css").read_text(encoding="utf-8")
    return sorted(set(re.findall(r"--card: (#[0-9a-f]{6})", css)))


@pytest.mark.parametrize(("one", "other", "expected"), SHARMA)
def test_the_colour_difference_is_the_published_one(one, other, expected):
    assert ciede2000(one, other) == pytest.approx(expected, abs=1e-4)
    assert ciede2000(other, one) == pytest.approx(expected, abs=1e-4)


def test_colour_blindness_mixes_up_red_and_green_and_leaves_grey():
    red, green = "#a05000", "#508c00"
    assert difference(red, green, "normal") > 4 * difference(red, green, "deuteranopia")
    for matrix in VISION.values():
        np.testing.assert_allclose(matrix @ np.ones(3), 1.0, atol=1e-5)


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
            assert contrast(colour, background) >= CONTRAST, (colour, background)


def test_the_truth_is_grey():
    assert difference(look("truth").colour, "#7b7b7b", "normal") < FAR / 2
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
