"""Simple predictors score on P2's recordings what other code computed from them: the bar for everything learned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.evaluation.reach_distances import reach_distance
from humanpred_ros.evaluation.reaching_predictors import (
    REACHING_PREDICTORS,
    ReachingMaterial,
    mean_profile,
    reaching_entry,
)
from humanpred_ros.evaluation.reaching_runs import DEMONSTRATIONS
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording, load_reach_recordings
from humanpred_ros.reaching.between_ends import minimum_jerk
from humanpred_ros.reaching.planner import ReachTask

RNG = np.random.default_rng(0)
ELBOW = MODEL.dof_names.index("rElbowZ")
#: joint / task as coded / task, by recording.
LINE = [(29.91, 48.78, 25.08), (40.44, 55.15, 27.97), (48.88, 84.05, 44.33), (22.23, 32.44, 16.09),
        (22.99, 27.94, 17.46), (9.44, 24.39, 9.77), (21.81, 47.26, 16.10)]  # fmt: skip
MINIMUM_JERK = [(22.75, 45.81, 20.05), (34.49, 54.29, 23.90), (40.60, 78.66, 37.01), (20.26, 31.78, 14.09),
                (19.17, 25.50, 15.26), (7.03, 23.90, 8.28), (17.53, 45.48, 13.93)]  # fmt: skip


#: Their means over the seven, and those of others.
MEANS = {
    "hold": (123.4, 70.63, 74.64),
    "line": (27.96, 45.72, 22.40),
    "minimum_jerk": (23.12, 43.63, 18.93),
    "time_profile": (24.04, 42.08, 19.16),
}
#: The same on the interference case.
INTERFERENCE = {"line": (69.02, 52.52, 56.92), "minimum_jerk": (53.40, 58.03, 52.75)}


def scores(name: str, tested: Sequence[ReachRecording], seven: Sequence[ReachRecording]) -> np.ndarray:
    """Return (R, 3) distances of a predictor that learned from the seven, except from the tested one."""
    make, material = reaching_entry(name).make, ReachingMaterial(seven, MODEL)
    reaches = [make(material, entry.name).predict(ReachTask.of(entry), RNG) for entry in tested]
    return np.array([reach_distance(MODEL, q, entry.active.q) for q, entry in zip(reaches, tested, strict=True)])


@pytest.fixture(scope="module")
def seven() -> list[ReachRecording]:
    found = {entry.name: entry for entry in load_reach_recordings(shared_data("icra2015/demos"))}
    return [found[name] for name in DEMONSTRATIONS]


@pytest.mark.parametrize(("name", "wanted"), [("line", LINE), ("minimum_jerk", MINIMUM_JERK)])
def test_each_of_the_seven(seven: list[ReachRecording], name: str, wanted: object) -> None:
    np.testing.assert_allclose(scores(name, seven, seven), wanted, atol=0.05)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", MEANS)
def test_means_of_the_seven(seven: list[ReachRecording], name: str) -> None:
    assert scores(name, seven, seven).mean(axis=0) == pytest.approx(MEANS[name], abs=0.05)


@pytest.mark.parametrize("name", INTERFERENCE)
def test_the_interference_case(seven: list[ReachRecording], name: str) -> None:
    case = load_reach_recordings(shared_data("icra2015/interference_case"))
    assert scores(name, case, seven)[0] == pytest.approx(INTERFERENCE[name], abs=0.05)


def test_every_predictor_says_what_it_does() -> None:
    assert all(entry.description for entry in REACHING_PREDICTORS.values())
    with pytest.raises(UsageError, match="crystal_ball"):
        reaching_entry("crystal_ball")


@pytest.mark.parametrize("name", ["line", "minimum_jerk"])
def test_lines_begin_and_end_where_the_person_does(name: str) -> None:
    task = ReachTask.of(recording(1))
    postures = reaching_entry(name).make(ReachingMaterial([], MODEL), "").predict(task, RNG)
    np.testing.assert_array_equal(postures[[0, -1]], [task.start, task.goal])
    assert len(postures) == len(task.t_s)


def test_the_profile_that_all_others_have_is_found() -> None:
    others = [recording(seed) for seed in range(4)]
    predicted = mean_profile(others).profile(np.linspace(0.0, 1.0, 11))
    assert predicted[0] == 0.0
    assert predicted[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(predicted, minimum_jerk(np.linspace(0.0, 1.0, 11)), atol=0.1)


def test_profiles_need_reaches() -> None:
    with pytest.raises(MotionError, match="at least one recording"):
        mean_profile([])


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
