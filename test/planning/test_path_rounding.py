"""Rounded-off paths, against scipy's splines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from humanpred_ros.planning.path import straight
from humanpred_ros.planning.path_following import CONTROL_POINTS, NODES, SmoothPath


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_position_and_derivatives_are_the_splines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = SmoothPath.rounding(rng.normal(size=(int(rng.integers(2, 60)), 3)).cumsum(axis=0))
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, CONTROL_POINTS - 2), np.ones(3)])
    spline = BSpline(knots, path.control, 3)
    s = np.concatenate([rng.uniform(0.0, 1.0, 200), knots, np.linspace(0.0, 1.0, NODES)])
    for k, found in enumerate(path.at(s)):
        wanted = spline(s, k)
        np.testing.assert_allclose(found, wanted, atol=1e-11 * max(1.0, float(np.abs(wanted).max())))
    nodes = path.at(np.linspace(0.0, 1.0, NODES))[1:]
    for found, wanted in zip(path.nodes(), nodes, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-9 * max(1.0, float(np.abs(wanted).max())))


def test_beyond_its_ends_a_path_stays_there() -> None:
    path = SmoothPath.rounding(straight([0.0, 1.0], [2.0, 0.0], 7))
    np.testing.assert_allclose(
        path.at(np.array([-0.5, 0.0, 1.0, 1.5]))[0], [[0, 1], [0, 1], [2, 0], [2, 0]], atol=1e-12
    )
    np.testing.assert_allclose(path.at(np.array([0.25]))[0], [[0.5, 0.75]], atol=1e-12)


@pytest.mark.parametrize("until", [0.25, 0.6, 1.0])
def test_a_path_led_aside_begins_alike_and_ends_beside(until: float) -> None:
    path = SmoothPath.rounding(np.random.default_rng(3).normal(size=(20, 2)).cumsum(axis=0))
    by = np.array([0.3, -0.1])
    aside = path.led_aside(by, until)
    start = np.array([0.0])
    for before, after in zip(path.at(start), aside.at(start), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-12)
    s = np.linspace(min(until + 0.1, 1.0), 1.0, 20)
    np.testing.assert_allclose(aside.at(s)[0], path.at(s)[0] + by, atol=1e-12)
