"""Voxels of a body: the compiled kernels give what plain arithmetic gives, bit for bit, in every form they offer."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from small_library import REST, small_library

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import turn_and_shift
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 61, 48))
#: In the middle, turned, half out through two faces, and far away.
PLACEMENTS = [
    np.eye(4),
    turn_and_shift(0.7, (0.1, -0.5, 0.15)),
    turn_and_shift(3.0, (1.45, -1.4, -0.9)),
    turn_and_shift(0.0, (500.0, 0.0, 0.0)),
]


def plain_mask(q: FloatArray, T_world_human: FloatArray, spacing_m: float = 0.02) -> np.ndarray:
    """Return what the kernel should: the same sums in the same order, by NumPy."""
    T = T_world_human.copy()
    T[:3, 3] -= GRID.origin_m
    T[:3] /= GRID.resolution_m
    T[:3, 3] += 1.0
    surface = HUMAN.surface(spacing_m)
    local = surface.local_m
    padded = np.zeros(tuple(n + 2 for n in GRID.shape), dtype=bool)
    for poses in HUMAN.link_poses(np.atleast_2d(q)):
        B = poses[surface.link]  # (P, 4, 4)
        cell = []
        for a in range(3):
            M = [T[a, 0] * B[:, 0, b] + T[a, 1] * B[:, 1, b] + T[a, 2] * B[:, 2, b] + T[a, 3] * B[:, 3, b]
                 for b in range(4)]  # fmt: skip
            place = M[0] * local[:, 0] + M[1] * local[:, 1] + M[2] * local[:, 2] + M[3]
            cell.append(np.clip(np.floor(place), 0, padded.shape[a] - 1).astype(int))
        padded[tuple(cell)] = True
    return padded[1:-1, 1:-1, 1:-1]


def random_posture(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    span = np.where(HUMAN.upper - HUMAN.lower > 6.0, np.pi, 0.4)
    posture: FloatArray = REST + rng.uniform(-1.0, 1.0, len(REST)) * np.where(np.arange(len(REST)) < 3, 1.0, span)
    return posture


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), which=st.integers(0, len(PLACEMENTS) - 1))
def test_equals_plain_arithmetic_bit_for_bit(seed: int, which: int) -> None:
    q, T = random_posture(seed), PLACEMENTS[which]
    np.testing.assert_array_equal(BodyVoxeliser(HUMAN, GRID, T).mask(q), plain_mask(q, T))


@pytest.mark.parametrize("spacing_m", [0.02, 0.005])
def test_also_when_a_link_has_many_points(spacing_m: float) -> None:
    mask = BodyVoxeliser(HUMAN, GRID, np.eye(4), spacing_m).mask(REST)
    np.testing.assert_array_equal(mask, plain_mask(REST, np.eye(4), spacing_m))


@settings(max_examples=10)
@given(q=arrays(np.float64, (3, 12), elements=st.floats(-1e300, 1e300)))
def test_no_posture_is_too_far_away(q: np.ndarray) -> None:
    voxeliser = BodyVoxeliser(HUMAN, GRID, np.eye(4))
    assert voxeliser.mask(q).shape == GRID.shape


@pytest.mark.parametrize("T", PLACEMENTS)
def test_all_forms_agree(T: np.ndarray) -> None:
    motion = small_library(1, 1, 300).motions[0]
    voxeliser = BodyVoxeliser(HUMAN, GRID, T)
    masks = np.array([voxeliser.mask(q) for q in motion.q])
    np.testing.assert_array_equal(voxeliser.mask(motion.q), masks.any(axis=0))
    last = voxeliser.last_touch(motion.q)
    for t in (0, 1, 150, 299):
        np.testing.assert_array_equal(last >= t, masks[t:].any(axis=0))


def test_what_is_no_posture_is_refused() -> None:
    with pytest.raises(HumanModelError):
        BodyVoxeliser(HUMAN, GRID, np.eye(4)).last_touch(np.full((2, 12), np.nan))


def test_threads_do_not_disturb_each_other() -> None:
    voxeliser = BodyVoxeliser(HUMAN, GRID, np.eye(4))
    motions = [motion.q for motion in small_library(3, 4, 20)] * 4
    alone = [voxeliser.mask(q) for q in motions]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda q: voxeliser.mask(q), motions))
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a, b)


def test_travels_between_processes() -> None:
    voxeliser = BodyVoxeliser(HUMAN, GRID, PLACEMENTS[1])
    copy = pickle.loads(pickle.dumps(voxeliser))
    np.testing.assert_array_equal(copy.mask(REST), voxeliser.mask(REST))
