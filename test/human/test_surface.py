"""Surface points: they cover the whole body, move with it, and are the same every time."""

from __future__ import annotations

import numpy as np
import pytest
from human_distance import distances_m
from scipy.spatial import cKDTree

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel


@pytest.fixture(scope="module")
def human() -> HumanModel:
    return HumanModel.kinect12()


@pytest.fixture(scope="module")
def posture() -> np.ndarray:
    return np.array([0.1, -1.8, 0.76, 1.4, 0.1, 0.05, 0.0, 1.2, 0.3, -0.2, 0.1, 0.6])


def test_points_lie_on_the_body(human: HumanModel, posture: np.ndarray) -> None:
    points = human.surface_points(posture, 0.02)
    assert distances_m(human, posture, points).max() < 1e-9  # on a body, or inside another one


def test_no_place_on_the_outside_is_farther_than_the_spacing(human: HumanModel, posture: np.ndarray) -> None:
    cloud = np.random.default_rng(0).uniform(-1.2, 1.2, (60_000, 3)) + posture[:3]
    for _ in range(4):  # walk down the distance to the surface
        step = 1e-5
        d = distances_m(human, posture, cloud)
        slope = np.stack([(distances_m(human, posture, cloud + step * e) - d) / step for e in np.eye(3)], axis=1)
        cloud = cloud - d[:, None] * slope
    outside = cloud[np.abs(distances_m(human, posture, cloud)) < 1e-4]
    assert len(outside) > 20_000
    gap = cKDTree(human.surface_points(posture, 0.02)).query(outside)[0]
    assert gap.max() <= 0.02


def test_every_body_is_sampled(human: HumanModel) -> None:
    surface = human.surface(0.02)
    assert {human.link_names[i] for i in surface.link} == {body.link for body in human.bodies}
    assert len(surface.link) == len(surface.local_m) == sum(len(b.shape.sample(0.02)) for b in human.bodies)


def test_points_move_with_their_links(human: HumanModel, posture: np.ndarray) -> None:
    q = np.stack([posture, posture + np.eye(12)[11] * 0.3, posture + np.eye(12)[0]])
    points, surface = human.surface_points(q, 0.05), human.surface(0.05)
    assert points.shape == (3, len(surface.link), 3)
    poses = human.link_poses(q)[:, surface.link]
    want = np.einsum("tpij,pj->tpi", poses[..., :3, :3], surface.local_m) + poses[..., :3, 3]
    np.testing.assert_allclose(points, want, atol=1e-12)
    beyond_elbow = np.isin([human.link_names[i] for i in surface.link], ["right_forearm", "right_wrist"])
    moved = np.abs(points[1] - points[0]).max(axis=1) > 1e-6
    np.testing.assert_array_equal(moved, beyond_elbow)
    np.testing.assert_allclose(points[2] - points[0], [[1.0, 0, 0]] * len(surface.link), atol=1e-12)


def test_sampling_is_deterministic_and_shared(human: HumanModel) -> None:
    again = HumanModel.kinect12().surface(0.02)
    np.testing.assert_array_equal(again.local_m, human.surface(0.02).local_m)
    assert human.surface(0.02) is human.surface(0.02)
    with pytest.raises(ValueError, match="read-only"):
        again.local_m[0, 0] = 1.0


def test_finer_points_find_few_voxels_that_the_standard_spacing_misses(human: HumanModel, posture: np.ndarray) -> None:
    grid = VoxelGrid((-2, -3, -0.4), 0.05, (80, 80, 48))  # P1's
    coarse, fine = (grid.mask_of(human.surface_points(posture, spacing)) for spacing in (0.02, 0.004))
    assert (fine & coarse).sum() / fine.sum() > 0.9
    assert (coarse & ~fine).sum() < 0.03 * fine.sum()


@pytest.mark.parametrize("spacing", [0.0, -0.1, float("nan")])
def test_spacings_that_are_no_lengths_are_refused(human: HumanModel, spacing: float) -> None:
    with pytest.raises(HumanModelError, match="positive spacing"):
        human.surface(spacing)
