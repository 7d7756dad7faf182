"""When voxels will be occupied: slices join to what is swept, follow the library's timing, and are calibrated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from small_library import REST, small_library

from humanpred_ros.evaluation.leave_one_out import at_speed
from humanpred_ros.evaluation.occupancy import OccupancySettings
from humanpred_ros.evaluation.occupancy_in_time import evaluate_in_time
from humanpred_ros.geometry.lattice import OccupancyInTime, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.occupancy.baselines import ConstantVelocityPredictor, CurrentOccupancyPredictor
from humanpred_ros.occupancy.forecast import ForecastPredictor, ForecastSettings
from humanpred_ros.occupancy.predictor import SLICES_S, Prediction, Predictor
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
BODY = BodyVoxeliser(HUMAN, GRID, np.eye(4))
N_FRAMES = 60


def library(duration_s: float = 1.5) -> MotionLibrary:
    return small_library(3, 10, N_FRAMES, there_and_back=True, duration_s=duration_s)


@cache
def forecast(duration_s: float = 1.5, pace: float = 0.5) -> ForecastPredictor:
    forest = ForestClassifier(HUMAN, ForestSettings(n_trees=40)).fit(library(duration_s))
    return ForecastPredictor(forest, GRID, np.eye(4), settings=ForecastSettings(pace=pace))


def unseen(label: int = 1) -> Motion:
    return small_library(3, 1, N_FRAMES, there_and_back=True, seed=99).motions[label]


def shown(p: Predictor, motion: Motion, n: int, edges_s: np.ndarray = SLICES_S) -> tuple[Prediction, OccupancyInTime]:
    p.start()
    assert p.in_time(edges_s) is None
    for k in range(n):
        prediction = p.update(motion.q[k], float(motion.t_s[k]))
    slices = p.in_time(edges_s)
    assert slices is not None
    assert slices.t_s == motion.t_s[n - 1]
    return prediction, slices


def dense(slices: OccupancyInTime) -> np.ndarray:
    return np.stack([slices.during(k).probability for k in range(len(slices.edges_s) - 1)])


@pytest.mark.parametrize("n", [5, 20, 45])
def test_slices_join_to_what_is_swept(n: int) -> None:
    prediction, slices = shown(forecast(), unseen(), n)
    p, swept = dense(slices), prediction.occupancy.probability
    body = BODY.mask(unseen().q[n - 1])
    assert (p[0][body] == 1.0).all()
    assert p[1:].max() < 1.0  # certain is only where the body is now
    # In no slice more is occupied than is swept, and all together no less, but for what thinning leaves out.
    assert np.clip(p.max(axis=0) - swept, 0.0, None).sum() < 0.1 * swept.sum()
    assert np.clip(swept - p.sum(axis=0), 0.0, None).sum() < 0.02 * swept.sum()


def test_one_slice_for_ever_is_the_swept_prediction() -> None:
    prediction, slices = shown(forecast(), unseen(), 20, np.array([0.0, np.inf]))
    difference = dense(slices)[0] - prediction.occupancy.probability
    assert np.abs(difference).sum() < 0.1 * prediction.occupancy.probability.sum()


def test_people_half_as_fast_are_where_they_are_twice_as_late() -> None:
    ends = SLICES_S[1:]
    _, quick = shown(forecast(pace=0.0), unseen(), 20, np.append(0.0, ends))
    late = replace(unseen(), t_s=2.0 * unseen().t_s)
    _, slow = shown(forecast(3.0, pace=0.0), late, 20, np.append(0.0, 2.0 * ends))
    np.testing.assert_array_equal(quick.voxels, slow.voxels)
    np.testing.assert_array_equal(quick.probability, slow.probability)


def test_who_goes_at_another_pace_is_expected_to_go_on_so() -> None:
    def pace(speed: float) -> float:
        found = []
        for label in range(3):
            shown(forecast(), at_speed(unseen(label), speed), round(24 / speed))
            found.append(forecast().seen_pace())
        return float(np.mean(found))

    assert pace(0.7) < 0.93 * pace(1.0)
    assert pace(1.4) > 1.07 * pace(1.0)


def test_the_hand_comes_and_goes_while_the_feet_stay() -> None:
    motion, n = unseen(), 15  # on its way; the hand is there a quarter of a second later, and back after one
    p = dense(shown(forecast(), motion, n)[1])
    there = BODY.mask(motion.q[30]) & ~BODY.mask(motion.q[[n - 1, 0, -1]])
    assert p[1][there].mean() > 0.5
    assert p[[6, 10, 15]][:, there].mean() < 0.1
    feet = BODY.mask(motion.q[n - 1]).copy()
    feet[:, :, 20:] = False
    assert p[:, feet].mean() > 0.7


def test_constant_velocity_stops_where_it_says() -> None:
    p = ConstantVelocityPredictor(HUMAN, GRID, np.eye(4))
    elbow = HUMAN.dof_index["rElbowZ"]
    for k in range(12):
        q = REST.copy()
        q[elbow] -= 0.02 * k
        p.update(q, k / 60)
    slices = p.in_time(SLICES_S)
    assert slices is not None
    end = q.copy()
    end[elbow] -= 0.02 * 60 * p.settings.horizon_s
    at_last = slices.during(14).probability > 0
    np.testing.assert_array_equal(at_last, BODY.mask(np.clip(end, HUMAN.lower, HUMAN.upper)))
    assert (dense(slices).max(axis=0) > 0)[BODY.mask(q)].all()


def test_who_knows_no_times_says_none() -> None:
    current = CurrentOccupancyPredictor(HUMAN, GRID, np.eye(4))
    current.update(REST, 0.0)
    assert current.in_time(SLICES_S) is None
    state = forecast()._forest.state()
    del state["duration_s"]  # as a model of an older version
    older = ForestClassifier.from_state(HUMAN, forecast()._forest.settings, state)
    p = ForecastPredictor(older, GRID, np.eye(4))
    p.update(REST, 0.0)
    assert p.in_time(SLICES_S) is None


def test_timed_predictions_beat_the_swept_one_and_are_calibrated() -> None:
    done: list[int] = []
    settings = OccupancySettings(library="", percents=(20, 40), every=6, jobs=1, by_time=True)
    report = evaluate_in_time(library(), settings, done.append)
    figures = report.figures
    assert done[-1] == len(figures["tested"]) == 5
    assert figures["forecast"]["moments"][:4].tolist() == [10.0] * 4
    assert figures["forecast"]["moments"][6] == 0.0  # nobody knows what comes after a recording
    assert figures["ratios"]["swept as if now"] < 0.7
    assert figures["ratios"]["constant_velocity"] < 0.7
    assert max(table["error_predicted"] for table in figures["forecast"]["calibration"][:4]) < 0.1
