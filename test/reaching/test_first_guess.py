"""First guesses join start and goal, and turn the shoulder about one axis."""

from __future__ import annotations

import numpy as np
import pytest
from paths import shared_data
from reaching_people import GOAL, MODEL, START, recording
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import HumanModelError, MotionError
from humanpred_ros.evaluation.reach_distances import reach_distance
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.first_guess import ShortShoulder, minimum_jerk, straight_line
from humanpred_ros.reaching.posture_bounds import posture_variation
from humanpred_ros.reaching.prediction import ReachTask

PHASE = np.linspace(0.0, 1.0, 101)
SHOULDER = [MODEL.dof_index[name] for name in ("rShoulderY1", "rShoulderX", "rShoulderY2")]


def shoulder(q: FloatArray) -> Rotation:
    """The upper arm in the torso, by the model's own kinematics."""
    poses = MODEL.link_poses(q)
    torso, arm = (poses[:, MODEL.link_names.index(link), :3, :3] for link in ("torso", "right_upper_arm"))
    return Rotation.from_matrix(torso.transpose(0, 2, 1) @ arm)


@pytest.mark.parametrize("seed", range(8))
def test_the_shoulder_turns_about_one_axis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, goal = START.copy(), GOAL.copy()
    start[SHOULDER] += rng.normal(scale=0.2, size=3)
    goal[SHOULDER] += rng.normal(scale=0.2, size=3)
    q = ShortShoulder(MODEL)(start, goal, PHASE)
    np.testing.assert_array_equal(q[[0, -1]], [start, goal])
    turned = shoulder(q)
    whole = (turned[0].inv() * turned[-1]).as_rotvec()
    done = (turned[0].inv() * turned).as_rotvec()
    np.testing.assert_allclose(done, minimum_jerk(PHASE)[:, None] * whole, atol=1e-6)
    assert np.abs(np.diff(q, axis=0)).max() < 0.3  # no whole turns between neighbours


def test_all_other_dofs_go_straight() -> None:
    q = ShortShoulder(MODEL)(START, GOAL, PHASE)
    others = np.delete(np.arange(23), SHOULDER)
    wanted = straight_line(START, GOAL, minimum_jerk(PHASE))
    np.testing.assert_allclose(q[:, others], wanted[:, others], atol=1e-12)


def test_phases_just_before_the_end_are_no_trouble() -> None:
    phase = 1.0 - 1e-4 * np.random.default_rng(0).random(10_000)
    assert (minimum_jerk(phase) > 1.0).any()  # by rounding
    q = ShortShoulder(MODEL)(START, GOAL, np.concatenate([[0.0], np.sort(phase), [1.0]]))
    np.testing.assert_allclose(q[1:], np.broadcast_to(GOAL, (len(q) - 1, len(GOAL))), atol=1e-6)


def test_a_goal_that_is_a_turn_away_is_reached_straight() -> None:
    goal = GOAL.copy()
    goal[SHOULDER[0]] += 2.0 * np.pi
    q = ShortShoulder(MODEL)(START, goal, PHASE)
    np.testing.assert_allclose(q, straight_line(START, goal, minimum_jerk(PHASE)), atol=1e-12)


@pytest.mark.filterwarnings("error")
def test_angles_that_are_not_unique_go_straight() -> None:
    start = START.copy()
    start[SHOULDER[1]] = 0.0  # both other angles turn about the upper arm
    q = ShortShoulder(MODEL)(start, GOAL, PHASE)
    np.testing.assert_allclose(q, straight_line(start, GOAL, minimum_jerk(PHASE)), atol=1e-12)


def test_it_knows_the_kinects_human_too() -> None:
    model = HumanModel.kinect12()
    start, goal = np.zeros(12), np.linspace(0.1, 0.6, 12)
    q = ShortShoulder(model)(start, goal, PHASE)
    columns = [model.dof_index[name] for name in ("rShoulderX", "rShoulderZ", "rShoulderY")]
    assert np.abs(q[:, columns] - straight_line(start, goal, minimum_jerk(PHASE))[:, columns]).max() > 1e-3
    np.testing.assert_array_equal(q[[0, -1]], [start, goal])


def test_joints_that_are_none_are_refused() -> None:
    with pytest.raises(HumanModelError, match="three DoFs"):
        ShortShoulder(MODEL, ("rElbowZ", "rElbowX", "rWristY"))
    with pytest.raises(HumanModelError, match="three DoFs"):
        ShortShoulder(MODEL, ("a", "b", "c"))


def test_variation_is_that_of_the_recordings() -> None:
    recordings = [recording(seed) for seed in range(3)]
    found = []
    for one in recordings:
        bow = one.active.q - straight_line(one.active.q[0], one.active.q[-1], minimum_jerk(PHASE[::1][:100] * 100 / 99))
        found.append(np.sqrt((bow**2).mean(axis=0)))
    np.testing.assert_allclose(posture_variation(recordings), np.median(found, axis=0), atol=1e-9)
    with pytest.raises(MotionError, match="at least one"):
        posture_variation([])


def test_on_p2s_recordings_it_beats_minimum_jerk() -> None:
    guess = ShortShoulder(MODEL)
    tasks = [(ReachTask.of(r), r.active.q) for r in load_reach_recordings(shared_data("icra2015/demos"))]
    distances = [reach_distance(MODEL, guess(task.start, task.goal, task.phase), q) for task, q in tasks]
    found = np.mean([[d.joint_m, d.task_m] for d in distances], axis=0)
    assert found[0] < 23.12 - 2.0  # minimum jerk, docs/papers.md, P2 results
    assert found[1] < 18.93 - 2.0
