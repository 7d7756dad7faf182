"""The field agrees with the exact shapes as well as its resolution allows, and never flatters from outside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.distance_field import SignedDistanceField, build_distance_field
from humanpred_ros.geometry.solids import Box, Obstacle, cylinder, planar_pose

OBSTACLES = (
    Obstacle("slab", Box(0.8, 0.5, 0.2), planar_pose(0.1, 0.0, 0.0, 0.3)),
    Obstacle("cup", cylinder(0.06, 0.2), planar_pose(0.0, 0.1, 0.2)),
)
LOWER, UPPER = np.array([-0.6, -0.5, -0.4]), np.array([0.7, 0.6, 0.6])
RESOLUTION_M = 0.04
FIELD = build_distance_field(OBSTACLES, LOWER, UPPER, RESOLUTION_M)
SEED = st.integers(0, 10_000)


def exact(points: np.ndarray) -> np.ndarray:
    return np.min([obstacle.distance_m(points) for obstacle in OBSTACLES], axis=0)


@given(SEED)
def test_interpolated_and_nearest_distance_stay_within_their_bounds(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(LOWER, UPPER, (500, 3))
    reach = RESOLUTION_M * np.sqrt(3.0) / 2.0
    assert np.abs(FIELD.distance(points) - exact(points)).max() <= reach + 1e-6
    assert np.abs(FIELD.nearest(points) - exact(points)).max() <= reach + 1e-6


def test_interpolation_is_far_better_than_its_bound_near_smooth_surfaces() -> None:
    points = np.random.default_rng(0).uniform(LOWER, UPPER, (5000, 3))
    near = np.abs(exact(points) - 0.1) < 0.05
    assert np.sqrt(np.mean((FIELD.distance(points) - exact(points))[near] ** 2)) < 0.04 * RESOLUTION_M


def test_nodes_hold_the_exact_distance() -> None:
    node = np.array([3, 7, 11])
    point = FIELD.origin_m + RESOLUTION_M * node
    assert FIELD.distance(point) == pytest.approx(exact(point), abs=1e-6)
    assert FIELD.nearest(point) == pytest.approx(exact(point), abs=1e-6)


def test_halving_the_resolution_makes_the_worst_error_smaller() -> None:
    points = np.random.default_rng(1).uniform(LOWER, UPPER, (2000, 3))
    fine = build_distance_field(OBSTACLES, LOWER, UPPER, RESOLUTION_M / 2)
    worst = [np.abs(field.distance(points) - exact(points)).max() for field in (FIELD, fine)]
    assert worst[1] < 0.7 * worst[0]


def test_inside_is_negative_and_the_region_has_a_border() -> None:
    assert FIELD.distance(np.array([0.1, 0.0, 0.0])) == pytest.approx(-0.1, abs=RESOLUTION_M)
    assert (FIELD.origin_m <= LOWER - RESOLUTION_M).all()
    assert (FIELD.upper_m >= UPPER + RESOLUTION_M - 1e-9).all()
    assert FIELD.values.dtype == np.float32
    assert FIELD.values.flags.c_contiguous


@given(SEED)
def test_outside_the_grid_clearance_is_never_overstated(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-5.0, 5.0, (200, 3))
    outside = ((points < FIELD.origin_m) | (points > FIELD.upper_m)).any(axis=1)
    excess = FIELD.distance(points) - exact(points)
    assert excess[outside].max() <= RESOLUTION_M * np.sqrt(3.0) / 2.0 + 1e-6


def test_the_same_request_gives_the_same_field() -> None:
    again = build_distance_field(OBSTACLES, LOWER, UPPER, RESOLUTION_M)
    np.testing.assert_array_equal(again.values, FIELD.values)


def test_meaningless_requests_are_refused() -> None:
    with pytest.raises(ArrayError, match="at least one obstacle"):
        build_distance_field((), LOWER, UPPER)
    with pytest.raises(ArrayError, match="lower < upper"):
        build_distance_field(OBSTACLES, UPPER, LOWER)
    with pytest.raises(ArrayError, match="resolution"):
        build_distance_field(OBSTACLES, LOWER, UPPER, 0.0)
    with pytest.raises(ArrayError, match="resolution"):
        SignedDistanceField(np.zeros(3), np.nan, np.zeros((2, 2, 2), dtype=np.float32))
    with pytest.raises(ArrayError, match="finite values"):
        SignedDistanceField(np.zeros(3), 0.1, np.full((2, 2, 2), np.inf, dtype=np.float32))
    with pytest.raises(ArrayError, match="2 x 2 x 2"):
        SignedDistanceField(np.zeros(3), 0.1, np.zeros((1, 4, 4), dtype=np.float32))
    with pytest.raises(ArrayError, match="finite points"):
        FIELD.distance(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ArrayError, match="points"):
        FIELD.nearest(np.zeros((4, 2)))


@pytest.mark.parametrize("cap_m", [0.05, 0.3, 10.0])
def test_a_cap_cuts_off_what_is_far_and_changes_nothing_near(cap_m: float) -> None:
    capped = build_distance_field(OBSTACLES, LOWER, UPPER, RESOLUTION_M, cap_m)
    np.testing.assert_array_equal(capped.values, np.minimum(FIELD.values, np.float32(cap_m)))
    with pytest.raises(ArrayError, match="cap"):
        build_distance_field(OBSTACLES, LOWER, UPPER, RESOLUTION_M, -cap_m)
