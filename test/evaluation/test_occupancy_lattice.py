"""The grid around a library has P1's size and holds its people; the region is what they sweep."""

from __future__ import annotations

import numpy as np
import pytest
from paths import shared_data
from small_library import small_library

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.occupancy_runs import grid_around, swept_region
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary, placed, turn_and_shift
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser

HUMAN = HumanModel.kinect12()


def moved(library: MotionLibrary, x: float, y: float, yaw: float = 0.0) -> MotionLibrary:
    T = turn_and_shift(yaw, (x, y, 0.0))
    return MotionLibrary("moved", tuple(placed(motion, T) for motion in library))


def test_p1s_size_with_the_person_in_the_middle() -> None:
    library = moved(small_library(), 7.0, -3.0, 2.0)
    grid = grid_around(library, HUMAN)
    assert grid.shape == (80, 80, 48)
    assert grid.resolution_m == 0.05
    middle = np.add(grid.origin_m, [2.0, 2.0, 1.2])
    assert np.abs(middle[:2] - [7.0, -3.0]).max() < 0.6
    np.testing.assert_allclose(np.array(grid.origin_m) / 0.05, np.round(np.array(grid.origin_m) / 0.05), atol=1e-9)
    for motion in library:
        assert (grid.flat_index(HUMAN.surface_points(motion.q, 0.05)) >= 0).all()


@pytest.mark.parametrize("name", ["library_a", "library_b"])
def test_the_papers_people_fit(name: str) -> None:
    library = load_library(shared_data(f"iros2013/{name}"))
    grid = grid_around(library, HUMAN)
    inside = [bool((grid.flat_index(HUMAN.surface_points(motion.q[::20], 0.1)) >= 0).all()) for motion in library]
    assert sum(inside) >= len(library) - 1  # library_b has one that leaves the room


def test_other_resolutions_fill_the_same_box() -> None:
    assert grid_around(small_library(), HUMAN, 0.1).shape == (40, 40, 24)
    for resolution in (0.0, -1.0, 3.0, np.nan):
        with pytest.raises(UsageError, match="voxels"):
            grid_around(small_library(), HUMAN, resolution)


def test_people_all_over_the_place_need_a_larger_grid() -> None:
    library = small_library(2, 3)
    apart = tuple(placed(motion, turn_and_shift(0.0, (5.0 * (k % 2), 0.0, 0.0))) for k, motion in enumerate(library))
    with pytest.raises(UsageError, match="extends over"):
        grid_around(MotionLibrary("apart", apart), HUMAN)


def test_the_region_is_the_union_with_its_margin() -> None:
    library = small_library(2, 2, 10)
    voxeliser = BodyVoxeliser(HUMAN, grid_around(library, HUMAN), np.eye(4))
    bare = swept_region(library, voxeliser, 0)
    np.testing.assert_array_equal(bare, np.any([voxeliser.mask(motion.q) for motion in library], axis=0))
    wide = swept_region(library, voxeliser, 2)
    assert (wide | ~bare).all()
    shifted = np.roll(bare, 2, axis=0) | np.roll(bare, -2, axis=2)
    assert (wide | ~shifted).all()
    assert wide.sum() < 4 * bare.sum()
    far = BodyVoxeliser(HUMAN, VoxelGrid((50.0, 0.0, 0.0), 0.05, (4, 4, 4)), np.eye(4))
    with pytest.raises(UsageError, match="outside"):
        swept_region(library, far, 2)
