"""Bounds are those of the demonstrations with P2's margins, and never exclude the reach itself."""

from __future__ import annotations

import numpy as np
import pytest
from paths import shared_data
from reaching_people import GOAL, MODEL, START, recording
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import GoalUnreachableError, HumanModelError, MotionError
from humanpred_ros.evaluation.reach_distances import reach_distance
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.between_ends import (
    PostureBounds,
    ShortShoulder,
    minimum_jerk,
    posture_variation,
    straight_line,
)
from humanpred_ros.reaching.planner import ReachTask

RECORDINGS = [recording(seed) for seed in range(3)]
COLUMN = MODEL.dof_index


def test_margins_are_those_of_p2() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    q = np.concatenate([r.active.q for r in RECORDINGS])
    for name, margin in (("PelvisTransX", 0.02), ("rForeArmTrans", 0.02), ("rShoulderTransZ", 0.02),
                         ("PelvisRotZ", 0.05), ("PelvisRotX", 0.05)):  # fmt: skip
        k = COLUMN[name]
        assert not bounds.free[k]
        assert bounds.lower[k] == pytest.approx(q[:, k].min() - margin)
        assert bounds.upper[k] == pytest.approx(q[:, k].max() + margin)
    assert [name for name, free in zip(MODEL.dof_names, bounds.free, strict=True) if free] == [
        "TorsoX", "TorsoZ", "TorsoY", "rShoulderY1", "rShoulderX", "rShoulderY2", "rElbowZ", "rElbowX", "rElbowY",
        "rWristZ", "rWristX", "rWristY",
    ]  # fmt: skip


def test_free_rotations_may_go_half_a_turn_from_the_reach_wherever_that_is() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    k = COLUMN["rElbowZ"]
    start, goal = START.copy(), GOAL.copy()
    start[k] += 2.0 * np.pi
    goal[k] += 2.0 * np.pi
    lower, upper = bounds.around(START, GOAL)
    shifted_lower, shifted_upper = bounds.around(start, goal)
    assert shifted_lower[k] == pytest.approx(lower[k] + 2.0 * np.pi)
    assert shifted_upper[k] == pytest.approx(upper[k] + 2.0 * np.pi)
    assert upper[k] - lower[k] >= 2.0 * np.pi


def test_a_reach_beyond_the_demonstrations_widens_its_bounds() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    goal = GOAL.copy()
    goal[0] = 3.0
    lower, upper = bounds.around(START, goal)
    assert upper[0] == 3.0
    assert lower[0] == bounds.lower[0]
    assert (lower <= START).all()
    assert (upper >= goal).all()


def test_bounds_of_p2s_recordings() -> None:
    bounds = PostureBounds.from_recordings(load_reach_recordings(shared_data("icra2015/demos")), MODEL)
    # What the recordings do, minus and plus the margins.
    for name, low, high, margin in (("PelvisTransX", 1.9657, 2.1621, 0.02), ("PelvisRotZ", 1.8006, 2.3606, 0.05),
                                    ("rForeArmTrans", 0.1881, 0.2509, 0.02)):  # fmt: skip
        k = COLUMN[name]
        assert bounds.lower[k] == pytest.approx(low - margin, abs=1e-4)
        assert bounds.upper[k] == pytest.approx(high + margin, abs=1e-4)


def test_relative_bounds_go_with_the_reach_and_leave_as_much_room_as_demonstrations_took() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL, relative=True)
    k, free = COLUMN["PelvisTransX"], COLUMN["rElbowZ"]
    paths = [recording.active.q[:, k] for recording in RECORDINGS]
    farthest = max(float(path.max() - max(path[0], path[-1])) for path in paths)
    for moved in (0.0, 1.5):  # wherever somebody stands
        start, goal = START.copy(), GOAL.copy()
        start[k] += moved
        goal[k] += moved
        lower, upper = bounds.around(start, goal)
        assert upper[k] - max(start[k], goal[k]) == pytest.approx(farthest + 0.02)
        assert (lower < np.minimum(start, goal)).all()
        assert upper[free] - max(start[free], goal[free]) == pytest.approx(np.pi)


def test_relative_bounds_of_p2s_recordings_hold_the_recordings_and_leave_the_trunk_little_room() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    bounds = PostureBounds.from_recordings(recordings, MODEL, relative=True)
    for entry in recordings:
        q = entry.active.q
        lower, upper = bounds.around(q[0], q[-1])
        assert (q >= lower).all()
        assert (q <= upper).all()
    k = COLUMN["PelvisTransX"]
    absolute = PostureBounds.from_recordings(recordings, MODEL)
    still = recordings[0].active.q[0]
    lower, upper = bounds.around(still, still)
    assert upper[k] - lower[k] < 0.06 < 0.23 < absolute.upper[k] - absolute.lower[k]
    # Whether a goal is plausible still follows from where demonstrations ended.
    far = still.copy()
    far[k] += 3.0
    with pytest.raises(GoalUnreachableError):
        bounds.check_goal("far", far)


def test_bad_input_is_refused() -> None:
    with pytest.raises(MotionError, match="room beyond"):
        PostureBounds(np.zeros(3), np.ones(3), np.zeros(3, dtype=np.bool_), beyond=np.zeros((2, 3)))
    with pytest.raises(MotionError, match="at least one"):
        PostureBounds.from_recordings([], MODEL)
    with pytest.raises(MotionError, match="lower < upper"):
        PostureBounds(np.ones(3), np.zeros(3), np.zeros(3, dtype=np.bool_))


def test_goals_beyond_the_demonstrations_are_told_by_name() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    assert bounds.check_goal("r", GOAL) == ()
    goal = GOAL.copy()
    goal[COLUMN["rForeArmTrans"]] += 0.1
    goal[COLUMN["PelvisRotZ"]] -= 0.9
    goal[COLUMN["rElbowZ"]] += 3.0  # a free rotation
    said = bounds.check_goal("r", goal)
    assert [text.split(",")[0] for text in said] == [
        "r: goal with PelvisRotZ 1.300",
        "r: goal with rForeArmTrans 0.345",
    ]
    assert all("bounds are widened for it" in text for text in said)


def test_goals_out_of_reach_are_refused_by_name() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    goal = GOAL.copy()
    goal[0] += 3.0
    with pytest.raises(GoalUnreachableError, match=r"made_up: goal with PelvisTransX 5.050.*within reach"):
        bounds.check_goal("made_up", goal)
    with pytest.raises(MotionError, match="made_up: goal"):
        bounds.check_goal("made_up", goal[:5])


def test_goals_of_p2s_recordings_are_within_reach_of_the_others() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    for left_out in recordings:
        others = [entry for entry in recordings if entry.name != left_out.name]
        bounds = PostureBounds.from_recordings(others, MODEL)
        assert len(bounds.check_goal(left_out.name, left_out.active.q[-1])) <= 1


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
