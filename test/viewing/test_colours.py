"""Colours are told apart by colour-blind readers, and without any by lightness, dashes or markers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing import figures
from humanpred_ros.viewing.plots_space import HUMAN, PROBABILITY, ROBOT

#: Linear RGB as seen by people without one kind of cone (Machado, Oliveira, Fernandes 2009, severity 1).
VISION = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}
XYZ = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.072175], [0.0193339, 0.119192, 0.9503041]])
#: CIE76 distances: 2.3 is just noticeable side by side.
APART, LIGHTER, CONTRAST = 8.0, 15.0, 2.2


def linear(colour: str) -> FloatArray:
    c = np.array(to_rgb(colour))
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb: FloatArray) -> FloatArray:
    xyz = XYZ @ rgb.clip(0.0, 1.0) / (XYZ @ np.ones(3))
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


NAMED = [figures._NAMED[name] for name in ("red", "blue", "green", "orange", "yellow", "purple", "black", "white")]


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("colours", [figures.SERIES, figures.CLASSES, NAMED, (HUMAN, ROBOT, figures.INK)])
def test_no_two_colours_look_alike(colours: Sequence[str], vision: str) -> None:
    seen = {colour: lab(np.array(VISION[vision]) @ linear(colour)) for colour in colours}
    for a, b in combinations(colours, 2):
        assert np.linalg.norm(seen[a] - seen[b]) >= APART, (a, b)


def test_in_grey_dashes_tell_what_lightness_does_not() -> None:
    classes = [(figures.class_style(k)["color"], figures.class_style(k)["linestyle"]) for k in range(8)]
    goals = [(colour, figures.DASHES[k % len(figures.DASHES)]) for k, colour in enumerate(figures.SERIES)]
    for styles in (classes, goals):
        for (a, dash_a), (b, dash_b) in combinations(styles, 2):
            assert dash_a != dash_b or abs(lab(linear(a))[0] - lab(linear(b))[0]) >= LIGHTER, (a, b)


def test_all_can_be_seen_on_white_and_probability_grows_darker() -> None:
    for colour in (*figures.SERIES, *figures.CLASSES, *NAMED, HUMAN, ROBOT, figures.ALARM, figures.CAUTION):
        assert 1.05 / (float(XYZ[1] @ linear(colour)) + 0.05) >= CONTRAST, colour
    lightness = [lab(linear(PROBABILITY(p)))[0] for p in np.linspace(0.0, 1.0, 20)]
    assert (np.diff(lightness) < 0.0).all()
