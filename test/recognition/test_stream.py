"""A classifier on a stream: undecided at rest, and at an onset the motion so far, shown as it was learned."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from small_library import DOF_NAMES, REST, small_library

from humanpred_ros.errors import ArrayError, HumanPredError, MotionError, SettingsError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.stream import StreamClassifier, StreamSettings


@cache
def library() -> MotionLibrary:
    return small_library(3, 8, 90, there_and_back=True)


@cache
def fitted() -> ForestClassifier:
    return ForestClassifier(HumanModel.kinect12(), ForestSettings(n_trees=30)).fit(library())


def streaming(**settings: object) -> StreamClassifier:
    return StreamClassifier(fitted().fresh(), **settings)  # type: ignore[arg-type]


def unseen(label: int, seed: int) -> Motion:
    return small_library(3, 1, 90, there_and_back=True, seed=seed).motions[label]


def stream(labels: list[int], rest_s: float = 2.0) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return stamps, postures, and when each motion begins: motions of the classes with rest before and after."""
    rng = np.random.default_rng(0)
    postures, begins, n_rest = [], [], round(rest_s * 60)
    for k, label in enumerate(labels):
        motion = unseen(label, seed=50 + k)
        # The stance is the same throughout: nobody jumps from one place to another.
        reach = REST + (motion.q - motion.q[0])
        postures.append(REST + rng.normal(0.0, 0.002, (n_rest, 12)))
        begins.append(sum(len(part) for part in postures) / 60)
        postures.append(reach)
    postures.append(REST + rng.normal(0.0, 0.002, (n_rest, 12)))
    q = np.vstack(postures)
    return np.arange(len(q)) / 60, q, begins


def answers(classifier: StreamClassifier, t: np.ndarray, q: np.ndarray) -> list[ClassPosterior]:
    return [classifier.update(posture, float(stamp)) for posture, stamp in zip(q, t, strict=True)]


def test_every_motion_of_a_stream_is_recognised() -> None:
    labels = [2, 0, 1, 1, 2, 0]
    t, q, begins = stream(labels)
    classifier = streaming()
    posteriors = answers(classifier, t, q)
    for label, begin in zip(labels, begins, strict=True):
        assert posteriors[round((begin + 0.6 * 1.5) * 60)].best == str(10 * label)
    assert classifier.motion_state is not None
    assert classifier.motion_state.n_motions == len(labels)
    for posterior in posteriors:
        assert abs(posterior.probability.sum() + posterior.unknown - 1.0) < 1e-9


def test_at_rest_all_classes_are_equal() -> None:
    t, q, begins = stream([0, 1])
    posteriors = answers(streaming(), t, q)
    for at in (1.0, begins[1] - 0.3, t[-1]):
        posterior = posteriors[round(at * 60)]
        np.testing.assert_allclose(posterior.probability, [1 / 3] * 3)
        assert (posterior.unknown, posterior.n_frames) == (0.0, 0)


class Renamed(Classifier):
    """Says what another classifier says, with other labels once it is told so."""

    offset = 0

    def __init__(self, other: Classifier) -> None:
        super().__init__(other.human)
        self.other = other

    def fit(self, library: MotionLibrary) -> Classifier:
        raise NotImplementedError

    def start(self) -> None:
        self.other.start()

    def update(self, q: np.ndarray, t_s: float) -> ClassPosterior:
        posterior = self.other.update(q, t_s)
        return replace(posterior, labels=tuple(label + "x" * self.offset for label in posterior.labels))


def test_classes_may_change_at_rest_and_in_motion() -> None:
    t, q, begins = stream([2, 0])
    at_rest, moving = round(1.0 * 60), round((begins[1] + 0.8) * 60)
    classifier = Renamed(fitted().fresh())
    changing, constant = StreamClassifier(classifier), streaming()
    for k, (posture, stamp) in enumerate(zip(q, t.tolist(), strict=True)):
        if k in (at_rest, moving):
            classifier.offset += 1
            changing.classes_changed()
        posterior, expected = changing.update(posture, stamp), constant.update(posture, stamp)
        assert posterior.labels == tuple(label + "x" * ((k >= at_rest) + (k >= moving)) for label in expected.labels)
        np.testing.assert_array_equal(posterior.probability, expected.probability)


def test_what_is_refused_changes_nothing() -> None:
    t, q, _ = stream([1], rest_s=1.0)
    one, other = streaming(), streaming()
    refused = 0
    for k, (posture, stamp) in enumerate(zip(q, t, strict=True)):
        a, b = one.update(posture, float(stamp)), other.update(posture, float(stamp))
        np.testing.assert_array_equal(a.probability, b.probability)
        if k % 7 == 6:
            for bad, at, error in (
                (np.full(12, np.nan), stamp + 0.001, HumanPredError),
                (np.zeros(5), stamp + 0.001, HumanPredError),
                (posture, stamp, MotionError),
            ):
                with pytest.raises(error):
                    other.update(bad, float(at))
                refused += 1
    assert refused > 20


def test_a_jump_of_the_clock_starts_anew() -> None:
    t, q, begins = stream([1])
    k = round((begins[0] + 0.9) * 60)
    classifier = streaming()
    assert answers(classifier, t[:k], q[:k])[-1].n_frames > 0
    assert classifier.update(q[k], float(t[k]) + 5.0).n_frames == 0


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(SettingsError, match="most_replayed"):
        StreamSettings(most_replayed=0)


ELBOW = DOF_NAMES.index("rElbowZ")


class Witness(Classifier):
    """Remembers what it is shown since the last start; refuses postures whose elbow is bent beyond reason."""

    def __init__(self) -> None:
        super().__init__(HumanModel.kinect12())
        self.shown: list[float] = []
        self.starts = 0

    def fit(self, library: MotionLibrary) -> Witness:
        return self

    def start(self) -> None:
        self.starts += 1
        self.shown = []

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        if q[ELBOW] > 100.0:
            raise ArrayError("witness: wanted an elbow")
        if self.shown and t_s <= self.shown[-1]:
            raise UsageError("witness: out of order")
        self.shown.append(t_s)
        return ClassPosterior(("0", "1"), np.array([0.9, 0.1]), np.zeros(2), t_s, len(self.shown))


def reach_and_back(rest_s: float = 3.0, rate_hz: float = 60.0, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Return stamps and postures: rest, a reach and back that takes 1.5 s, rest."""
    n = round(1.5 * rate_hz)
    motion = small_library(1, 1, n, there_and_back=True, seed=7).motions[0]
    rng = np.random.default_rng(seed)
    rest = [REST + rng.normal(0.0, 0.002, (round(rest_s * rate_hz), 12)) for _ in range(2)]
    q = np.vstack([rest[0], REST + motion.q - motion.q[0], rest[1]])
    return np.arange(len(q)) / rate_hz, q


def onset_of(stream: StreamClassifier, t: FloatArray, q: FloatArray) -> int:
    """Show postures until an onset is found; return the number of the posture it was found at."""
    for k, (posture, stamp) in enumerate(zip(q, t.tolist(), strict=True)):
        stream.update(posture, stamp)
        if stream.motion_state is not None and stream.motion_state.moving:
            return k
    raise AssertionError("no onset")


@pytest.mark.parametrize("lead_in_s", [0.0, 0.2])
def test_nothing_of_the_early_motion_is_lost(lead_in_s: float) -> None:
    t, q = reach_and_back()
    witness = Witness()
    stream = StreamClassifier(witness, StreamSettings(lead_in_s=lead_in_s, most_replayed=1000))
    k = onset_of(stream, t, q)
    assert stream.motion_state is not None
    expected = t[(t >= stream.motion_state.since_s - lead_in_s) & (t <= t[k])]
    np.testing.assert_array_equal(witness.shown, expected)
    for more in range(k + 1, k + 10):
        assert stream.update(q[more], float(t[more])).n_frames == len(expected) + more - k


def test_no_more_is_shown_at_once_than_allowed_and_the_present_always() -> None:
    t, q = reach_and_back()
    for most in (1, 2, 5):
        witness = Witness()
        stream = StreamClassifier(witness, StreamSettings(lead_in_s=0.3, most_replayed=most))
        k = onset_of(stream, t, q)
        assert len(witness.shown) == most
        assert witness.shown[-1] == t[k]


def test_at_rest_the_classifier_is_left_alone() -> None:
    t, q = reach_and_back(rest_s=20.0)
    witness = Witness()
    stream = StreamClassifier(witness)
    n = round(20.0 * 60)
    for posture, stamp in zip(q[:n], t[:n].tolist(), strict=True):
        assert stream.update(posture, stamp).n_frames == 0
    assert witness.starts < 0.1 * n


def test_a_posture_that_the_classifier_refuses_changes_nothing() -> None:
    t, q = reach_and_back()
    one, other = StreamClassifier(Witness()), StreamClassifier(Witness())
    refused = 0
    for posture, stamp in zip(q, t.tolist(), strict=True):
        a, b = one.update(posture, stamp), other.update(posture, stamp)
        np.testing.assert_array_equal(a.probability, b.probability)
        assert (a.n_frames, one.motion_state) == (b.n_frames, other.motion_state)
        if one.motion_state is not None and one.motion_state.moving:
            bent = posture.copy()
            bent[ELBOW] = 101.0
            with pytest.raises(ArrayError):
                other.update(bent, stamp + 0.001)
            refused += 1
    assert refused > 20


def test_the_classes_are_known_from_the_first_posture_on() -> None:
    posterior = StreamClassifier(Witness()).update(REST, 0.0)
    assert posterior.labels == ("0", "1")
    np.testing.assert_allclose(posterior.probability, [0.5, 0.5])


def test_the_rest_shown_is_as_long_as_the_library_s() -> None:
    motions = []
    for k in range(5):
        t, q = reach_and_back(rest_s=0.4 + 0.05 * k, seed=k)
        motions.append(Motion(t, q, DOF_NAMES, 0, k))
    library = MotionLibrary("lib", tuple(motions))
    whole = StreamClassifier(Witness()).fit(library)
    assert whole.lead_in_s == pytest.approx(0.55, abs=0.12)
    assert StreamClassifier(Witness(), StreamSettings(lead_in_s=0.1)).fit(library).lead_in_s == 0.1


def test_a_stream_may_run_for_long() -> None:
    """What is remembered does not grow."""
    t, q = reach_and_back()
    stream = StreamClassifier(Witness())
    for turn in range(3):
        for posture, stamp in zip(q, t.tolist(), strict=True):
            stream.update(posture, stamp + turn * 7.6)
        assert len(stream._buffer) < 60
        assert len(stream._detector._recent) < 40
