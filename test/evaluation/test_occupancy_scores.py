"""Scores of voxel probabilities: known values, agreement with scikit-learn, comparability; and the lattice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from paths import shared_data
from sklearn.metrics import average_precision_score, brier_score_loss
from sklearn.metrics import log_loss as sklearn_log_loss
from small_library import small_library

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.evaluation.occupancy_scores import (
    BIN_EDGES,
    LOG_CLIP,
    calibration,
    grid_around,
    reliability,
    swept_region,
    voxel_scores,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary, placed, turn_and_shift
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser

HUMAN = HumanModel.kinect12()


@st.composite
def predictions(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Return probabilities, many of them equal, and truths."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = draw(st.integers(2, 300))
    p = np.round(rng.random(n), draw(st.integers(0, 3)))
    y = rng.random(n) < draw(st.sampled_from([0.05, 0.5, 0.95]))
    return p, y


def scored(p: ArrayLike, y: ArrayLike) -> dict[str, float]:
    """Return the scores where every voxel counts."""
    return voxel_scores(p, y, np.ones(len(np.asarray(p)), dtype=bool))


def table_of(p: ArrayLike, y: ArrayLike) -> FloatArray:
    return reliability(p, y, np.ones(len(np.asarray(p)), dtype=bool))


@settings(max_examples=100)
@given(predictions())
def test_agrees_with_scikit_learn(prediction: tuple[np.ndarray, np.ndarray]) -> None:
    p, y = prediction
    found = scored(p, y)
    assert found["brier"] == found["squared_error"] / len(p)
    assert found["brier"] == pytest.approx(brier_score_loss(y, p, labels=[False, True]))
    assert found["log_loss"] == pytest.approx(sklearn_log_loss(y, np.clip(p, *LOG_CLIP), labels=[False, True]))
    if y.any():
        assert found["average_precision"] == pytest.approx(average_precision_score(y, p))
    else:
        assert math.isnan(found["average_precision"])


@settings(max_examples=50)
@given(predictions(), st.integers(0, 2**32))
def test_the_order_of_voxels_does_not_matter(prediction: tuple[np.ndarray, np.ndarray], seed: int) -> None:
    p, y = prediction
    order = np.random.default_rng(seed).permutation(len(p))
    assert scored(p, y) == pytest.approx(scored(p[order], y[order]), nan_ok=True)


def test_known_values() -> None:
    y = np.array([True, True, False, False])
    assert scored([1.0, 0.5, 0.5, 0.0], y)["squared_error"] == 0.5
    assert scored([0.0, 0.5, 0.5, 1.0], y)["log_loss"] == pytest.approx(0.25 * -2 * (math.log(0.001) - math.log(2)))
    assert scored([0.9, 0.8, 0.1, 0.0], y)["average_precision"] == 1.0
    assert scored([0.5, 0.5, 0.5, 0.5], y)["average_precision"] == 0.5
    # A binary prediction: what it finds at its precision, the rest at the base rate.
    assert scored([1.0, 0.0, 1.0, 0.0], y)["average_precision"] == pytest.approx(0.5 * 0.5 + 0.5 * 0.5)
    assert scored([0.01, 0.0099, 0.0, 0.0], y)["missed"] == 0.5
    assert math.isnan(scored([0.1], [False])["missed"])


def test_truth_told_with_certainty_is_perfect_and_the_opposite_is_the_worst() -> None:
    y = np.random.default_rng(0).random(1000) < 0.2
    right, wrong = scored(y.astype(float), y), scored(1.0 - y, y)
    assert (right["brier"], right["average_precision"], right["missed"]) == (0.0, 1.0, 0.0)
    assert right["log_loss"] == pytest.approx(-math.log(0.999))
    assert calibration(table_of(y.astype(float), y))["error"] == 0.0
    assert (wrong["brier"], wrong["missed"]) == (1.0, 1.0)
    assert wrong["log_loss"] == pytest.approx(-math.log(0.001))
    assert calibration(table_of(1.0 - y, y))["error"] == 1.0


def test_nothing_predicted_outside_the_region_is_lost() -> None:
    rng = np.random.default_rng(1)
    p, y = np.zeros(1000), np.zeros(1000, dtype=bool)
    p[:100], y[:100] = rng.random(100), rng.random(100) < 0.5
    p[500:520] = 0.5  # outside
    y[700] = True
    narrow, wide = np.arange(1000) < 100, np.arange(1000) < 400
    a, b = voxel_scores(p, y, narrow), voxel_scores(p, y, wide)
    assert a["squared_error"] == b["squared_error"] == pytest.approx(scored(p, y)["squared_error"])
    assert a["brier"] == pytest.approx(a["squared_error"] / 100)
    assert b["brier"] == pytest.approx(b["squared_error"] / 400)
    assert a["missed"] == b["missed"] == scored(p, y)["missed"]
    assert (a["n_swept"], a["n_predicted"]) == (int(y.sum()), pytest.approx(p.sum()))
    # Ratios of Brier scores do not depend on the region.
    c, d = voxel_scores(y * 0.7, y, narrow), voxel_scores(y * 0.7, y, wide)
    assert a["brier"] / c["brier"] == pytest.approx(b["brier"] / d["brier"])


def test_reliability_puts_edges_into_the_bin_above() -> None:
    count, _, swept = table_of(list(BIN_EDGES), [False] * len(BIN_EDGES))
    assert count.tolist() == [1] * 10 + [2]
    assert swept.sum() == 0


def test_reliability_of_what_happens_as_often_as_told() -> None:
    rng = np.random.default_rng(2)
    p = rng.random(200_000)
    table = calibration(table_of(p, rng.random(len(p)) < p))
    np.testing.assert_allclose(table["observed"][1:], table["mean_probability"][1:], atol=0.015)
    assert table["error"] < 0.005
    too_sure = calibration(table_of(np.sqrt(p), rng.random(len(p)) < p))
    assert too_sure["error"] > 0.1


def test_tables_add_up() -> None:
    rng = np.random.default_rng(3)
    p, y = rng.random(500), rng.random(500) < 0.3
    np.testing.assert_allclose(table_of(p[:200], y[:200]) + table_of(p[200:], y[200:]), table_of(p, y))
    nothing = calibration(np.zeros((3, len(BIN_EDGES) - 1)))
    assert math.isnan(nothing["error"])
    assert np.isnan(nothing["observed"]).all()


def test_next_to_nothing_does_not_hide_errors_elsewhere() -> None:
    p, y = np.zeros(10_000), np.zeros(10_000, dtype=bool)
    p[:100] = 0.9
    table = calibration(table_of(p, y))
    assert table["error"] == pytest.approx(0.009)
    assert table["error_predicted"] == pytest.approx(0.9)


@pytest.mark.parametrize("p", [[0.5, 1.5], [-0.1, 0.5], [np.nan, 0.5], [0.5]])
def test_what_is_no_probability_is_refused(p: list[float]) -> None:
    for score in (voxel_scores, reliability):
        with pytest.raises(ArrayError):
            score(p, [True, False], np.array([True, True]))


def test_an_empty_region_is_refused() -> None:
    with pytest.raises(ArrayError, match="region"):
        voxel_scores([0.5], [True], np.array([False]))


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
