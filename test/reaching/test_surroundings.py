"""Distances to table and partner are those of their shapes."""

from __future__ import annotations

import numpy as np
import pytest
from reaching_people import MODEL, PARTNER, START

from humanpred_ros.errors import ArrayError, HumanModelError, SceneError
from humanpred_ros.geometry.solids import Capsule
from humanpred_ros.reaching.cost_terms import MOVING_BODIES
from humanpred_ros.reaching.surroundings import CAP_M, BodyCapsules, Surroundings
from humanpred_ros.robot.scene import load_scene

SCENE = Surroundings.of_p2()


def test_distances_to_a_capsule_are_exact_at_nodes_up_to_the_cap() -> None:
    scene = Surroundings.empty()
    ends = np.array([[[1.5, 1.0, 1.0], [1.7, 1.1, 1.4]]])
    field = scene.field_with(ends, [0.1])
    rng = np.random.default_rng(0)
    node = rng.integers(field.values.shape, size=(2000, 3))
    place = field.origin_m + field.resolution_m * node
    a, b = ends[0]
    share = np.clip((place - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    wanted = np.linalg.norm(place - a - share[:, None] * (b - a), axis=1) - 0.1
    np.testing.assert_allclose(field.values[tuple(node.T)], np.minimum(wanted, CAP_M), atol=2e-6)
    assert (wanted < 0.0).any()
    assert (wanted > CAP_M).any()


def test_partner_lowers_distances_and_leaves_the_scene_alone() -> None:
    before = SCENE.field.values.copy()
    capsules = BodyCapsules.of(MODEL)
    field = SCENE.field_with(capsules.placed(MODEL, PARTNER), capsules.radius_m)
    assert (field.values <= SCENE.field.values).all()
    assert (field.values < SCENE.field.values).any()
    np.testing.assert_array_equal(SCENE.field.values, before)


def test_table_stands_where_p2_has_it() -> None:
    # The centre of the left box, in the table's frame and in that of the recordings (docs/papers.md, P2 scene).
    c, s = np.cos(np.deg2rad(166.572)), np.sin(np.deg2rad(166.572))
    x, y = 1.84 + c * 0.325 - s * -0.14, 1.41 + s * 0.325 + c * -0.14
    middle, above = SCENE.field.distance(np.array([[x, y, 0.85], [x, y, 0.70 + 0.295 + 0.10]]))
    assert middle < -0.05
    assert above == pytest.approx(0.10, abs=0.01)


def test_scene_without_anything_is_far_from_everything() -> None:
    assert (Surroundings.empty().field.values == np.float32(CAP_M)).all()


def test_capsules_cover_what_is_a_capsule_exactly() -> None:
    exact = [body.name for body in MODEL.bodies if isinstance(body.shape, Capsule)]
    capsules = BodyCapsules.of(MODEL, exact)
    ends = capsules.placed(MODEL, START)
    poses = dict(zip([body.name for body in MODEL.bodies], MODEL.body_poses(START), strict=True))
    for k, body in enumerate(body for body in MODEL.bodies if body.name in exact):
        assert isinstance(body.shape, Capsule)
        half = np.array([0.0, 0.0, body.shape.length_m / 2.0, 0.0])
        T = poses[body.name]
        wanted = np.stack([T @ (np.eye(4)[3] - half), T @ (np.eye(4)[3] + half)])[:, :3]
        np.testing.assert_allclose(ends[k], wanted, atol=1e-12)
        assert capsules.radius_m[k] == body.shape.radius_m


def test_capsules_of_trunk_are_close_to_its_solids() -> None:
    capsules = BodyCapsules.of(MODEL, ("torso", "shoulders"))
    ends = capsules.placed(MODEL, START)
    poses = dict(zip([body.name for body in MODEL.bodies], MODEL.body_poses(START), strict=True))
    solids = [body for body in MODEL.bodies if body.name in ("torso", "shoulders")]
    for body, (a, b), radius in zip(solids, ends, capsules.radius_m, strict=True):
        surface = body.shape.sample(0.02) @ poses[body.name][:3, :3].T + poses[body.name][:3, 3]
        share = np.clip((surface - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        off = np.linalg.norm(surface - a - share[:, None] * (b - a), axis=1) - radius
        assert abs(float(np.median(off))) < 0.025
        assert off.max() < 0.09  # corners and rims


def test_bad_input_is_refused() -> None:
    with pytest.raises(HumanModelError, match="capsules"):
        BodyCapsules.of(MODEL, ("tail",))
    with pytest.raises(SceneError, match="region"):
        Surroundings((), np.ones(3), np.zeros(3))
    with pytest.raises(SceneError, match="ends"):
        SCENE.field_with(np.zeros((1, 3)), [0.1])
    assert len(BodyCapsules.of(MODEL, MOVING_BODIES).links) == len(MOVING_BODIES)


def test_the_obstacles_of_a_robots_scene_are_moved_to_where_the_person_sees_them() -> None:
    scene = load_scene("face_to_face")
    here = Surroundings.of_obstacles(scene.obstacles, np.linalg.inv(scene.T_world_human))
    assert [obstacle.name for obstacle in here.obstacles] == [obstacle.name for obstacle in scene.obstacles]
    points = np.array([[0.0, -0.7, 0.75], [0.2, -0.8, 0.9], [-0.6, -0.5, 0.6]])
    moved = points @ np.linalg.inv(scene.T_world_human)[:3, :3].T + np.linalg.inv(scene.T_world_human)[:3, 3]
    for world, tracker in zip(scene.obstacles, here.obstacles, strict=True):
        np.testing.assert_allclose(tracker.distance_m(moved), world.distance_m(points), atol=1e-9)
    assert (here.lower_m < moved.min(axis=0)).all()
    assert (here.upper_m > moved.max(axis=0)).all()
    assert not Surroundings.of_obstacles((), np.eye(4)).obstacles
    with pytest.raises(ArrayError):
        Surroundings.of_obstacles(scene.obstacles, np.zeros((3, 3)))


def test_the_table_stands_where_hands_are() -> None:
    at_the_table = np.array([[1.8, 1.2, 1.0], [5.0, 5.0, 1.0]])
    assert Surroundings.around_hands(at_the_table) is Surroundings.of_p2()
    elsewhere = Surroundings.around_hands(at_the_table + np.array([10.0, -3.0, 0.0]))
    assert elsewhere.obstacles == ()
    assert (elsewhere.lower_m < [11.8, -1.8, 1.0]).all()
    assert (elsewhere.upper_m > [15.0, 2.0, 1.0]).all()
    # There a partner is seen, as at the table.
    beside = np.array([[[11.8, -1.8, 0.8], [11.8, -1.8, 1.2]]])
    assert elsewhere.field_with(beside, [0.1]).values.min() < 0.0 < elsewhere.field.values.min()
    with pytest.raises(SceneError, match="positions of hands"):
        Surroundings.around_hands(np.zeros((0, 3)))
