"""The distance between arm and person is the human model's, from every sphere, at every moment."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from small_library import REST

from humanpred_ros.errors import ArrayError, HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.robot.separation import SeparationMeter

HUMAN = HumanModel.kinect12()


@cache
def scene() -> Scene:
    return load_scene("side_by_side")


def moments(count: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Postures (T, 12) of people around the tool, and configurations (T, 7) around the start."""
    rng = np.random.default_rng(seed)
    postures = np.repeat(REST[None], count, axis=0)
    tool = scene().arm.chain.tool_pose(scene().start)[:2, 3]
    postures[:, :2] = tool - scene().T_world_human[:2, 3] + rng.uniform(-0.9, 0.9, (count, 2))
    postures[:, 3] = rng.uniform(-3.0, 3.0, count)
    return postures, scene().start + rng.uniform(-0.4, 0.4, (count, 7))


def meter(postures: FloatArray) -> SeparationMeter:
    return SeparationMeter(scene().arm, HUMAN, scene().T_world_human, postures)


def test_is_the_models_distance() -> None:
    postures, q = moments(12)
    found = meter(postures).measure(q)
    spheres, T = scene().arm.spheres(), scene().T_world_human
    for k in range(len(q)):
        local = (spheres.world_m(scene().arm.chain, q[k]) - T[:3, 3]) @ T[:3, :3]
        assert found.distance_m[k] == pytest.approx(HUMAN.least_distance_m(postures[k], local, spheres.radius_m))
    assert found.least_m == found.distance_m.min()
    assert found.distance_m.min() < 0.0 < found.distance_m.max()


def test_names_the_parts_that_are_closest() -> None:
    postures, q = moments(6, seed=1)
    found = meter(postures).measure(q)
    spheres, T = scene().arm.spheres(), scene().T_world_human
    poses = HUMAN.body_poses(postures)
    for k in range(len(q)):
        centre = spheres.world_m(scene().arm.chain, q[k])[found.part[k]]
        pose = T @ poses[k, found.body[k]]
        local = (centre - pose[:3, 3]) @ pose[:3, :3]
        alone = HUMAN.bodies[int(found.body[k])].shape.distance_m(local[None])[0] - spheres.radius_m[found.part[k]]
        assert alone == pytest.approx(found.distance_m[k])


def test_spheres_are_never_farther_than_the_surface() -> None:
    postures, q = moments(30, seed=2)
    spheres, surface = meter(postures).measure(q), meter(postures).measure_surface(q)
    assert (spheres.distance_m <= surface.distance_m + 1e-9).all()


def test_wrong_shapes_are_refused() -> None:
    postures, q = moments(4)
    with pytest.raises(ArrayError, match="arm configurations"):
        meter(postures).measure(q[:3])
    with pytest.raises(HumanModelError):
        meter(postures[:, :5])
