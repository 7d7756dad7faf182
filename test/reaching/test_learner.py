"""Weights come with how sure they are and where they are from; impossible samples and doubtful recordings stay out."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros import __version__
from humanpred_ros.errors import HumanModelError, MotionError, SettingsError, UsageError
from humanpred_ros.geometry.solids import Box, Obstacle, planar_pose
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import Jump, ReachRecording, load_reach_recordings
from humanpred_ros.reaching.demonstrations import SamplingSettings
from humanpred_ros.reaching.features import N_FEATURES
from humanpred_ros.reaching.learner import LearningSettings, ReachLearner, recording_hash
from humanpred_ros.reaching.piirl import PiirlSettings
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.reaching.weights import ReachWeights

CONFIG = LearningSettings(
    n_waypoints=30,
    sampling=SamplingSettings(n_samples=40, deviation=5e-3),
    piirl=PiirlSettings(normalised=True, with_demonstration=True, l2=0.1),
    bootstrap=5,
)
RECORDINGS = [recording(seed) for seed in range(3)]
RECORDINGS.append(dataclasses.replace(recording(3), jumps=(Jump("active", 95, "right_wrist", 7.0),)))


@pytest.fixture(scope="module")
def learner() -> ReachLearner:
    return ReachLearner(RECORDINGS, MODEL, CONFIG)


@pytest.fixture(scope="module")
def weights(learner: ReachLearner) -> ReachWeights:
    return learner.learn()


def test_weights_are_non_negative_and_tell_their_origin(weights: ReachWeights) -> None:
    assert (weights.weights >= 0.0).all()
    assert weights.bootstrap.shape == (5, N_FEATURES)
    assert np.isfinite(weights.spread).all()
    assert weights.provenance["recordings"] == ["made_up_0", "made_up_1", "made_up_2", "made_up_3"]
    assert weights.provenance["config"]["sampling"]["n_samples"] == 40
    assert weights.provenance["demonstrations"][:3] == ["made_up_0", "made_up_0+1", "made_up_0+11"]
    assert set(weights.provenance["samples"]) == {40}
    assert weights.provenance["package_version"] == __version__
    assert weights.provenance["config"]["seed"] == 0
    assert weights.provenance["human_signature"] == MODEL.signature
    assert "left_box" in weights.provenance["obstacles"]
    assert weights.provenance["sha256"]["made_up_1"] == recording_hash(RECORDINGS[1])


def test_recordings_of_one_name_are_told_apart_by_what_is_in_them() -> None:
    one = RECORDINGS[0]
    q = one.active.q.copy()
    q[50, 3] += 1e-9
    assert recording_hash(one) == recording_hash(recording(0))
    assert recording_hash(one) != recording_hash(dataclasses.replace(one, active=one.active.with_postures(q)))
    assert recording_hash(one) != recording_hash(dataclasses.replace(one, passive=one.passive.with_postures(q)))
    assert recording_hash(one) != recording_hash(ReachRecording(one.name, one.passive, one.active))


def test_a_recording_with_a_jump_is_left_out_with_a_message(learner: ReachLearner, weights: ReachWeights) -> None:
    assert learner.names == ("made_up_0", "made_up_1", "made_up_2")
    (text,) = weights.provenance["left_out"]
    assert "made_up_3" in text
    assert "frame 95" in text
    with pytest.raises(MotionError, match="at least one demonstration"):
        learner.learn(["made_up_3"])


def test_leaving_one_out_forgets_it(learner: ReachLearner, weights: ReachWeights) -> None:
    some = learner.learn(["made_up_0", "made_up_1"], bootstrap=False)
    assert not any("made_up_2" in name for name in some.provenance["demonstrations"])
    assert (some.weights != weights.weights).any()
    alone = ReachLearner(RECORDINGS[:2], MODEL, CONFIG).learn(bootstrap=False)
    np.testing.assert_allclose(some.weights, alone.weights, rtol=1e-6)
    assert np.isnan(some.spread).all()


def test_the_same_seed_gives_the_same_weights(weights: ReachWeights) -> None:
    again = ReachLearner(RECORDINGS, MODEL, CONFIG).learn()
    np.testing.assert_array_equal(again.weights, weights.weights)
    np.testing.assert_array_equal(again.bootstrap, weights.bootstrap)
    other = ReachLearner(RECORDINGS, MODEL, CONFIG.replaced(seed=1)).learn(bootstrap=False)
    assert (other.weights != weights.weights).any()


def test_weights_at_their_bound_are_named() -> None:
    config = CONFIG.replaced(piirl=PiirlSettings(upper=1e-3), bootstrap=0)
    found = ReachLearner(RECORDINGS[:1], MODEL, config).learn()
    assert "posture velocity" in found.at_upper


def test_unknown_recordings_are_refused(learner: ReachLearner) -> None:
    with pytest.raises(UsageError, match="got tomorrow"):
        learner.learn(["tomorrow"])


def test_learning_from_one_name_twice_or_another_human_is_refused() -> None:
    with pytest.raises(UsageError, match="different names, got made_up_0 more than once"):
        ReachLearner([recording(0), recording(1), recording(0)], MODEL, CONFIG)
    with pytest.raises(HumanModelError, match="wanted its 12 DoFs"):
        ReachLearner(RECORDINGS, HumanModel.kinect12(), CONFIG)


def test_what_is_left_out_is_logged_and_said_where_nothing_is_left(caplog: pytest.LogCaptureFixture) -> None:
    short = recording(5, n_frames=6)
    for keep in (False, True):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            learner = ReachLearner([short], MODEL, CONFIG.replaced(keep_unfit=keep))
        (text,) = learner.notes
        assert text.startswith("made_up_5: 6 frames, the jerk's difference needs 7")
        assert text in caplog.messages
        with pytest.raises(MotionError, match=r"got none.*made_up_5: 6 frames"):
            learner.learn()
    with pytest.raises(MotionError, match=r"got none.*no recordings"):
        ReachLearner([], MODEL, CONFIG).learn()


def test_who_asks_for_it_learns_from_jumps_and_is_told() -> None:
    learner = ReachLearner(RECORDINGS, MODEL, CONFIG.replaced(keep_unfit=True))
    assert learner.names == tuple(entry.name for entry in RECORDINGS)
    (text,) = [note for note in learner.notes if note.endswith("learned from all the same")]
    assert text.startswith("made_up_3: the reaching person's right wrist jumps at frame 95")
    assert learner.learn(bootstrap=False).provenance["left_out"] == []
    assert text not in learner.learn(["made_up_0"]).provenance["notes"]


def test_one_recording_does_not_say_how_sure_it_is(learner: ReachLearner) -> None:
    alone = learner.learn(["made_up_0", "made_up_0"])
    assert alone.provenance["recordings"] == ["made_up_0"]
    assert alone.bootstrap.shape == (0, N_FEATURES)
    assert np.isnan(alone.spread).all()
    np.testing.assert_array_equal(alone.weights, learner.learn(["made_up_0"]).weights)


def test_notes_find_their_recording_whatever_its_name() -> None:
    odd = dataclasses.replace(recording(3, n_frames=6), name="monday: third: try")
    learner = ReachLearner([RECORDINGS[0], odd], MODEL, CONFIG)
    assert any("monday: third: try: 6 frames" in text for text in learner.learn().provenance["notes"])


def test_samples_of_a_recording_do_not_depend_on_those_after_it() -> None:
    few = CONFIG.replaced(cut=False)
    alone, beside = (ReachLearner(RECORDINGS[:n], MODEL, few) for n in (1, 3))
    np.testing.assert_array_equal(*(each.learn(["made_up_0"]).weights for each in (alone, beside)))


def test_what_comes_after_a_jump_is_learned_from_and_said() -> None:
    jumping = dataclasses.replace(recording(3, n_frames=140), jumps=(Jump("active", 5, "right_wrist", 7.0),))
    learner = ReachLearner([jumping], MODEL, CONFIG)
    assert learner.names == ("made_up_3",)
    assert "jumps at frame 5" in learner.notes[0]
    assert "later part" in learner.notes[0]


def crate(entry: ReachRecording, size_m: float = 0.15) -> Surroundings:
    """A box around where the hand is in the middle of the reach."""
    place = MODEL.forward(entry.active.q)["right_palm"][len(entry.active) // 2]
    box = Obstacle("crate", Box(size_m, size_m, size_m), planar_pose(*place))
    return Surroundings((box,), np.array([0.9, 0.3, 0.6]), np.array([2.6, 2.0, 1.9]))


def test_colliding_samples_are_discarded_and_counted() -> None:
    one = RECORDINGS[0]
    beside = dataclasses.replace(crate(one).obstacles[0], T_world_shape=planar_pose(1.75, 1.15, 1.05))
    scene = Surroundings((beside,), np.array([0.9, 0.3, 0.6]), np.array([2.6, 2.0, 1.9]))
    config = CONFIG.replaced(cut=False, bootstrap=0)
    weights = ReachLearner([one], MODEL, config, scene).learn()
    (discarded,) = weights.provenance["discarded"]
    assert discarded > 5
    assert weights.provenance["samples"] == [40]
    blind = ReachLearner([one], MODEL, config.replaced(collisions=False), scene).learn()
    assert blind.provenance["discarded"] == [0]
    assert (blind.weights != weights.weights).any()


def test_a_demonstration_that_is_in_something_is_named_and_learned_from(caplog: pytest.LogCaptureFixture) -> None:
    one = RECORDINGS[0]
    with caplog.at_level(logging.WARNING):
        learner = ReachLearner(RECORDINGS[:2], MODEL, CONFIG, crate(one))
    (text,) = [note for note in learner.notes if "in crate" in note and note.startswith("made_up_0: right hand")]
    assert "check that the scene stands" in text  # more than 5 cm
    assert text in caplog.messages
    assert text in learner.learn(bootstrap=False).provenance["notes"]
    assert text not in learner.learn(["made_up_1"], bootstrap=False).provenance["notes"]


def narrow(gap_m: float) -> Surroundings:
    """Floor and ceiling that leave the hand of the first recording so much room."""
    heights = MODEL.forward(RECORDINGS[0].active.q)["right_palm"][:, 2]
    low, high = float(heights.min()) - 0.05 - gap_m, float(heights.max()) + 0.05 + gap_m
    places = {"floor": planar_pose(1.8, 1.6, low - 50.0), "ceiling": planar_pose(1.8, 1.6, high + 50.0)}
    slabs = tuple(Obstacle(name, Box(400.0, 400.0, 100.0), T) for name, T in places.items())
    return Surroundings(slabs, np.array([0.9, 0.3, 0.6]), np.array([2.6, 2.0, 1.9]))


def test_if_all_samples_collide_the_recording_and_the_reason_are_named() -> None:
    wild = CONFIG.replaced(sampling=SamplingSettings(n_samples=20, deviation=0.1, attempts=3))
    with pytest.raises(MotionError, match=r"made_up_0.*all 3 x 20 do, most with .* into .*(floor|ceiling|partner)"):
        ReachLearner(RECORDINGS[:1], MODEL, wild, narrow(0.01))


def test_if_samples_are_lacking_the_recording_is_named(caplog: pytest.LogCaptureFixture) -> None:
    few = CONFIG.replaced(cut=False, sampling=SamplingSettings(n_samples=40, deviation=2e-2, attempts=1))
    with caplog.at_level(logging.WARNING):
        learner = ReachLearner(RECORDINGS[:1], MODEL, few, crate(RECORDINGS[0]))
    (text,) = [note for note in learner.notes if "samples" in note and "of 40" in note]
    assert text.startswith("made_up_0: ")
    assert text in caplog.messages
    assert learner.learn(bootstrap=False).provenance["samples"][0] < 40


@pytest.mark.parametrize("bad", [{"bootstrap": -1}, {"seed": -1}])
def test_impossible_settings_are_refused(bad: dict[str, int]) -> None:
    with pytest.raises(SettingsError, match=next(iter(bad))):
        LearningSettings(**bad)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("weights", "at_upper", "text"),
    [(-np.ones(N_FEATURES), (), "0 or more"), (np.ones(N_FEATURES), ("speed",), "names of features, got speed"),
     (np.ones(3), (), "wanted shape"), (np.full(N_FEATURES, np.nan), (), "finite")],
)  # fmt: skip
def test_impossible_weights_are_refused(weights: np.ndarray, at_upper: tuple[str, ...], text: str) -> None:
    with pytest.raises(MotionError, match=text):
        ReachWeights(weights, np.zeros((0, N_FEATURES)), at_upper, {})


def test_half_of_the_papers_samples_run_into_something() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    config = LearningSettings(cut=False, keep_unfit=True, sampling=SamplingSettings(n_samples=60), bootstrap=0)
    found = ReachLearner(recordings, MODEL, config).learn().provenance
    assert found["samples"] == [60] * 7
    assert 0.5 < sum(found["discarded"]) / (sum(found["discarded"]) + 420) < 0.75
