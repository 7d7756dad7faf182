"""Plans are made when they should be, from where the person is, beside the partner of that moment."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import UsageError
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.planner import PlannedReach, ReachPlanner, ReachPlannerConfig, SingleShot
from humanpred_ros.reaching.posture_bounds import PostureBounds
from humanpred_ros.reaching.reach_task import ReachTask
from humanpred_ros.reaching.replanning import Replanned, ReplanningConfig
from humanpred_ros.reaching.surroundings import Surroundings

RECORDINGS = [recording(seed, 61) for seed in range(3)]
BOUNDS = PostureBounds.from_recordings(RECORDINGS, MODEL)
FAST = ReachPlannerConfig(stomp=ReachPlannerConfig().stomp.replaced(iterations=10))
SCENE = Surroundings.of_p2()
TASK = ReachTask.of(RECORDINGS[0])


class Listening(ReachPlanner):
    """A planner that notes what it is asked."""

    def __init__(self) -> None:
        super().__init__(MODEL, NAMED_WEIGHTS["authors_static"], BOUNDS, SCENE, FAST)
        self.asked: list[dict[str, object]] = []

    def plan(self, start, goal, duration_s, partner, rng, history=None, initial=None):  # type: ignore[no-untyped-def]
        reach: PlannedReach = super().plan(start, goal, duration_s, partner, rng, history, initial)
        self.asked.append(
            {"start": start, "left_s": duration_s, "history": history, "initial": initial, "partner": partner,
             "reach": reach}
        )  # fmt: skip
        return reach


def test_plans_are_made_every_step_but_not_shortly_before_the_end() -> None:
    predictor = Replanned(Listening())
    assert predictor.frames(np.arange(61) * 0.01) == [0, 10, 20, 30, 40, 50]
    assert predictor.frames(np.arange(105) * 0.01) == list(range(0, 100, 10))  # 0.04 s left at 1.0 s
    assert predictor.frames(np.arange(4) * 0.01) == [0]
    assert predictor.frames(np.array([0.0, 0.15, 0.2, 0.4])) == [0, 1, 2]  # the end is no place to plan


def test_a_prediction_is_made_of_the_plans_beginnings() -> None:
    planner = Listening()
    q = Replanned(planner).predict(TASK, np.random.default_rng(0))
    assert q.shape == RECORDINGS[0].active.q.shape
    np.testing.assert_array_equal(q[[0, -1]], [TASK.start, TASK.goal])
    for k, asked in enumerate(planner.asked):
        now = 10 * k
        np.testing.assert_array_equal(asked["start"], q[now])
        assert asked["left_s"] == pytest.approx(0.60 - 0.01 * now)
        reach = asked["reach"]
        assert isinstance(reach, PlannedReach)
        stop = min(now + 10, len(q))
        np.testing.assert_allclose(q[now:stop], reach.at(0.01 * np.arange(stop - now)), atol=1e-9)


def test_what_lies_behind_is_the_history_and_the_last_plan_the_beginning_of_the_next() -> None:
    planner = Listening()
    q = Replanned(planner).predict(TASK, np.random.default_rng(0))
    first, second, third = planner.asked[:3]
    assert first["history"] is None
    assert first["initial"] is None
    dt_s = 0.4 / 99
    wanted = np.stack([np.interp(0.2 + dt_s * np.arange(-6, 0), TASK.t_s, column) for column in q.T], axis=1)
    np.testing.assert_allclose(np.asarray(third["history"]), wanted, atol=1e-9)
    reach = second["reach"]
    assert isinstance(reach, PlannedReach)
    np.testing.assert_allclose(np.asarray(third["initial"]), reach.at(0.1 + np.linspace(0.0, 0.4, 100)), atol=1e-9)


def test_the_partner_is_the_one_of_the_moment_and_his_future_is_not_looked_at() -> None:
    later = TASK.partner.q.copy()
    later[11:, 0] += 0.4
    other = dataclasses.replace(TASK, partner=Motion(TASK.partner.t_s, later, TASK.dof_names, frame_id="mocap"))

    patient = ReachPlannerConfig(stomp=FAST.stomp.replaced(iterations=50))
    predictor = Replanned(ReachPlanner(MODEL, NAMED_WEIGHTS["baseline_1"], BOUNDS, SCENE, patient))
    a, b = (predictor.predict(task, np.random.default_rng(0)) for task in (TASK, other))
    np.testing.assert_array_equal(a[:20], b[:20])
    assert np.abs(a[20:] - b[20:]).max() > 1e-3
    planner = Listening()
    Replanned(planner).predict(TASK, np.random.default_rng(0))
    for k, asked in enumerate(planner.asked):
        expected = planner.partner(TASK.partner.q[10 * k]).points_m
        np.testing.assert_array_equal(asked["partner"].points_m, expected)  # type: ignore[attr-defined]


def test_the_same_seed_gives_the_same_prediction() -> None:
    a, b, c = (Replanned(Listening()).predict(TASK, np.random.default_rng(k)) for k in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 1e-4


def test_times_that_cannot_be_are_refused() -> None:
    with pytest.raises(UsageError, match="re-planning"):
        ReplanningConfig(step_s=0.0)


def test_replanning_helps_where_the_partner_comes_in_the_way() -> None:
    demos = load_reach_recordings(shared_data("icra2015/demos"))
    (case,) = load_reach_recordings(shared_data("icra2015/interference_case"))
    planner = ReachPlanner(MODEL, NAMED_WEIGHTS["authors_static"], PostureBounds.from_recordings(demos, MODEL), SCENE)
    metric, task = ReachMetric(MODEL), ReachTask.of(case)
    once, again = (
        metric.between(predictor.predict(task, np.random.default_rng(0)), case.active.q)
        for predictor in (SingleShot(planner), Replanned(planner))
    )
    # P2's Table III: 52.89 / 49.22 without, 44.91 / 36.20 with.
    assert again.joint_m < once.joint_m
    assert again.task_as_coded_m < once.task_as_coded_m
