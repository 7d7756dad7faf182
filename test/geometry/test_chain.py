"""The chain's arithmetic on arms simple enough to know the answer, and what it refuses."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain

pytestmark = pytest.mark.core

ANGLE = st.floats(-np.pi, np.pi)


def planar_arm(**changes: Any) -> KinematicChain:
    """Two links of 1 m and 0.5 m in the xy plane, both joints about z."""
    parts: dict[str, Any] = {
        "joint_names": ("first", "second"),
        "joint_origin_m": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        "joint_rotation": [np.eye(3)] * 2,
        "joint_axis": [[0.0, 0.0, 1.0]] * 2,
        "T_world_root": np.eye(4),
        "T_last_tool": [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        "lower": [-1.0, -np.inf],
        "upper": [1.0, np.inf],
        "continuous": [False, True],
        "velocity_limit": [1.0, 2.0],
    }
    return KinematicChain(**{**parts, **changes})


@given(ANGLE, ANGLE)
def test_planar_arm_reaches_where_trigonometry_says(a: float, b: float) -> None:
    tool = planar_arm().tool_pose([a, b])
    expected = [np.cos(a) + 0.5 * np.cos(a + b), np.sin(a) + 0.5 * np.sin(a + b), 0.0]
    np.testing.assert_allclose(tool[:3, 3], expected, atol=1e-12)


def test_batch_of_configurations_gives_the_same_as_one_by_one(rng: np.random.Generator) -> None:
    chain, q = planar_arm(), rng.uniform(-3, 3, (4, 5, 2))
    poses = chain.link_poses(q)
    assert poses.shape == (4, 5, 2, 4, 4)
    np.testing.assert_array_equal(poses[2, 3], chain.link_poses(q[2, 3]))
    assert chain.tool_pose(q).shape == (4, 5, 4, 4)


def test_fixed_rotation_acts_before_the_joint(rng: np.random.Generator) -> None:
    quarter = Rotation.from_euler("x", np.pi / 2).as_matrix()
    chain = planar_arm(joint_rotation=[np.eye(3), quarter])
    # The second joint's z axis points along -y of the first link, so turning it lifts the tool out of the plane.
    np.testing.assert_allclose(chain.tool_pose([0.0, np.pi / 2])[:3, 3], [1.0, 0.0, 0.5], atol=1e-12)


def test_points_and_spheres_move_with_their_link() -> None:
    chain = planar_arm()
    points = BodyPoints([0, 1], [[0.5, 0.0, 0.0], [0.25, 0.0, 0.0]])
    world = points.world_m(chain, [[np.pi / 2, 0.0], [0.0, np.pi / 2]])
    np.testing.assert_allclose(world[0], [[0.0, 0.5, 0.0], [0.0, 1.25, 0.0]], atol=1e-12)
    np.testing.assert_allclose(world[1], [[0.5, 0.0, 0.0], [1.0, 0.25, 0.0]], atol=1e-12)
    spheres = BodySpheres(points.link, points.local_m, [0.1, 0.2])
    np.testing.assert_array_equal(spheres.world_m(chain, [0.3, 0.4]), points.world_m(chain, [0.3, 0.4]))
    assert len(points) == len(spheres) == 2


def test_arrays_cannot_be_changed_afterwards() -> None:
    chain = planar_arm()
    for field in fields(chain):
        value = getattr(chain, field.name)
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value.flat[0] = 7


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joint_names": ()}, "at least one joint"),
        ({"joint_origin_m": [[0.0, 0.0, 0.0]]}, r"\(2, 3\)"),
        ({"joint_axis": [[0.0, 0.0, 2.0], [0.0, 0.0, 1.0]]}, "unit"),
        ({"joint_rotation": [np.eye(3), -np.eye(3)]}, "rotation"),
        ({"T_world_root": np.full((4, 4), np.nan)}, "finite"),
        ({"lower": [2.0, -np.inf]}, "lower < upper"),
        ({"continuous": [True, True]}, "inf"),
        ({"continuous": [True]}, "shape"),
        ({"velocity_limit": [0.0, 1.0]}, "positive"),
    ],
)
def test_impossible_chains_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ArrayError, match=words):
        planar_arm(**changes)


@pytest.mark.parametrize("q", [0.0, [1.0], [1.0, 2.0, 3.0], np.zeros((2, 3))])
def test_configurations_of_another_length_are_refused(q: Any) -> None:
    with pytest.raises(ArrayError, match="2 angles"):
        planar_arm().link_poses(q)


def test_bad_points_and_spheres_are_refused() -> None:
    with pytest.raises(ArrayError, match="joint index"):
        BodyPoints([-1], [[0.0, 0.0, 0.0]])
    with pytest.raises(ArrayError, match="shape"):
        BodyPoints([0, 1], [[0.0, 0.0, 0.0]])
    with pytest.raises(ArrayError, match="positive"):
        BodySpheres([0], [[0.0, 0.0, 0.0]], [0.0])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)
