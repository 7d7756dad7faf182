"""Trivial predictors score what they scored when the facts were collected: the bar for everything learned."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import MotionError
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording, load_reach_recordings
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.reach_task import ReachTask
from humanpred_ros.reaching.trivial import (
    TimedLine,
    constant_speed,
    cubic,
    hold,
    mean_profile,
    minimum_jerk,
    time_profile,
)

RNG = np.random.default_rng(0)
PAPERS_ORDER = ("0446-0578", "0525-0657", "0444-0585", "0489-0589", "0780-0871", "1537-1608", "2711-2823")
#: facts section 8: joint / task as coded / task, by recording.
LINE = [(29.91, 48.78, 25.08), (40.44, 55.15, 27.97), (48.88, 84.05, 44.33), (22.23, 32.44, 16.09),
        (22.99, 27.94, 17.46), (9.44, 24.39, 9.77), (21.81, 47.26, 16.10)]  # fmt: skip
MINIMUM_JERK = [(22.75, 45.81, 20.05), (34.49, 54.29, 23.90), (40.60, 78.66, 37.01), (20.26, 31.78, 14.09),
                (19.17, 25.50, 15.26), (7.03, 23.90, 8.28), (17.53, 45.48, 13.93)]  # fmt: skip


def scores(
    recordings: Sequence[ReachRecording], make: Callable[[list[ReachRecording]], TimedLine]
) -> list[tuple[float, float, float]]:
    metric, found = ReachMetric(MODEL), []
    for entry in recordings:
        predictor = make([other for other in recordings if other is not entry])
        distance = metric.between(predictor.predict(ReachTask.of(entry), RNG), entry.active.q)
        found.append((distance.joint_m, distance.task_as_coded_m, distance.task_m))
    return found


@pytest.fixture(scope="module")
def seven() -> list[ReachRecording]:
    found = {entry.name: entry for entry in load_reach_recordings(shared_data("icra2015/demos"))}
    return [found[name] for name in PAPERS_ORDER]


@pytest.mark.parametrize(
    ("profile", "wanted"), [(constant_speed, LINE), (minimum_jerk, MINIMUM_JERK)], ids=["line", "minimum jerk"]
)
def test_each_of_the_seven(seven: list[ReachRecording], profile: Callable[..., object], wanted: object) -> None:
    np.testing.assert_allclose(scores(seven, lambda _: TimedLine(profile)), wanted, atol=0.05)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (lambda _: TimedLine(hold), (123.4, 70.63, 74.64)),
        (lambda _: TimedLine(constant_speed), (27.96, 45.72, 22.40)),
        (lambda _: TimedLine(cubic), (23.85, 44.17, 19.54)),
        (lambda _: TimedLine(minimum_jerk), (23.12, 43.63, 18.93)),
        (mean_profile, (24.04, 42.08, 19.16)),
    ],
    ids=["hold", "line", "cubic", "minimum jerk", "time profile, leaving one out"],
)
def test_means_of_the_seven(
    seven: list[ReachRecording],
    make: Callable[[list[ReachRecording]], TimedLine],
    wanted: tuple[float, float, float],
) -> None:
    assert np.mean(scores(seven, make), axis=0) == pytest.approx(wanted, abs=0.05)


@pytest.mark.parametrize(
    ("profile", "wanted"), [(constant_speed, (69.02, 52.52, 56.92)), (minimum_jerk, (53.40, 58.03, 52.75))]
)
def test_the_interference_case(profile: Callable[..., object], wanted: tuple[float, float, float]) -> None:
    case = load_reach_recordings(shared_data("icra2015/interference_case"))
    assert scores(case, lambda _: TimedLine(profile))[0] == pytest.approx(wanted, abs=0.05)  # type: ignore[arg-type]


@pytest.mark.parametrize("profile", [constant_speed, cubic, minimum_jerk])
def test_lines_begin_and_end_where_the_person_does(profile: Callable[..., object]) -> None:
    task = ReachTask.of(recording(1))
    postures = TimedLine(profile).predict(task, RNG)  # type: ignore[arg-type]
    np.testing.assert_array_equal(postures[[0, -1]], [task.start, task.goal])
    assert len(postures) == len(task.t_s)


def test_who_reaches_with_minimum_jerk_has_its_profile() -> None:
    task = ReachTask.of(recording(1))
    motion = Motion(task.t_s, TimedLine(minimum_jerk).predict(task, RNG), MODEL.dof_names)
    np.testing.assert_allclose(time_profile(motion), minimum_jerk(np.linspace(0.0, 1.0, 100)), atol=1e-3)


def test_the_profile_that_all_others_have_is_found() -> None:
    others = [recording(seed) for seed in range(4)]
    predicted = mean_profile(others).profile(np.linspace(0.0, 1.0, 11))
    assert predicted[0] == 0.0
    assert predicted[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(predicted, minimum_jerk(np.linspace(0.0, 1.0, 11)), atol=0.1)


def test_profiles_need_reaches() -> None:
    with pytest.raises(MotionError, match="at least one recording"):
        mean_profile([])
    entry = recording(1)
    with pytest.raises(MotionError, match="ends in the posture it began with"):
        time_profile(entry.active.with_postures(np.repeat(entry.active.q[:1], len(entry.active), axis=0)))


def test_people_who_come_back_have_no_say_in_the_time_profile() -> None:
    there = [recording(seed) for seed in range(3)]
    q = there[0].active.q
    for off in (0.0, 0.002):
        back = np.concatenate([q[::2], q[::-2]])
        back[-1] = q[0] + off
        motion = Motion(there[0].active.t_s, back, MODEL.dof_names, frame_id="mocap")
        again = ReachRecording("again", motion, there[0].passive)
        phases = np.linspace(0.0, 1.0, 30)
        np.testing.assert_array_equal(
            mean_profile([*there, again]).profile(phases), mean_profile(there).profile(phases)
        )
        np.testing.assert_array_equal(mean_profile([again]).profile(phases), minimum_jerk(phases))
