"""Ways out of the person's way: they begin where the arm is, are free, and end where nobody is likely to come."""

from __future__ import annotations

import numpy as np
import pytest
from planning_worlds import PLANE, field_around, free_space, planar_arm, somebody_at

from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.waiting import ways_aside
from humanpred_ros.robot.goals import Goal

ARM = planar_arm()
HERE = np.array([0.2, 0.3, 0.3])
KNOWN = np.array([[2.4, 0.0, 0.0]])
CONFIG = ReplannerConfig(threads=1, human_margin_m=0.0)


def ways(occupancy: Occupancy, field: SignedDistanceField | None = None, count: int = 6) -> list[np.ndarray]:
    problem = Replanner(ARM, (Goal("far", KNOWN[0]),), field or free_space(), CONFIG).problem
    person, (_, human) = problem.person(occupancy), problem.planner(occupancy)
    return list(ways_aside(problem, person, human, HERE, KNOWN, np.random.default_rng(0), count))


def gap(occupancy: Occupancy, q: np.ndarray) -> float:
    problem = Replanner(ARM, (Goal("far", KNOWN[0]),), free_space(), CONFIG).problem
    return float(problem.person(occupancy).likely_gap_m(q[None])[0])


def test_they_lead_out_of_the_persons_way_cheapest_first() -> None:
    tip = ARM.chain.link_poses(HERE)[-1, :3, 3]
    comes = somebody_at(tip[0], tip[1], radius_m=0.15)
    found = ways(comes)
    assert len(found) == 6
    for path in found:
        assert path.shape == (CONFIG.stomp.waypoints, 3)
        np.testing.assert_array_equal(path[0], HERE)
        assert gap(comes, path[-1]) >= CONFIG.min_separation_m > gap(comes, HERE)
    # Near places come first: nobody needs to go to the other side.
    assert np.abs(found[0][-1] - HERE).max() < np.abs(KNOWN[0] - HERE).max()
    again = ways(comes)
    assert all(np.array_equal(one, other) for one, other in zip(found, again, strict=True))
    assert len(ways(comes, count=2)) == 2


def test_they_do_not_lead_through_obstacles() -> None:
    tip = ARM.chain.link_poses(HERE)[-1, :3, 3]
    comes = somebody_at(tip[0], tip[1], radius_m=0.15)
    x, y = np.meshgrid(np.arange(50) * 0.05 - 1.25, np.arange(50) * 0.05 - 1.25, indexing="ij")
    occupied = np.zeros((50, 50, 50), dtype=np.bool_)
    occupied[(y < -0.15) & (x > -1.2)] = True  # nothing is free on the right
    for path in ways(comes, field_around(occupied, (-1.25, -1.25, -1.25), 0.05)):
        spheres = ARM.spheres().world_m(ARM.chain, path)
        assert spheres[..., 1].min() > -0.2


def test_where_nowhere_is_better_there_is_no_way() -> None:
    everywhere = Occupancy(PLANE, np.full(PLANE.shape, 0.5, dtype=np.float32))
    assert ways(everywhere) == []


@pytest.mark.parametrize("separation_m", [0.0, 0.05])
def test_with_nobody_there_nothing_is_better(separation_m: float) -> None:
    nobody = Occupancy(PLANE, np.zeros(PLANE.shape, dtype=np.float32))
    problem = Replanner(
        ARM, (Goal("far", KNOWN[0]),), free_space(), CONFIG.replaced(min_separation_m=separation_m)
    ).problem
    _, human = problem.planner(nobody)
    assert list(ways_aside(problem, problem.person(nobody), human, HERE, KNOWN, np.random.default_rng(0))) == []
