"""Goals are inferred from a partial reach, wherever the room is, however fast people move, whatever goals there are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reaching_people import MODEL as MOCAP
from reaching_people import reach
from small_library import small_library

from humanpred_ros.errors import (
    ArrayError,
    HumanModelError,
    HumanPredError,
    LibraryFormatError,
    MotionError,
    UsageError,
)
from humanpred_ros.evaluation.leave_one_out import at_speed
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, placed, turn_and_shift
from humanpred_ros.reaching.place_classifier import PlaceClassifier, PlaceModel, Places
from humanpred_ros.reaching.places import UnlistedPlaces, reach_ends
from humanpred_ros.recognition.stream import StreamClassifier

HUMAN = HumanModel.kinect12()


@cache
def library(there_and_back: bool = True) -> MotionLibrary:
    return small_library(4, 5, 50, there_and_back=there_and_back)


@cache
def fitted(there_and_back: bool = True) -> PlaceClassifier:
    return PlaceClassifier(HUMAN).fit(library(there_and_back))


def fresh(goals: Places | None = None, there_and_back: bool = True) -> PlaceClassifier:
    source = fitted(there_and_back)
    return PlaceClassifier(HUMAN, source.settings, source.model, goals or source.places)


def unseen(label: int, seed: int = 99, there_and_back: bool = True) -> Motion:
    return small_library(4, 1, 50, there_and_back=there_and_back, seed=seed).motions[label]


def answers(classifier: PlaceClassifier | StreamClassifier, motion: Motion) -> FloatArray:
    """Return (T, G + 1) the probabilities of the goals and of none."""
    classifier.start()
    posteriors = [classifier.update(q, t_s) for q, t_s in zip(motion.q, motion.t_s.tolist(), strict=True)]
    return np.array([np.append(p.probability, p.unknown) for p in posteriors])


@settings(max_examples=8)
@given(st.integers(0, 1000), st.integers(0, 3), st.booleans())
def test_posteriors_are_proper_and_reaches_are_understood_before_they_end(
    seed: int, label: int, there_and_back: bool
) -> None:
    p = answers(fresh(there_and_back=there_and_back), unseen(label, seed, there_and_back))
    np.testing.assert_allclose(p.sum(axis=1), 1.0, atol=1e-9)
    assert (p >= 0).all()
    np.testing.assert_allclose(p[0], [*np.full(4, 0.2), 0.2], atol=1e-9)  # nothing has happened yet
    assert p[34, :4].argmax() == label
    assert p[-1, :4].argmax() == label  # arrived, or back again


def test_goals_nobody_was_seen_to_reach_for_are_inferred() -> None:
    right = []
    for motion in library().motions:
        p = answers(fitted().fit_without(library(), motion.name), motion)
        right.append(library().labels[p[34, :4].argmax()] == motion.label)
    assert np.mean(right) > 0.8  # four classes of reaches that have little in common


def test_without_its_class_means_without_all_its_motions_but_with_its_place() -> None:
    rest = library().select(lambda motion: motion.label != "10")
    without, anew = fitted().fit_without(library(), "10/2"), PlaceClassifier(HUMAN).fit(rest)
    np.testing.assert_allclose(without.model.weights, anew.model.weights, rtol=1e-6)
    assert without.places is not None
    expected = Places.of_ends(reach_ends(library(), HUMAN), without_motion="10/2")
    np.testing.assert_allclose(without.places.places_m, expected.places_m, atol=1e-12)
    assert without.places.labels == library().labels
    other = fitted().fit_without(library(), "10/3")
    assert other.model is without.model  # 4 classes are 4 fits
    assert fitted().places is not None
    assert fitted().places.labels == library().labels


def test_learning_needs_a_library_and_leaving_out_needs_the_same_one() -> None:
    with pytest.raises(UsageError, match="call fit"):
        PlaceClassifier(HUMAN).fit_without(library(), "10/2")
    with pytest.raises(UsageError, match="call fit"):
        fitted().fit_without(library(False).select(lambda motion: motion.label != "0"), "10/2")
    with pytest.raises(LibraryFormatError, match="at least two classes"):
        PlaceClassifier(HUMAN).fit(library().select(lambda motion: motion.label == "0"))


@settings(max_examples=8)
@given(st.floats(-3, 3), st.lists(st.floats(-0.8, 0.8), min_size=3, max_size=3), st.integers(0, 3))
def test_another_room_changes_nothing(yaw: float, shift: list[float], label: int) -> None:
    T = turn_and_shift(yaw, shift)
    motion = unseen(label)
    goals = fitted().places
    assert goals is not None
    there = answers(fresh(goals.moved(T)), placed(motion, T))
    # The tracker's noise is filtered axis by axis, so that turning it makes a small difference.
    assert np.abs(there - answers(fresh(), motion)).mean() < 0.01
    shifted = turn_and_shift(0.0, shift)
    there = answers(fresh(goals.moved(shifted)), placed(motion, shifted))
    np.testing.assert_allclose(there, answers(fresh(), motion), atol=1e-5)


@settings(max_examples=8)
@given(st.permutations(range(4)), st.integers(0, 3))
def test_the_order_of_the_goals_does_not_matter(order: list[int], label: int) -> None:
    goals = fitted().places
    assert goals is not None
    motion = unseen(label)
    shuffled = fresh(Places(tuple(goals.labels[k] for k in order), goals.places_m[order]))
    np.testing.assert_allclose(answers(shuffled, motion), answers(fresh(), motion)[:, [*order, 4]], atol=1e-9)
    assert shuffled.update(motion.q[-1], 100.0).labels == tuple(goals.labels[k] for k in order)


@settings(max_examples=8)
@given(st.floats(-3, 3), st.integers(0, 3))
def test_a_goal_far_away_changes_little_once_the_reach_is_under_way(direction: float, label: int) -> None:
    goals = fitted().places
    assert goals is not None
    away = [3.0 * np.cos(direction), 3.0 * np.sin(direction), 1.0]
    motion = unseen(label)
    more, usual = answers(fresh(Places.of({**goals.by_label, 77: away})), motion), answers(fresh(), motion)
    assert np.abs(more[25:, :4] - usual[25:, :4]).max() < 0.12
    assert more[25:, 4].max() < 0.1


@pytest.mark.parametrize("speed", [0.7, 1.4])
def test_the_same_reach_at_another_speed_gets_nearly_the_same_answers(speed: float) -> None:
    at = np.linspace(0.2, 0.98, 30)
    for label in range(4):
        motion = unseen(label)
        a, b = answers(fresh(), motion), answers(fresh(), at_speed(motion, speed))
        difference = np.abs(a[(at * len(a)).astype(int)] - b[(at * len(b)).astype(int)])
        assert difference.mean() < 0.05


def test_30_hz_and_jittered_stamps_get_nearly_the_same_answers() -> None:
    rng = np.random.default_rng(5)
    for label in range(4):
        motion = unseen(label)
        usual = answers(fresh(), motion)
        half = answers(fresh(), Motion(motion.t_s[::2], motion.q[::2], motion.dof_names))
        assert np.abs(half - usual[::2]).mean() < 0.05
        late = motion.t_s + rng.uniform(0.0, 0.8 * motion.period_s, len(motion))
        assert np.abs(answers(fresh(), Motion(late, motion.q, motion.dof_names)) - usual).mean() < 0.03


@pytest.mark.parametrize("n_lost", [1, 5, 10])
@pytest.mark.parametrize("thrown_about", [False, True])
def test_a_lost_arm_is_forgiven_once_it_is_back(n_lost: int, thrown_about: bool) -> None:
    for label in range(4):
        motion = unseen(label)
        q = motion.q.copy()
        shift = np.random.default_rng(label).normal(0.0, 1.5, (n_lost, 1)) if thrown_about else 2.0
        q[15 : 15 + n_lost, 7:] += shift
        classifier = fresh()
        usual, lost = answers(fresh(), motion), answers(classifier, motion.with_postures(q))
        np.testing.assert_array_equal(lost[15 : 15 + n_lost], np.tile(lost[14], (n_lost, 1)))
        assert np.abs(lost - usual)[15 + n_lost + 7 :].max() < 0.15
        assert lost[34, :4].argmax() == label
        assert lost[-1, :4].argmax() == label


@pytest.mark.parametrize("n_wild", [1, 3])
def test_a_stream_that_begins_wildly_recovers(n_wild: int) -> None:
    motion = unseen(2)
    resting = Motion(np.arange(65) / 60, np.vstack([np.repeat(motion.q[:1], 15, axis=0), motion.q]), motion.dof_names)
    q = resting.q.copy()
    q[:n_wild, :3] += 2.0
    usual, wild = answers(fresh(), resting), answers(fresh(), resting.with_postures(q))
    np.testing.assert_allclose(wild[n_wild + 10 :], usual[n_wild + 10 :], atol=0.02)


def test_outliers_are_counted_and_their_time_passes() -> None:
    motion, classifier = unseen(0), fresh()
    for q, t_s in zip(motion.q[:15], motion.t_s[:15].tolist(), strict=True):
        before = classifier.update(q, t_s)
    after = classifier.update(motion.q[15] + 1.5, float(motion.t_s[15]))
    assert after.n_frames == before.n_frames + 1
    np.testing.assert_array_equal(after.probability, before.probability)
    np.testing.assert_array_equal(classifier.progress.posture, motion.q[14])


def test_goals_come_and_go_while_a_reach_is_under_way() -> None:
    goals, motion = fitted().places, unseen(2)
    assert goals is not None
    classifier = fresh(Places.of({label: place for label, place in goals.by_label.items() if label != "20"}))
    for q, t_s in zip(motion.q[:30], motion.t_s[:30].tolist(), strict=True):
        before = classifier.update(q, t_s)
    assert before.labels == ("0", "10", "30")
    classifier.set_places(goals)
    after = classifier.update(motion.q[30], float(motion.t_s[30]))
    expected = answers(fresh(), motion)[30]
    np.testing.assert_allclose([*after.probability, after.unknown], expected, atol=1e-9)
    assert after.n_frames == 31
    assert after.best == "20"


def test_a_single_goal_is_meant_or_none() -> None:
    goals = fitted().places
    assert goals is not None
    only = Places.of({"0": goals.by_label["0"]})
    towards, elsewhere = answers(fresh(only), unseen(0)), answers(fresh(only), unseen(2))
    np.testing.assert_allclose(towards.sum(axis=1), 1.0, atol=1e-9)
    assert towards[34, 1] < 0.1
    assert elsewhere[34, 1] > 0.8


@pytest.mark.parametrize("learned", [True, False])
def test_a_place_nobody_told_of_and_nobody_reached_for_is_none_of_them(learned: bool) -> None:
    goals = fitted().places
    assert goals is not None
    ends = fitted().model.ends
    assert ends is not None
    # A shelf: 0.4 m above the highest place anybody reached for.
    shelf = np.array([0.5, -0.3, goals.places_m[:, 2].max() + 0.4])
    start = unseen(0).q[0]
    phase = np.linspace(0.0, 1.0, 50)[:, None]
    q = start + phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2) * (ends.mean(start, shelf) - start)
    classifier = fresh() if learned else PlaceClassifier(HUMAN, places=goals)
    p = answers(classifier, Motion(np.arange(37) / 30.0, q[:37], unseen(0).dof_names))
    assert p[30, 4] > 0.5
    assert p[36, 4] > 0.8
    there = classifier.elsewhere(16)
    assert there.shape == (16, 3)
    assert np.median(there[:, 2]) > goals.places_m[:, 2].max() + 0.15
    apart = np.linalg.norm(there[:, None] - goals.places_m, axis=2)
    assert apart.min() >= classifier.settings.apart_m, "a place that was told is none that was not"


def test_with_places_told_everywhere_there_is_nothing_elsewhere() -> None:
    motion = unseen(1)
    side = np.linspace(-1.3, 1.3, 22)
    grid = np.stack(np.meshgrid(side + 0.5, side - 0.3, side + 0.6, indexing="ij"), axis=-1).reshape(-1, 3)
    classifier = fresh()
    classifier._unlisted = UnlistedPlaces(HUMAN, np.array([[0.6, 0.0, 0.0], [0.7, 0.2, 0.0]]), np.full(2, 0.5))
    classifier.set_places(Places(tuple(map(str, range(len(grid)))), grid))
    p = answers(classifier, Motion(motion.t_s[:4], motion.q[:4], motion.dof_names))
    assert (p[:, -1] < 1e-6).all()
    assert classifier.elsewhere(16).shape == (0, 3)


def test_goals_in_nearly_the_same_place_share_what_one_would_get() -> None:
    goals, motion = fitted().places, unseen(0)
    assert goals is not None
    twins = answers(fresh(Places.of({**goals.by_label, "5": goals.by_label["0"] + 1e-4})), motion)
    np.testing.assert_allclose(twins[:, 0], twins[:, 4], atol=0.02)
    assert twins[34, [0, 4]].sum() > 0.8
    with pytest.raises(UsageError, match="every label once"):
        Places(("1", "1"), np.zeros((2, 3)))


def test_thirty_goals_are_told_apart() -> None:
    goals, motion = fitted().places, unseen(3)
    assert goals is not None
    rng = np.random.default_rng(0)
    for k in range(26):
        goals = Places.of({**goals.by_label, f"part {k}": goals.by_label["0"] + rng.uniform(-0.5, 0.5, 3)})
    classifier = fresh(goals)
    p = answers(classifier, motion)
    np.testing.assert_allclose(p.sum(axis=1), 1.0, atol=1e-9)
    assert p[34, :30].argmax() == 3


def test_it_runs_on_a_stream() -> None:
    goals, motion = fitted().places, unseen(1)
    assert goals is not None
    rest = np.repeat(motion.q[:1], 60, axis=0) + np.random.default_rng(0).normal(0.0, 0.001, (60, 12))
    t_s = np.arange(110) * motion.period_s
    stream = StreamClassifier(fresh(goals))
    p = answers(stream, Motion(t_s, np.vstack([rest, motion.q]), motion.dof_names))
    np.testing.assert_allclose(p[:50, :4], 0.25)
    assert p[60 + 34, :4].argmax() == 1


def test_goals_out_of_reach_do_not_disturb_inference() -> None:
    goals, motion = fitted().places, unseen(0)
    assert goals is not None
    classifier = fresh(Places.of({**goals.by_label, 9: [6.0, 0.0, 1.0]}))
    assert answers(classifier, motion)[34].argmax() == 0


def test_one_reach_after_another_without_rest_is_judged_anew() -> None:
    goals = fitted().places
    assert goals is not None
    first, second = unseen(0), unseen(2)
    there, back = first.q, first.q[::-1]
    q = np.vstack([there, back[:-4], second.q])
    p = answers(fresh(goals), Motion(np.arange(len(q)) * first.period_s, q, first.dof_names))
    assert p[len(there) - 1].argmax() == 0
    assert p[-5].argmax() == 2


def test_what_cannot_be_judged_is_refused_and_changes_nothing() -> None:
    motion = unseen(0)
    with pytest.raises(UsageError, match="set_places"):
        PlaceClassifier(HUMAN).update(motion.q[0], 0.0)
    classifier, untouched = fresh(), fresh()
    broken = motion.q[0].copy()
    broken[3] = np.nan
    far = motion.q[0].copy()
    far[0] = 1e200
    for k, (q, t_s) in enumerate(zip(motion.q, motion.t_s.tolist(), strict=True)):
        for bad, stamp in ((broken, t_s), (q[:5], t_s), (far, t_s), (q, np.nan)):
            with pytest.raises(HumanPredError):
                classifier.update(bad, stamp)
        if k:
            with pytest.raises(MotionError, match="later than"):
                classifier.update(q, float(motion.t_s[k - 1]))
        np.testing.assert_array_equal(classifier.update(q, t_s).probability, untouched.update(q, t_s).probability)
    with pytest.raises(ArrayError, match="finite"):
        classifier.update(broken, 1e6)


def test_it_is_of_use_before_anything_was_learned() -> None:
    goals = fitted().places
    for label in range(4):
        p = answers(PlaceClassifier(HUMAN, places=goals), unseen(label))
        assert p[40, label] > max(0.35, p[40, 4])  # two of the goals are 8 cm apart


def test_weights_serve_another_human_and_end_postures_do_not() -> None:
    model = fitted().model
    with pytest.raises(HumanModelError, match="weights alone"):
        PlaceClassifier(MOCAP, model=model)
    assert PlaceClassifier(MOCAP, model=PlaceModel(model.weights)).model.ends is None


def test_people_seen_by_motion_capture_reach_for_goals_too() -> None:
    palm = MOCAP.forward(reach(0)[1][-1])["right_palm"]
    goals = Places((1, 2, 3), palm + np.array([[0.0, 0.0, 0.0], [0.35, 0.0, 0.0], [0.0, -0.4, 0.1]]))
    classifier = PlaceClassifier(MOCAP, model=PlaceModel.prior(), places=goals)
    for seed in range(4):
        t_s, q, _ = reach(seed)
        p = answers(classifier, Motion(t_s, q, MOCAP.dof_names))
        assert p[-1].argmax() == 0
