"""Reconnecting: the robot has moved on, and the old path is joined where that pays (P1 V-C)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning_worlds import field_around, nobody, planar_arm, somebody_at

from humanpred_ros.errors import PlanningError
from humanpred_ros.planning.path import path_parameter, reconnect, straight
from humanpred_ros.stomp.costs import CostTerm, HumanOccupancyCost, ObstacleCost

ARM = planar_arm()
WEIGHTS = np.array([0.9, 0.6, 0.3])
FREE = HumanOccupancyCost(ARM.chain, ARM.body_points(), nobody())


class Never(CostTerm):
    """Forbids everything on one side of a joint angle."""

    def __init__(self, above: float) -> None:
        super().__init__("never", 1.0)
        self.above = above

    def evaluate(self, q: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        return np.zeros(q.shape[:2], dtype=np.float32), q[..., 0] <= self.above


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), step=st.floats(0.005, 0.3))
def test_it_begins_at_the_robot_and_ends_at_the_goal(seed: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    old = rng.normal(0.0, 0.1, (40, 3)).cumsum(axis=0)
    q = rng.normal(size=3)
    joined = reconnect(q, old, [FREE], FREE, WEIGHTS, step, 50)
    assert joined.path.shape == (50, 3)
    assert np.array_equal(joined.path[0], q)
    assert np.array_equal(joined.path[-1], old[-1])
    assert 0.0 <= joined.parameter <= path_parameter(old, WEIGHTS)[-1] + 1e-12


def test_where_nothing_costs_a_detour_is_cut_off_entirely() -> None:
    detour = np.concatenate([straight([0, 0, 0], [0.5, 0.8, 0], 30), straight([0.5, 0.8, 0], [1, 0, 0], 30)])
    joined = reconnect(detour[5], detour, [FREE], FREE, WEIGHTS, 0.01, 40)
    assert joined.kind == "cheaper"
    assert joined.parameter == pytest.approx(path_parameter(detour, WEIGHTS)[-1])
    np.testing.assert_allclose(joined.path, straight(detour[5], detour[-1], 40), atol=1e-9)


def test_a_detour_round_a_person_is_kept() -> None:
    # Turning the first joint sweeps the stretched arm through the person; the old path folds it first.
    person = HumanOccupancyCost(ARM.chain, ARM.body_points(), somebody_at(0.45, 0.65, radius_m=0.3))
    a, b = np.array([0.0, 0.0, 0.0]), np.array([1.9, 0.0, 0.0])
    folded = np.array([0.0, 2.5, 0.5])
    corners = np.array([a, folded, folded + np.array([1.9, 0.0, 0.0]), b])
    detour = np.concatenate([straight(p, r, 40) for p, r in pairwise(corners)])
    joined = reconnect(detour[4], detour, [person], person, WEIGHTS, 0.02, 100)
    direct = person.costs(straight(detour[4], b, 100)[None]).sum()
    assert person.costs(joined.path[None]).sum() < 0.5 * direct
    assert joined.parameter < path_parameter(detour, WEIGHTS)[-1]


def test_if_no_segment_pays_the_closest_place_is_taken() -> None:
    old = straight([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 50)
    aside = np.array([-0.3, 0.0, 0.0])  # every way back is longer than what it replaces
    joined = reconnect(aside, old, [FREE], FREE, WEIGHTS, 0.01, 30)
    assert joined.kind == "closest"
    assert joined.parameter == 0.0


def test_segments_through_something_forbidden_are_not_taken() -> None:
    wall = Never(above=0.5)
    over = np.concatenate([straight([0, 0, 0], [0.4, 0.5, 0], 30), straight([0.4, 0.5, 0], [1.0, 0.5, 0], 30)])
    joined = reconnect(over[2], over, [FREE, wall], FREE, WEIGHTS, 0.01, 60)
    assert joined.kind in ("cheaper", "closest")
    landing = np.argmin(np.abs(path_parameter(over, WEIGHTS) - joined.parameter))
    assert over[landing, 0] <= 0.52
    everything = Never(above=-9.0)
    assert reconnect(over[2], over, [FREE, everything], FREE, WEIGHTS, 0.01, 60).kind == "blocked"


def test_obstacles_count() -> None:
    occupied = np.zeros((50, 50, 50), dtype=np.bool_)
    occupied[35:40, 35:40, 15:35] = True  # x and y from 0.5 to 0.7 m
    obstacle = ObstacleCost(ARM.chain, ARM.spheres(), field_around(occupied, (-1.25, -1.25, -1.25), 0.05))
    corners = np.array([[-0.4, 0.0, 0.0], [-0.4, -2.4, 0.0], [1.9, -2.4, 0.0], [2.9, 0.0, 0.0]])
    detour = np.concatenate([straight(p, r, 40) for p, r in pairwise(corners)])
    direct = straight(detour[3], detour[-1], 120)
    assert obstacle.valid(detour[None]).all()
    assert not obstacle.valid(direct[None]).all()
    joined = reconnect(detour[3], detour, [FREE, obstacle], FREE, WEIGHTS, 0.02, 120)
    assert obstacle.valid(joined.path[None]).all()
    assert joined.parameter < path_parameter(detour, WEIGHTS)[-1]


def test_what_does_not_fit_is_refused() -> None:
    old = straight([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 5)
    with pytest.raises(PlanningError, match="reconnect"):
        reconnect([0.0, 0.0], old, [FREE], FREE, WEIGHTS)
    with pytest.raises(PlanningError, match="step > 0"):
        reconnect([0.0, 0.0, 0.0], old, [FREE], FREE, WEIGHTS, step=0.0)
