"""Swept volumes: the voxels of the body's points, no others, and as many as published."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from paths import shared_data
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, HumanModelError, UsageError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.swept_volume import BodyVoxeliser, SweptVolumeConfig, swept_volume

HUMAN = HumanModel.kinect12()
#: P1's environment box and voxels (facts 3).
GRID = VoxelGrid((-2.0, -3.0, -0.4), 0.05, (80, 80, 48))


def placement(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T


@pytest.mark.parametrize("T", [placement(), placement(0.1, -0.5, 0.15, 0.7), placement(1.9, -2.8, 0.9, 3.0)])
def test_voxels_are_those_of_the_surface_points(T: np.ndarray) -> None:
    """Also with half the body outside the grid, where indices must not wrap around."""
    q = small_library(1, 1, 30).motions[0].q
    points = HUMAN.surface_points(q, 0.02) @ T[:3, :3].T + T[:3, 3]
    swept = swept_volume(BodyVoxeliser(HUMAN, GRID, T), q)
    expected = GRID.mask_of(points)
    assert swept.sum() > 0
    # The two compute in another order; a point on a voxel's face may fall to either side.
    assert (swept != expected).sum() <= 2


def test_more_postures_sweep_no_less() -> None:
    q = small_library(1, 1, 60).motions[0].q
    voxeliser = BodyVoxeliser(HUMAN, GRID, placement())
    coarse = swept_volume(voxeliser, q, SweptVolumeConfig(n_postures=4))
    fine = swept_volume(voxeliser, q)
    each = np.any([voxeliser.mask(posture) for posture in q], axis=0)
    np.testing.assert_array_equal(fine, each)
    assert (fine | ~coarse).all()
    assert coarse.sum() < fine.sum()


def test_moving_the_human_by_whole_voxels_moves_the_volume() -> None:
    here = BodyVoxeliser(HUMAN, GRID, placement()).mask(REST)
    there = BodyVoxeliser(HUMAN, GRID, placement(0.05 * 7, -0.05 * 3, 0.0)).mask(REST)
    assert (np.roll(here, (7, -3, 0), axis=(0, 1, 2)) != there).sum() <= 2


def test_a_human_outside_the_grid_touches_nothing() -> None:
    assert not BodyVoxeliser(HUMAN, GRID, placement(50.0)).mask(REST).any()


def test_sizes_are_the_published_ones() -> None:
    """Voxels of the authors' regressed motions without legs and left arm (facts 3: 1424 to 2891)."""
    urdf = ET.fromstring(HUMAN.urdf)
    for link in urdf.findall("link"):
        name = link.get("name", "")
        if name.startswith("left_") or name.endswith(("hip", "knee", "foot")):
            for body in [*link.findall("collision"), *link.findall("collision_checking")]:
                link.remove(body)
    upper_right = HumanModel(ET.tostring(urdf, encoding="unicode"))
    voxeliser = BodyVoxeliser(upper_right, GRID, placement(0.10, 0.50, 0.15))
    published = (1424, 1309, 1606, 2100, 1995, 1776, 2266, 2891)
    for label, expected in enumerate(published):
        file = shared_data("iros2013/reference/authors_regressed") / f"class_{label}.csv"
        q = np.loadtxt(file, delimiter=",", skiprows=1)[:, 1:]
        assert swept_volume(voxeliser, q).sum() == pytest.approx(expected, rel=0.03)
        kept = swept_volume(voxeliser, q, SweptVolumeConfig(n_postures=10)).sum()
        assert 0.88 < kept / expected < 0.99


@pytest.mark.parametrize(
    "T",
    [np.eye(3), 2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan), np.eye(4)[[0, 1, 2, 0]]],
)
def test_placements_that_are_not_rigid_are_refused(T: np.ndarray) -> None:
    with pytest.raises(ArrayError, match="T_world_human"):
        BodyVoxeliser(HUMAN, GRID, T)


def test_postures_and_settings_are_checked() -> None:
    voxeliser = BodyVoxeliser(HUMAN, GRID, placement())
    for q in (np.zeros(11), np.full(12, np.nan)):
        with pytest.raises(HumanModelError):
            voxeliser.mask(q)
    for settings in ({"spacing_m": 0.0}, {"n_postures": 0}):
        with pytest.raises(UsageError):
            SweptVolumeConfig(**settings)
