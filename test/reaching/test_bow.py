"""The bow of others makes a better prediction than any straight line, and never moves the ends."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from paths import shared_data
from reaching_people import GOAL, MODEL, START, recording

from humanpred_ros.errors import MotionError
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import Jump, ReachRecording, load_reach_recordings
from humanpred_ros.reaching.bow import BowConfig, learn_bow, wrist_way_m
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.reach_task import ReachTask
from humanpred_ros.reaching.trivial import TimedLine, minimum_jerk

RNG = np.random.default_rng(0)
ELBOW = MODEL.dof_names.index("rElbowZ")


def bowed(share: float, shape: np.ndarray | None = None) -> ReachRecording:
    """A reach to `share` of the way to the goal, with a bow that grows with the square of the wrist's way."""
    t_s = np.linspace(0.0, 1.0, 101)
    goal = START + share * (GOAL - START)
    task = ReachTask("x", MODEL.dof_names, t_s, START, goal, recording(0).passive)
    bow = np.sin(np.pi * t_s) * wrist_way_m(MODEL, START, goal) ** 2 if shape is None else shape
    q = TimedLine(minimum_jerk).predict(task, RNG)
    q[:, ELBOW] -= bow
    active, passive = (Motion(t_s, p, MODEL.dof_names) for p in (q, np.repeat(START[None], 101, axis=0)))
    return ReachRecording(f"share_{share}", active, passive)


def test_a_bow_that_grows_as_assumed_is_found_exactly() -> None:
    predictor = learn_bow([bowed(0.4), bowed(1.0)], MODEL, BowConfig(doubt=0.0))
    unseen = bowed(0.7)
    np.testing.assert_allclose(predictor.predict(ReachTask.of(unseen), RNG), unseen.active.q, atol=1e-9)


def test_doubt_takes_the_bow_back() -> None:
    unseen = bowed(0.7)
    task = ReachTask.of(unseen)
    line = TimedLine(minimum_jerk).predict(task, RNG)
    off = [
        np.abs(learn_bow([bowed(1.0)], MODEL, BowConfig(doubt=doubt)).predict(task, RNG) - line).max()
        for doubt in (0.0, 1.0, 1e9)
    ]
    assert off[1] == pytest.approx(0.5 * off[0])
    assert off[2] < 1e-6


def test_the_ends_stay_where_the_person_is() -> None:
    predictor = learn_bow([recording(seed) for seed in range(3)], MODEL)
    task = ReachTask.of(recording(5))
    np.testing.assert_allclose(predictor.predict(task, RNG)[[0, -1]], [task.start, task.goal], atol=1e-12)


def test_who_jumps_is_not_learned_from() -> None:
    jumping = dataclasses.replace(bowed(1.0, np.full(101, 9.0)), jumps=(Jump("active", 50, "right_wrist", 7.0),))
    with_it, without = (learn_bow(some, MODEL).shape for some in ([bowed(0.5), jumping], [bowed(0.5)]))
    np.testing.assert_array_equal(with_it, without)
    with pytest.raises(MotionError, match="at least one recording"):
        learn_bow([jumping], MODEL)


def test_somebody_who_stays_is_not_learned_from() -> None:
    with pytest.raises(MotionError, match="ends where it began"):
        learn_bow([bowed(0.0, np.zeros(101))], MODEL)


def test_on_the_papers_recordings_it_is_better_than_minimum_jerk() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    metric = ReachMetric(MODEL)
    joint, task, worse = [], [], 0
    for entry in recordings:
        target = ReachTask.of(entry)
        predictor = learn_bow([other for other in recordings if other is not entry], MODEL)
        ours = metric.between(predictor.predict(target, RNG), entry.active.q)
        line = metric.between(TimedLine(minimum_jerk).predict(target, RNG), entry.active.q)
        joint.append(ours.joint_m)
        task.append(ours.task_m)
        worse += ours.joint_m > line.joint_m
    assert np.mean(joint) < 15.0  # minimum jerk: 23.12, P2: 30.98
    assert np.mean(task) < 13.5  # minimum jerk: 18.93
    assert worse <= 1
