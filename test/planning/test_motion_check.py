"""Movements between their waypoints: what dense sampling finds is found, and little is found in vain."""

from __future__ import annotations

import numpy as np
import pytest
from arm_clearance import arm_clearance
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning_worlds import ANY, field_around, planar_arm, random_chain, random_spheres

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.chain import BodySpheres, KinematicChain
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.planning.motion_check import MotionChecker, lever_arms_m
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory, at_rest
from humanpred_ros.robot.scene import load_scene

SEEDS = st.integers(0, 2**32 - 1)
RESOLUTION_M = 0.002


def half_space(rng: np.random.Generator) -> SignedDistanceField:
    """The distance to a plane: linear, so its interpolation is exact and exactly 1-Lipschitz."""
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    nodes = np.stack(np.meshgrid(*[np.linspace(-4.0, 4.0, 9)] * 3, indexing="ij"), axis=-1)
    return SignedDistanceField(np.full(3, -4.0), 1.0, nodes @ normal + rng.uniform(-0.2, 0.5))


def wild_trajectory(rng: np.random.Generator, n_joints: int) -> TimedTrajectory:
    """Few knots, and much going on between them."""
    n = int(rng.integers(2, 7))
    q = rng.uniform(-2.0, 2.0, (1, n_joints)) + rng.normal(0.0, 0.4, (n, n_joints)).cumsum(axis=0)
    v, a = rng.normal(0.0, 2.0, (n, n_joints)), rng.normal(0.0, 8.0, (n, n_joints))
    v[-1] = a[-1] = 0.0
    return TimedTrajectory(rng.uniform(0.05, 0.4, n).cumsum(), q, v, a)


def dense(
    chain: KinematicChain, spheres: BodySpheres, field: SignedDistanceField, q: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The oracle: least clearance (T,) of configurations (T, D), in NumPy."""
    clearance: NDArray[np.float64] = (field.distance(spheres.world_m(chain, q)) - spheres.radius_m).min(axis=1)
    return clearance


@settings(max_examples=40)
@given(seed=SEEDS, n_joints=st.integers(1, 7))
def test_the_first_trouble_is_where_dense_sampling_finds_it(seed: int, n_joints: int) -> None:
    rng = np.random.default_rng(seed)
    chain, spheres, field = random_chain(rng, n_joints, ANY), random_spheres(rng, n_joints), half_space(rng)
    trajectory = wild_trajectory(rng, n_joints)
    begin, end = np.sort(rng.uniform(trajectory.start_s - 0.1, trajectory.end_s + 0.1, 2))
    t = np.linspace(max(begin, trajectory.start_s), max(end, trajectory.start_s), 1500)
    clearance = dense(chain, spheres, field, trajectory.sample(t)[0])
    padding = float(clearance.min() + rng.normal(0.0, 0.03))
    trouble = MotionChecker(chain, spheres, field, padding, resolution_m=RESOLUTION_M).first_trouble(
        trajectory, begin, end
    )
    if trouble is None:
        assert clearance.min() >= padding - 1e-5
    else:
        assert max(begin, trajectory.start_s) <= trouble.at <= t[-1]
        assert clearance[t < trouble.at].min(initial=np.inf) >= padding - RESOLUTION_M - 1e-5
        assert trouble.clearance_m <= padding + 0.5 * RESOLUTION_M
        np.testing.assert_allclose(trouble.q, trajectory.sample(trouble.at)[0], atol=1e-9)
        here = field.distance(spheres.world_m(chain, trouble.q)) - spheres.radius_m
        of_link = here[spheres.link == chain.joint_names.index(trouble.link)]
        assert np.abs(of_link - trouble.clearance_m).min() < 1e-5
    nearest = MotionChecker(chain, spheres, field, resolution_m=RESOLUTION_M).nearest(trajectory, begin, end)
    assert nearest.at_least_m - 1e-5 <= clearance.min()
    assert nearest.clearance_m - RESOLUTION_M - 1e-9 <= nearest.at_least_m <= nearest.clearance_m
    assert dense(chain, spheres, field, trajectory.sample([nearest.at])[0])[0] == pytest.approx(
        nearest.clearance_m, abs=1e-5
    )


@settings(max_examples=40)
@given(seed=SEEDS, n_joints=st.integers(1, 7))
def test_a_path_is_checked_between_its_waypoints(seed: int, n_joints: int) -> None:
    rng = np.random.default_rng(seed)
    chain, spheres, field = random_chain(rng, n_joints, ANY), random_spheres(rng, n_joints), half_space(rng)
    path = rng.uniform(-2.0, 2.0, (int(rng.integers(1, 6)), n_joints))
    s = np.linspace(0.0, len(path) - 1.0, 2000)
    before = np.minimum(s.astype(int), max(len(path) - 2, 0))
    part = (s - before)[:, None]
    q = path[before] * (1.0 - part) + path[np.minimum(before + 1, len(path) - 1)] * part
    clearance = dense(chain, spheres, field, q)
    checker = MotionChecker(chain, spheres, field, float(clearance.min()) + rng.normal(0.0, 0.03))
    trouble = checker.first_trouble(path)
    if trouble is None:
        assert clearance.min() >= checker.padding_m - 1e-5
    else:
        assert clearance[s < trouble.at].min(initial=np.inf) >= checker.padding_m - RESOLUTION_M - 1e-5
        assert trouble.clearance_m <= checker.padding_m + 0.5 * checker.resolution_m
    assert checker.nearest(path).at_least_m <= clearance.min() + 1e-5


@settings(max_examples=40)
@given(seed=SEEDS, n_joints=st.integers(1, 7))
def test_lever_arms_are_never_shorter_than_the_distance_from_the_axis(seed: int, n_joints: int) -> None:
    rng = np.random.default_rng(seed)
    chain, spheres = random_chain(rng, n_joints, ANY), random_spheres(rng, n_joints)
    q = rng.uniform(-np.pi, np.pi, (50, n_joints))
    poses, centres = chain.link_poses(q), spheres.world_m(chain, q)
    lever = lever_arms_m(chain, spheres)
    for j in range(n_joints):
        axis = poses[:, j, :3, :3] @ chain.joint_axis[j]
        away = np.linalg.norm(np.cross(centres - poses[:, None, j, :3, 3], axis[:, None]), axis=2)
        carried = spheres.link >= j
        assert (away[:, carried] <= lever[j, carried] + 1e-9).all()
        assert (lever[j, ~carried] == 0.0).all()


def wall_between(y_m: float, thickness_m: float = 0.02) -> SignedDistanceField:
    nodes = np.meshgrid(
        np.arange(-1.0, 1.0, 0.01), np.arange(-1.0, 1.0, 0.01), np.arange(-0.1, 0.11, 0.1), indexing="ij"
    )
    return SignedDistanceField(np.array([-1.0, -1.0, -0.1]), 0.01, np.abs(nodes[1] - y_m) - thickness_m / 2.0)


def test_a_thin_wall_between_two_free_waypoints_is_found() -> None:
    arm = planar_arm()
    field = wall_between(0.3)
    path = np.array([[0.0, 0.0, 0.0], [0.9, 0.0, 0.0]])
    ends = dense(arm.chain, arm.spheres(), field, np.array([[0.0, 0.0, 0.0]]))
    assert ends[0] > 0.0
    trouble = MotionChecker(arm.chain, arm.spheres(), field).first_trouble(path)
    assert trouble is not None
    assert (trouble.what, trouble.link) == ("obstacle", "three")
    # The last sphere, 0.88 m out and 0.03 m in radius, meets the wall's near face.
    assert trouble.at * 0.9 == pytest.approx(np.arcsin((0.3 - 0.01 - 0.03) / 0.88), abs=0.005)
    assert "three" in str(trouble)
    assert "obstacle" in str(trouble)


def test_an_arm_that_folds_into_itself_is_found() -> None:
    arm = planar_arm()
    far = SignedDistanceField(np.full(3, -5.0), 10.0, np.full((2, 2, 2), 9.0))

    def tip_to_base(q: NDArray[np.float64]) -> NDArray[np.float64]:
        tip: NDArray[np.float64] = np.linalg.norm(arm.spheres().world_m(arm.chain, q)[:, -1], axis=1) - 0.1
        return tip

    # Both joints fold to an equilateral triangle and out again: between its ends the tip comes to the base.
    path = np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 4.0]])
    checker = MotionChecker(arm.chain, arm.spheres(), far, 0.05, tip_to_base)
    trouble = checker.first_trouble(path)
    assert trouble is not None
    assert (trouble.what, trouble.link) == ("self", "")
    s = np.linspace(0.0, 1.0, 4000)
    clearance = tip_to_base(path[0] + s[:, None] * (path[1] - path[0]))
    assert trouble.at == pytest.approx(s[np.argmax(clearance < 0.05)], abs=0.01)
    assert MotionChecker(arm.chain, arm.spheres(), far, 0.05).first_trouble(path) is None
    least = float(clearance.min())
    assert MotionChecker(arm.chain, arm.spheres(), far, least - 0.004, tip_to_base).first_trouble(path) is None


def test_the_earlier_of_two_troubles_is_told() -> None:
    arm = planar_arm()

    def bent(q: NDArray[np.float64]) -> NDArray[np.float64]:
        return 1.0 - np.abs(q[:, 0]) / 0.9

    path = np.array([[0.0, 0.0, 0.0], [0.9, 0.0, 0.0]])
    wall = MotionChecker(arm.chain, arm.spheres(), wall_between(0.3)).first_trouble(path)
    assert wall is not None
    for padding, first in ((1.02 - wall.at, "self"), (0.98 - wall.at, "obstacle")):
        checker = MotionChecker(arm.chain, arm.spheres(), wall_between(0.3), 0.0, lambda q, p=padding: bent(q) - p)
        trouble = checker.first_trouble(path)
        assert trouble is not None
        assert trouble.what == first


def test_a_part_of_a_trajectory_is_checked_alone() -> None:
    arm = planar_arm()
    trajectory = time_parameterise(straight([0.0, 0.0, 0.0], [0.9, 0.0, 0.0], 20), 1.0, 3.0, start_s=5.0)
    checker = MotionChecker(arm.chain, arm.spheres(), wall_between(0.3))
    trouble = checker.first_trouble(trajectory)
    assert trouble is not None
    assert 5.0 < trouble.at < trajectory.end_s
    assert checker.first_trouble(trajectory, end_s=trouble.at - 0.02) is None
    assert checker.first_trouble(trajectory, trouble.at, trouble.at + 0.01) is not None
    # From the end on the arm rests there, with the wall across it; at the start it is free.
    assert checker.first_trouble(trajectory, 100.0, 200.0) is not None
    assert checker.first_trouble(trajectory, 1.0, 2.0) is None
    assert checker.first_trouble(at_rest([0.0, 0.0, 0.0], 1.0)) is None


def test_a_field_that_holds_nothing_but_the_arm_outside_it() -> None:
    arm = planar_arm()
    field = field_around(np.pad(np.ones((2, 2, 2), dtype=np.bool_), 3), (2.0, 2.0, 2.0), 0.05)
    path = np.array([[0.0, 0.0, 0.0], [0.9, 0.0, 0.0]])
    assert MotionChecker(arm.chain, arm.spheres(), field).first_trouble(path) is None


def test_the_scene_of_the_paper() -> None:
    """Going straight, the gripper sweeps through the cup; the check agrees with `arm_clearance`."""
    scene = load_scene("side_by_side")
    arm, spheres, field = scene.arm, scene.arm.spheres(), scene.distance_field()
    trajectory = time_parameterise(
        straight(scene.start, scene.goal("red").configuration, 60), 0.5 * arm.chain.velocity_limit, 4.0
    )
    t = np.linspace(0.0, trajectory.end_s, 2000)
    clearance = arm_clearance(arm, spheres, field, trajectory.sample(t)[0])
    checker = MotionChecker(arm.chain, spheres, field)
    trouble, nearest = checker.first_trouble(trajectory), checker.nearest(trajectory)
    assert trouble is not None
    assert trouble.at == pytest.approx(t[np.argmax(clearance < 0.0)], abs=0.005)
    assert nearest.clearance_m == pytest.approx(clearance.min(), abs=0.001)
    other = checker.against(field, padding_m=-0.1, what="person", self_clearance=None)
    assert other.first_trouble(trajectory) is None
    assert other.what == "person"


def test_what_makes_no_sense_is_refused() -> None:
    arm, field = planar_arm(), wall_between(0.3)
    with pytest.raises(PlanningError, match="padding"):
        MotionChecker(arm.chain, arm.spheres(), field, np.nan)
    with pytest.raises(PlanningError, match="resolution"):
        MotionChecker(arm.chain, arm.spheres(), field, resolution_m=0.0)
    with pytest.raises(PlanningError, match="spheres"):
        MotionChecker(arm.chain, BodySpheres([4], [[0.0, 0.0, 0.0]], [0.1]), field)
    checker = MotionChecker(arm.chain, arm.spheres(), field)
    with pytest.raises(PlanningError, match="joints"):
        checker.first_trouble(at_rest([0.0], 0.0))
    with pytest.raises(PlanningError, match="begin"):
        checker.first_trouble(at_rest([0.0, 0.0, 0.0], 0.0), np.nan)
    for path in (np.zeros((0, 3)), np.zeros((2, 2)), np.full((2, 3), np.nan)):
        with pytest.raises(PlanningError, match="path"):
            checker.first_trouble(path)
