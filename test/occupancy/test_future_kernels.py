"""The forecast's inner loops against plain NumPy: shares kept exactly, ways followed, bits counted."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import convolve
from small_library import REST, small_library

from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy import future_kernels as kernels
from humanpred_ros.occupancy.future_kernels import NEVER_CERTAIN
from humanpred_ros.occupancy.futures import BodyParts, RecordedFutures
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.forest import Exemplars
from humanpred_ros.recognition.reach_features import N_FEATURES

HUMAN = HumanModel.kinect12()
PARTS = BodyParts.of(HUMAN, 0.02, 1)
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
SMALL = (5, 4, 3)


@cache
def motions() -> np.ndarray:
    """(2, 40, D) one reach of each of two classes, without noise from frame to frame."""
    library = small_library(2, 1, 40, there_and_back=True)
    return np.array([REST + (m.q - REST).round(2) for m in library])


@cache
def futures() -> RecordedFutures:
    q = motions()
    exemplars = Exemplars(
        ("0/0", "1/0"),
        np.array([0, 1]),
        np.array([0, 40, 80]),
        q.reshape(80, -1),
        np.zeros((80, N_FEATURES), dtype=np.float32),
        np.zeros((2, 3)),
        np.ones(2),
    )
    return RecordedFutures.of(exemplars, HUMAN, PARTS, 0.01)


def followed(
    chosen: list[int], now: np.ndarray, grid: VoxelGrid = GRID, kept: float = 1.0, fade: float = 0.2
) -> np.ndarray:
    """Return (F, X, Y, Z) what each future touches."""
    T = np.eye(4)
    T[:3, 3] -= grid.origin_m
    T[:3] /= grid.resolution_m
    low, high = PARTS.corners_m[:, 0], PARTS.corners_m[:, -1]
    balls = np.column_stack([(low + high) / 2, np.linalg.norm(high - low, axis=1) / 2])
    touched = np.zeros(grid.size + 1, dtype=np.uint32)
    poses = np.ascontiguousarray(HUMAN.link_poses(now)[PARTS.link, :3])
    kernels.follow(
        np.array(chosen), poses, futures().ways, kept, fade, T, PARTS.points, PARTS.first, balls, grid.shape, touched
    )
    return np.array([(touched[:-1] >> i & 1).astype(bool).reshape(grid.shape) for i in range(len(chosen))])


@settings(max_examples=200)
@given(
    weight=arrays(np.float64, 30, elements=st.one_of(st.just(0.0), st.floats(1e-6, 1.0))).filter(lambda w: w.sum() > 0),
    label=arrays(np.int64, 30, elements=st.integers(0, 4)),
    n_futures=st.integers(1, 32),
    least_share=st.sampled_from([0.0, 0.01, 0.3]),
)
def test_drawn_futures_keep_the_classes_shares(
    weight: np.ndarray, label: np.ndarray, n_futures: int, least_share: float
) -> None:
    chosen, probability = kernels.draw(weight, label, 5, n_futures, least_share)
    assert len(chosen) == len(probability) == n_futures
    assert (weight[chosen] > 0).all()
    assert probability.sum() == pytest.approx(1.0)
    share = np.bincount(label, weight, minlength=5) / weight.sum()
    drawn = np.bincount(label[chosen], probability, minlength=5)
    among = drawn > 0
    np.testing.assert_allclose(drawn[among], share[among] / share[among].sum())
    # A class is missing because it is too improbable, or because more probable ones took all futures.
    wanted = share >= max(min(least_share, share.max()), 1e-12)
    assert not (among & ~wanted).any()
    if wanted.sum() <= n_futures:
        np.testing.assert_array_equal(among, wanted)
    else:
        assert share[among].min() >= share[wanted & ~among].max() - 1e-12
    again, _ = kernels.draw(weight * 8.0, label, 5, n_futures, least_share)
    np.testing.assert_array_equal(again, chosen)


def test_drawn_as_often_as_they_weigh() -> None:
    weight = np.array([1.0, 3.0, 0.0, 4.0])
    chosen, probability = kernels.draw(weight, np.zeros(4, dtype=np.int64), 1, 32, 0.01)
    np.testing.assert_array_equal(np.bincount(chosen, minlength=4), [4, 12, 0, 16])
    np.testing.assert_allclose(probability, 1 / 32)


def test_nothing_is_drawn_from_nothing() -> None:
    chosen, probability = kernels.draw(np.zeros(4), np.zeros(4, dtype=np.int64), 1, 8, 0.01)
    assert len(chosen) == len(probability) == 0


@pytest.mark.parametrize("start", [0, 15, 30])
def test_who_is_the_exemplar_goes_as_it_went(start: int) -> None:
    q = motions()
    found = followed([start, 40 + start], q[0, start])[0]
    fine = np.concatenate([np.linspace(a, b, 5) for a, b in zip(q[0, start:-1], q[0, start + 1 :], strict=True)])
    whole = BodyVoxeliser(HUMAN, GRID, np.eye(4)).mask(fine)
    # Every twentieth of a voxel or so a pose is kept; rounding may put a point into the next voxel.
    assert (found & ~whole).sum() <= 2
    missed = whole & ~found & ~BodyVoxeliser(HUMAN, GRID, np.eye(4)).mask(q[0, start])
    assert missed.sum() <= 0.04 * whole.sum()


def test_nothing_follows_the_end() -> None:
    assert not followed([39], motions()[0, 39]).any()


def test_a_lasting_difference_moves_the_future_by_as_much() -> None:
    q = motions()[0, 10]
    aside = q + np.array([0.10, -0.05, *np.zeros(10)])
    here, there = followed([10], q), followed([10], aside)
    assert (np.roll(here, (2, -1), axis=(1, 2)) != there).sum() <= 0.002 * here.sum()


def test_a_fading_difference_ends_at_the_recorded_place() -> None:
    q = motions()[0, 10]
    aside = q + np.array([0.10, *np.zeros(11)])
    last = BodyVoxeliser(HUMAN, GRID, np.eye(4)).mask(motions()[0, -1])
    found = followed([10], aside, kept=0.0, fade=0.01)[0]
    assert (last & ~found).sum() <= 0.01 * last.sum()


def test_what_leaves_the_grid_is_cut_off() -> None:
    inner = VoxelGrid((-0.2, -0.3, 0.2), 0.05, (12, 14, 16))
    now = motions()[1, 5]
    whole = followed([7, 45], now)
    i, j, k = (round((a - b) / 0.05) for a, b in zip(inner.origin_m, GRID.origin_m, strict=True))
    expected = whole[:, i : i + 12, j : j + 14, k : k + 16]
    assert expected.any()
    assert (followed([7, 45], now, inner) != expected).sum() <= 2
    assert not followed([7], now, VoxelGrid((50.0, 0.0, 0.0), 0.05, (4, 4, 4))).any()


@settings(max_examples=50)
@given(
    bits=arrays(np.uint32, SMALL),
    now=arrays(np.bool_, SMALL),
    probability=arrays(np.float64, st.integers(1, 32), elements=st.floats(0.0, 1.0)).filter(lambda p: p.sum() > 0.01),
    spread=st.floats(0.0, 1.0),
)
def test_bits_are_counted_and_spread(bits: np.ndarray, now: np.ndarray, probability: np.ndarray, spread: float) -> None:
    probability = probability / probability.sum()
    share = np.zeros(tuple(n + 2 for n in SMALL), dtype=np.float32)
    out = np.zeros(SMALL, dtype=np.float32)
    touched = np.append(bits.ravel() & np.uint32(2 ** len(probability) - 1), np.uint32(7))
    each = (touched[:-1, None] >> np.arange(len(probability)) & 1).reshape(*SMALL, -1)
    busy = np.zeros(tuple(n + 2 for n in SMALL[:2]), dtype=np.bool_)
    kernels.add_share(touched, probability, share, busy)
    kernels.add_body(now, share, busy)
    kernels.spread_out(share, busy, now, spread, out)
    expected = np.where(now, 1.0, each @ probability)
    beside = np.zeros((3, 3, 3))
    beside[[0, 2, 1, 1, 1, 1], [1, 1, 0, 2, 1, 1], [1, 1, 1, 1, 0, 2]] = spread / 6
    beside[1, 1, 1] = 1 - spread
    # Only where the body is now is it certain.
    expected = np.where(now, 1.0, np.minimum(convolve(expected, beside, mode="constant"), NEVER_CERTAIN))
    np.testing.assert_allclose(out, expected, atol=1e-6)
    assert np.array_equal(out == 1.0, now)
    assert not touched.any()
    assert not share.any()
    assert not busy.any()
