"""A synthetic library is what it says: a recording session with nobody in it, as hard to read as a real one."""

from __future__ import annotations

import json

import numpy as np
import pytest
from library_statistics import LibraryStatistics

from humanpred_ros import __version__
from humanpred_ros.errors import ArrayError, GoalUnreachableError, MotionError, SettingsError
from humanpred_ros.human.kinect import KINECT12_DOFS, KinectSkeleton
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import read_library_bag, write_library_bag
from humanpred_ros.motion.cleaning import DROP_REASONS, flag_library, goal_m
from humanpred_ros.motion.motion import SKELETON_POINTS, MotionLibrary
from humanpred_ros.motion.synthetic import DepthCameraConfig, ReachGeneratorConfig, generate_library, table_grid


def generate(seed: int = 0, **changes: object) -> MotionLibrary:
    return generate_library(ReachGeneratorConfig(**changes), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def library() -> MotionLibrary:
    return generate(motions_per_class=12)


@pytest.fixture(scope="module")
def statistics(library: MotionLibrary) -> LibraryStatistics:
    return LibraryStatistics(library)


def same(a: MotionLibrary, b: MotionLibrary) -> bool:
    return len(a) == len(b) and all(
        x.name == y.name
        and np.array_equal(x.t_s, y.t_s)
        and np.array_equal(x.q, y.q)
        and np.array_equal(x.points_m, y.points_m, equal_nan=True)
        for x, y in zip(a, b, strict=True)
    )


def test_the_same_seed_gives_the_same_library_and_another_seed_another() -> None:
    assert same(generate(3, motions_per_class=1), generate(3, motions_per_class=1))
    assert not same(generate(3, motions_per_class=1), generate(4, motions_per_class=1))


def test_provenance_tells_how_to_make_it_again() -> None:
    config = ReachGeneratorConfig(motions_per_class=1, goal_spread_m=(0.01, 0.0, 0.0))
    provenance = generate_library(config, np.random.default_rng(42)).provenance
    assert provenance["source"].startswith("synthetic")
    assert provenance["seed"].split()[0] == "42"
    assert provenance["generator"].endswith(__version__)
    told = json.loads(provenance["config"])
    assert told["goal_spread_m"] == [0.01, 0.0, 0.0]
    assert told["camera"]["rate_hz"] == config.camera.rate_hz


def test_a_used_generator_is_not_passed_off_as_its_seed() -> None:
    rng = np.random.default_rng(42)
    rng.normal()
    provenance = generate_library(ReachGeneratorConfig(motions_per_class=1), rng).provenance
    assert provenance["seed"].startswith("unknown")


def test_classes_are_recorded_in_turns(library: MotionLibrary) -> None:
    labels = np.array([int(motion.label or 0) for motion in library]).reshape(12, 8)
    assert (np.sort(labels, axis=1) == np.arange(8)).all()
    assert len({tuple(row) for row in labels}) > 6  # shuffled, so that neither drift nor the motion before tells
    assert [motion.index for motion in library] == [k // 8 for k in range(96)]
    ascending = generate(motions_per_class=2, order="ascending")
    assert [motion.label for motion in ascending] == [*"01234567"] * 2


def test_the_start_does_not_give_the_class_away(statistics: LibraryStatistics) -> None:
    # 96 guesses with chance 1/8: more than 0.25 happens once in a thousand libraries.
    assert statistics.class_found[0] < 0.25


def test_reaches_can_be_told_apart_later_but_not_early(statistics: LibraryStatistics) -> None:
    assert statistics.class_found[2] < 0.3
    assert statistics.class_found[3] < 0.6
    assert statistics.class_found[5:7].min() > 0.6


def test_it_resembles_the_recorded_libraries(statistics: LibraryStatistics) -> None:
    """Ranges around library_b (docs/papers.md, P1 library) and, for times, library_a's stamps (one way 1.58 s)."""
    assert 2.4 < statistics.duration_s.p50 < 4.0
    assert statistics.frame_period_s.p50 == pytest.approx(1 / 30, rel=0.02)
    assert 0.25 < statistics.mean_speed_m_s.p50 < 0.6
    assert 0.7 < statistics.peak_speed_m_s.p50 < 1.4
    assert 1.2 < statistics.path_m.p50 < 1.8
    assert 0.5 < statistics.reach_m.p50 < 0.75
    assert 0.17 < statistics.leave_phase.p50 < 0.28
    assert 0.45 < statistics.apex_phase.p50 < 0.62
    assert statistics.end_m.p50 < 0.12
    assert (statistics.goal_spacing_m > 0.2).all()
    assert (statistics.goal_spacing_m < 0.29).all()
    assert 0.008 < statistics.goal_sd_m.min() < statistics.goal_sd_m.max() < 0.06
    ranges = dict(zip(statistics.dof_names, statistics.dof_range, strict=True))
    # Medians of library_b: 0.82 rad, 0.31 rad, 0.03 rad, 0.73 rad, 0.73 rad.
    assert 0.4 < ranges["PelvisRotZ"] < 1.1
    assert 0.15 < ranges["TorsoY"] < 0.45
    assert ranges["TorsoZ"] < 0.08
    assert 0.4 < ranges["rShoulderX"] < 1.2
    assert 0.4 < ranges["rShoulderZ"] < 1.1


def test_nothing_moves_at_first_and_the_hand_returns(library: MotionLibrary) -> None:
    human = HumanModel.kinect12()
    for motion in library:
        away = np.linalg.norm(human.forward(motion.q)["right_palm"] - human.forward(motion.q[0])["right_palm"], axis=1)
        assert away[: len(motion) // 20].max() < 0.05
        assert away[-1] < 0.45 * away.max()
        assert 0.3 < motion.t_s[away.argmax()] / motion.duration_s < 0.75


def test_palms_reach_their_own_goals(library: MotionLibrary) -> None:
    human, goals = HumanModel.kinect12(), np.array(ReachGeneratorConfig().goals_m)
    for motion in library:
        distance = np.linalg.norm(goals - goal_m(motion, human), axis=1)
        assert str(distance.argmin()) == motion.label
        assert distance.min() < 0.12
    assert not [flag for flag in flag_library(library) if flag.reason in DROP_REASONS]


def test_postures_are_what_the_noisy_points_say(library: MotionLibrary) -> None:
    skeleton = KinectSkeleton()
    for motion in list(library)[:20]:
        told = skeleton.postures(motion.points_m)
        assert told.complete.all()
        np.testing.assert_allclose(motion.q, told.q, atol=2.0**-18)


def test_frames_without_a_posture_are_left_out_and_points_not_needed_may_be_missing(library: MotionLibrary) -> None:
    lost = np.concatenate([np.isnan(motion.points_m).any(axis=-1) for motion in library])
    needed = [SKELETON_POINTS.index(name) for name in ("torso", "neck", "right_elbow", "right_hand", "left_hip")]
    assert not lost[:, needed].any()
    assert lost[:, SKELETON_POINTS.index("left_knee")].any()
    gaps = np.concatenate([np.diff(motion.t_s) for motion in library]) > 0.05
    assert gaps.any()


def test_a_perfect_camera_leaves_nothing_out() -> None:
    clear = DepthCameraConfig(noise_m=0, wander_m=0, frame_loss=0, losses_per_s=0, leg_losses_per_s=0, smoothing=0)
    for motion in generate(motions_per_class=1, camera=clear):
        assert not np.isnan(motion.points_m).any()
        assert np.diff(motion.t_s).max() < 0.06


def test_goals_and_their_number_are_free() -> None:
    goals = table_grid(columns=3, rows=1)
    small = generate(motions_per_class=2, goals_m=goals, name="synthetic_row", frame_id="camera")
    assert (small.name, small.labels, small.frame_id, len(small)) == ("synthetic_row", ("0", "1", "2"), "camera", 6)
    assert small.dof_names == KINECT12_DOFS


def test_the_grid_is_four_by_two_and_spaced_like_the_recorded_one() -> None:
    goals = np.array(table_grid()).reshape(2, 4, 3)
    along = np.linalg.norm(np.diff(goals, axis=1), axis=-1)
    rows = np.linalg.norm(np.diff(goals, axis=0), axis=-1)
    assert ((along > 0.21) & (along < 0.28)).all()
    assert ((rows > 0.26) & (rows < 0.28)).all()


def test_a_goal_out_of_reach_is_refused_by_number() -> None:
    goals = (*table_grid()[:3], (0.4, 1.5, 0.6))
    with pytest.raises(GoalUnreachableError, match="goal 3"):
        generate(motions_per_class=1, goals_m=goals)


def test_a_camera_that_sees_nothing_is_refused() -> None:
    blind = DepthCameraConfig().replaced(losses_per_s=50.0, loss_s=10.0)
    with pytest.raises(MotionError, match="frames with a posture"):
        generate(motions_per_class=1, camera=blind)


@pytest.mark.parametrize(
    "bad",
    [
        {"motions_per_class": 0}, {"order": "random"}, {"round_share": 1.2}, {"drift_memory": 1.0},
        {"rest_spread": (-1.0,) * 12}, {"rest_q": (0.0,) * 11}, {"goals_m": ()}, {"goal_spread_m": (0.1, 0.1)},
    ],
)  # fmt: skip
def test_impossible_settings_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(SettingsError):
        ReachGeneratorConfig(**bad)


def test_goals_must_be_points() -> None:
    with pytest.raises((SettingsError, ArrayError), match="goals_m"):
        ReachGeneratorConfig(goals_m=((0.1, 0.2),))


def test_it_survives_a_bag_bit_for_bit(tmp_path: object) -> None:
    made = generate(motions_per_class=1)
    read = read_library_bag(write_library_bag(made, f"{tmp_path}/{made.name}"))
    assert same(made, read)
    assert dict(read.provenance) == dict(made.provenance)
