"""Predictors that plan fit the interface of all predictors of reaches, and the better one is better."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import MotionError, PlanningError
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.planned_predictors import (
    ImprovedConfig,
    improved_planner,
    improved_predictor,
    planned_predictor,
)
from humanpred_ros.reaching.planner import ReachPlannerConfig, SingleShot
from humanpred_ros.reaching.posture_bounds import BoundsConfig
from humanpred_ros.reaching.reach_task import ReachTask
from humanpred_ros.reaching.replanning import Replanned

RECORDINGS = [recording(seed, 31) for seed in range(3)]
FAST = ReachPlannerConfig(stomp=ReachPlannerConfig().stomp.replaced(iterations=5))
WEIGHTS = NAMED_WEIGHTS["authors_dynamic"]


@pytest.mark.parametrize(("replanned", "kind"), [(False, SingleShot), (True, Replanned)])
def test_a_reach_left_out_is_predicted_at_its_frames(replanned: bool, kind: type) -> None:
    task = ReachTask.of(RECORDINGS[0])
    for predictor in (
        planned_predictor(RECORDINGS[1:], MODEL, WEIGHTS, replanned=replanned, config=FAST),
        improved_predictor(RECORDINGS[1:], MODEL, WEIGHTS, replanned=replanned, config=ImprovedConfig(n_iterations=5)),
    ):
        assert isinstance(predictor, kind)
        q = predictor.predict(task, np.random.default_rng(0))
        assert q.shape == (31, 23)
        np.testing.assert_allclose(q[[0, -1]], [task.start, task.goal], atol=1e-12)


def test_the_better_planner_varies_as_people_do() -> None:
    planner = improved_planner(RECORDINGS, MODEL, WEIGHTS)
    noise = np.asarray(planner.config.stomp.noise_std)
    assert noise.shape == (23,)
    assert (noise <= 0.0003).all()
    still = [MODEL.dof_index[name] for name in ("PelvisRotX",)]
    moved = improved_planner([recording(seed, 31) for seed in range(3, 6)], MODEL, WEIGHTS)
    assert (np.asarray(moved.config.stomp.noise_std)[still] >= 1e-6).all()


def test_the_better_planner_is_bounded_by_the_reach_and_p2s_by_the_room() -> None:
    start, goal = ReachTask.of(RECORDINGS[0]).start.copy(), ReachTask.of(RECORDINGS[0]).goal.copy()
    k, moved = MODEL.dof_index["PelvisTransX"], 0.05
    planned = planned_predictor(RECORDINGS, MODEL, WEIGHTS)
    assert isinstance(planned, SingleShot)
    for planner, follows in ((improved_planner(RECORDINGS, MODEL, WEIGHTS), True), (planned.planner, False)):
        lower, _ = planner.bounds.around(start, goal)
        there = start.copy(), goal.copy()
        for posture in there:
            posture[k] += moved
        assert planner.bounds.around(*there)[0][k] - lower[k] == pytest.approx(moved if follows else 0.0)


def test_on_the_interference_case_p2s_trunk_drifts_to_where_others_stood() -> None:
    demos = load_reach_recordings(shared_data("icra2015/demos"))
    (case,) = load_reach_recordings(shared_data("icra2015/interference_case"))
    k, task = MODEL.dof_index["PelvisTransX"], ReachTask.of(case)
    low, beyond, joint_m = min(task.start[k], task.goal[k]), [], []
    for bounds in (None, BoundsConfig(relative=True)):
        predictor = planned_predictor(demos, MODEL, NAMED_WEIGHTS["authors_static"], bounds=bounds)
        q = predictor.predict(task, np.random.default_rng(0))
        beyond.append(float(low - q[:, k].min()))
        joint_m.append(ReachMetric(MODEL).between(q, case.active.q).joint_m)
    assert beyond[1] <= 0.03 < beyond[0]
    assert joint_m[1] < 0.9 * joint_m[0]


def test_a_mean_of_plans_scatters_less_than_one() -> None:
    task = ReachTask.of(RECORDINGS[0])
    spread = []
    for averaged in (1, 8):
        config = dataclasses.replace(FAST, averaged=averaged)
        predictor = planned_predictor(RECORDINGS, MODEL, WEIGHTS, config=config)
        q = np.stack([predictor.predict(task, np.random.default_rng(seed)) for seed in range(8)])
        spread.append(float(q.std(axis=0).mean()))
    assert spread[1] < 0.6 * spread[0]


def test_bad_input_is_refused() -> None:
    with pytest.raises(MotionError):
        planned_predictor([], MODEL, WEIGHTS)
    with pytest.raises(MotionError):
        improved_predictor([], MODEL, WEIGHTS)
    with pytest.raises(PlanningError, match="averaged"):
        ReachPlannerConfig(averaged=0)


def test_on_p2s_recordings_it_is_better_than_the_authors() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    metric, found = ReachMetric(MODEL), []
    for left_out in recordings:
        others = [r for r in recordings if r.name != left_out.name]
        predictor = improved_predictor(others, MODEL, NAMED_WEIGHTS["authors_static"])
        q = predictor.predict(ReachTask.of(left_out), np.random.default_rng(0))
        d = metric.between(q, left_out.active.q)
        found.append((d.joint_m, d.task_as_coded_m, d.task_m))
    # P2's Table II: 30.98 / 42.18; minimum jerk 23.12 / 43.63 / 18.93.
    assert (np.mean(found, axis=0) < (23.12, 42.18, 18.93)).all()
