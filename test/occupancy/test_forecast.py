"""The default predictor: certain of the present, calibrated about what is to come, wherever the person stands."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import shared_data
from scipy.ndimage import binary_dilation
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, MotionError, SettingsError, UsageError
from humanpred_ros.evaluation.occupancy_scores import calibration, grid_around, reliability
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, placed, turn_and_shift
from humanpred_ros.occupancy.forecast import ForecastPredictor, ForecastSettings
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier

pytestmark = pytest.mark.core

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
BODY = BodyVoxeliser(HUMAN, GRID, np.eye(4))
N_FRAMES = 60


@cache
def fitted() -> ForestClassifier:
    return ForestClassifier(HUMAN, ForestSettings(n_trees=40)).fit(small_library(3, 10, N_FRAMES, there_and_back=True))


def predictor(grid: VoxelGrid = GRID, T_world_human: FloatArray | None = None, **changes: float) -> ForecastPredictor:
    forest = fitted().fresh()
    T = np.eye(4) if T_world_human is None else T_world_human
    return ForecastPredictor(forest, grid, T, settings=ForecastSettings(**changes))


def unseen(label: int = 1, seed: int = 99) -> Motion:
    return small_library(3, 1, N_FRAMES, there_and_back=True, seed=seed).motions[label]


def shown(p: ForecastPredictor, motion: Motion, n: int) -> np.ndarray:
    """Return the probabilities after n postures."""
    p.start()
    for k in range(n):
        prediction = p.update(motion.q[k], float(motion.t_s[k]))
    return prediction.occupancy.probability


def squared_error(p: np.ndarray, swept: np.ndarray) -> float:
    return float(((p.astype(np.float64) - swept) ** 2).sum())


@settings(max_examples=15)
@given(label=st.integers(0, 2), seed=st.integers(0, 1000), n=st.integers(1, N_FRAMES), futures=st.integers(1, 32))
def test_the_body_is_where_it_is_and_the_rest_are_probabilities(label: int, seed: int, n: int, futures: int) -> None:
    motion = unseen(label, seed)
    p = shown(predictor(n_futures=futures), motion, n)
    assert p.dtype == np.float32
    assert p.min() >= 0.0
    assert p.max() == 1.0
    assert (p[BODY.mask(motion.q[n - 1])] == 1.0).all()


@pytest.mark.parametrize("label", [0, 1, 2])
def test_better_than_the_present_alone_and_nothing_important_is_missed(label: int) -> None:
    motion = unseen(label)
    for n in (6, 20, 30, 45):
        p, swept = shown(predictor(), motion, n), BODY.mask(motion.q[n - 1 :])
        assert squared_error(p, swept) < 0.6 * squared_error(BODY.mask(motion.q[n - 1]), swept)
        assert (p[swept] < 0.01).mean() < 0.03


def test_what_is_over_is_not_predicted_any_more() -> None:
    motion = unseen(1)
    p = predictor()
    apex = BODY.mask(motion.q[30]) & ~binary_dilation(BODY.mask(motion.q[[0, -1]]), iterations=2)
    assert apex.sum() > 50
    assert shown(p, motion, 20)[apex].mean() > 0.6
    late = shown(p, motion, N_FRAMES - 1)
    assert late[apex].max() == 0.0
    assert late.sum() < 1.3 * BODY.mask(motion.q[-1]).sum()


def test_class_left_open_warns_of_all_places() -> None:
    """Before anything has happened each class' goal gets about its probability."""
    p = shown(predictor(), unseen(0), 3)
    for label in range(3):
        motion = unseen(label)
        wrist = np.zeros(GRID.size, dtype=bool)
        wrist[GRID.flat_index(HUMAN.forward(motion.q[30:31])["right_wrist"])] = True
        reached = binary_dilation(wrist.reshape(GRID.shape))
        assert 0.05 < p[reached].mean() < 0.9


def test_start_forgets_and_refused_postures_leave_no_trace() -> None:
    motion = unseen(2)
    p = predictor()
    expected = shown(p, motion, 25)
    shown(p, unseen(0), 40)
    np.testing.assert_array_equal(shown(p, motion, 25), expected)
    p.start()
    for k in range(25):
        prediction = p.update(motion.q[k], float(motion.t_s[k]))
        with pytest.raises(ArrayError, match="finite"):
            p.update(np.full(12, np.nan), float(motion.t_s[k]) + 0.001)
        with pytest.raises(MotionError, match="later"):
            p.update(motion.q[k], float(motion.t_s[k]))
        with pytest.raises(ArrayError, match="shape"):
            p.update(motion.q[k][:5], float(motion.t_s[k]) + 0.001)
    np.testing.assert_array_equal(prediction.occupancy.probability, expected)
    assert prediction.occupancy.t_s == motion.t_s[24]
    assert prediction.posterior is not None
    assert prediction.posterior.best == "20"


def test_standing_still_changes_nothing() -> None:
    motion, p = unseen(0), predictor()
    shown(p, motion, 20)
    later = [p.update(motion.q[19], float(motion.t_s[19]) + 0.01 * k).occupancy.probability for k in range(1, 40)]
    for probability in later[3:]:
        np.testing.assert_array_equal(probability, later[2])


def test_a_shifted_person_gets_shifted_probabilities() -> None:
    """Both stand elsewhere than the library's people; 0.5 m are 10 voxels, and a quarter turn maps voxels on voxels."""
    motion, grid = unseen(1), VoxelGrid((-2.0, -2.0, -0.4), 0.05, (80, 80, 48))
    once = turn_and_shift(0.3, (0.4, -0.3, 0.0))
    here = shown(predictor(grid), placed(motion, once), 25)
    shifted = shown(predictor(grid), placed(motion, turn_and_shift(0.0, (0.5, -0.25, 0.0)) @ once), 25)
    turned = shown(predictor(grid), placed(motion, turn_and_shift(np.pi / 2) @ once), 25)
    for p, back in ((shifted, np.roll(shifted, (-10, 5), axis=(0, 1))), (turned, np.rot90(turned, -1))):
        assert p.sum() == pytest.approx(here.sum(), rel=1e-3)
        # Only points within rounding of the face of a voxel may differ.
        assert (np.abs(back - here) > 1e-3).sum() <= 0.01 * (here > 0).sum()


def test_the_world_may_lie_elsewhere() -> None:
    motion = unseen(2)
    T = turn_and_shift(0.0, (3.0, -1.0, 0.5))
    there = VoxelGrid((1.5, -2.5, 0.1), 0.05, GRID.shape)
    a, b = shown(predictor(), motion, 20), shown(predictor(there, T), motion, 20)
    assert (np.abs(a - b) > 1e-3).sum() <= 0.01 * (a > 0).sum()


def test_a_person_elsewhere_is_predicted_nearly_as_well() -> None:
    T = turn_and_shift(np.radians(20.0), (0.3, 0.0, 0.0))
    error = {"home": 0.0, "elsewhere": 0.0}
    for label in range(3):
        for where, motion in (("home", unseen(label)), ("elsewhere", placed(unseen(label), T))):
            for n in (10, 20, 40):
                error[where] += squared_error(shown(predictor(), motion, n), BODY.mask(motion.q[n - 1 :]))
    assert error["elsewhere"] < 1.3 * error["home"]


def test_says_where_it_takes_the_person_to_stand() -> None:
    T = turn_and_shift(0.5, (0.6, 0.2, 0.0))
    for motion, expected in ((unseen(), np.eye(4)), (placed(unseen(), T), np.linalg.inv(T))):
        p = predictor()
        p.start()
        for k in range(8):
            prediction = p.update(motion.q[k], float(motion.t_s[k]))
        assert prediction.T_library_tracker is not None
        np.testing.assert_allclose(prediction.T_library_tracker, expected, atol=0.1)


def test_a_recogniser_may_run_the_forest() -> None:
    forest = fitted().fresh()

    class Twice(ForestClassifier):
        """Starts anew before every posture."""

        def start(self) -> None:
            forest.start()

        def update(self, q: FloatArray, t_s: float):  # type: ignore[no-untyped-def]
            forest.start()
            return replace(forest.update(q, t_s), n_frames=77)

    p = ForecastPredictor(forest, GRID, np.eye(4), recogniser=Twice(HUMAN))
    motion = unseen(1)
    shown(p, motion, 30)
    prediction = p.update(motion.q[30], 10.0)
    assert prediction.posterior is not None
    assert prediction.posterior.n_frames == 77
    alone = predictor()
    alone.start()
    np.testing.assert_array_equal(
        prediction.occupancy.probability, alone.update(motion.q[30], 0.0).occupancy.probability
    )


def test_people_outside_the_grid_occupy_nothing() -> None:
    p = shown(predictor(VoxelGrid((20.0, 20.0, 0.0), 0.05, (8, 8, 8))), unseen(), 10)
    assert not p.any()


def test_what_is_wrong_is_named() -> None:
    with pytest.raises(UsageError, match="has learned"):
        ForecastPredictor(ForestClassifier(HUMAN), GRID, np.eye(4))
    with pytest.raises(ArrayError, match="rotation"):
        ForecastPredictor(fitted(), GRID, np.diag([1.0, 2.0, 1.0, 1.0]))
    for wrong in ({"n_futures": 33}, {"n_futures": 0}, {"thinning": 0}, {"kept": 1.5}, {"fade": 0.0}, {"spread": -0.1}):
        with pytest.raises(SettingsError, match=next(iter(wrong))):
            ForecastSettings(**wrong)


def test_rest_is_certain_before_any_motion() -> None:
    p = predictor()
    p.start()
    assert (p.update(REST, 0.0).occupancy.probability[BODY.mask(REST)] == 1.0).all()


def test_calibrated_and_far_better_than_the_present_on_the_papers_recordings() -> None:
    """A small part of what `humanpred evaluate occupancy` does: five motions a class learned, others shown."""
    library = load_library(shared_data("iros2013/library_b"))
    learned = library.select(lambda motion: motion.index in range(4, 9))
    grid = grid_around(library, HUMAN)
    body = BodyVoxeliser(HUMAN, grid, np.eye(4))
    p = ForecastPredictor(ForestClassifier(HUMAN).fit(learned), grid, np.eye(4))
    error, present, missed, table = 0.0, 0.0, [], np.zeros(1)
    for label in library.labels:
        motion = library.find(f"{label}/{10 + int(label)}")
        last = body.last_touch(motion.q)
        p.start()
        for k, (q, t_s) in enumerate(zip(motion.q, motion.t_s, strict=True)):
            probability = p.update(q, float(t_s)).occupancy.probability
            if k % 20 == 10:
                swept = last >= k
                error += squared_error(probability, swept)
                present += squared_error(body.mask(q), swept)
                missed.append((probability[swept] < 0.01).mean())
                table = table + reliability(probability, swept, np.ones(grid.shape, dtype=bool))
    assert error < 0.5 * present
    assert np.mean(missed) < 0.03
    assert calibration(table)["error_predicted"] < 0.05


def test_ways_of_the_hands_begin_where_they_are_and_are_as_probable_as_the_futures() -> None:
    motion, p = unseen(), predictor()
    shown(p, motion, len(motion.q) // 2)
    q = motion.q[len(motion.q) // 2 - 1]
    now, ways = p._forest.human.forward(q), p.futures(q)
    hands = [name for name in now if name.endswith("_palm")]
    assert sum(probability for probability, _ in ways) == pytest.approx(len(hands))
    begins = np.array([way[0] for _, way in ways]).reshape(-1, len(hands), 3)
    np.testing.assert_allclose(begins, np.broadcast_to([now[hand] for hand in hands], begins.shape), atol=1e-9)
    right = hands.index("right_palm")
    farthest = max(float(np.linalg.norm(way[-1] - way[0])) for _, way in ways[right :: len(hands)])
    assert farthest > 0.05
