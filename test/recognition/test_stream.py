"""On an endless stream every motion is recognised as if it had come alone, and at rest the posterior is the prior."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, HumanPredError, MotionError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.stream import StreamClassifier, StreamConfig


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
        assert posteriors[round((begin + 0.6 * 1.5) * 60)].best == 10 * label
    assert classifier.motion_state is not None
    assert classifier.motion_state.n_motions == len(labels)
    for posterior in posteriors:
        assert abs(posterior.probability.sum() + posterior.unknown - 1.0) < 1e-9


def test_at_rest_the_posterior_is_the_prior() -> None:
    t, q, begins = stream([0, 1])
    for prior, expected in ((None, [1 / 3] * 3), ({0: 2.0, 10: 1.0, 20: 1.0}, [0.5, 0.25, 0.25])):
        posteriors = answers(streaming(prior=prior, config=StreamConfig(unknown_at_rest=0.1)), t, q)
        for at in (1.0, begins[1] - 0.3, t[-1]):
            posterior = posteriors[round(at * 60)]
            np.testing.assert_allclose(posterior.given_known, expected)
            assert (posterior.unknown, posterior.n_frames) == (0.1, 0)


class Renamed(Classifier):
    """Says what another classifier says, with other labels once it is told so."""

    offset = 0

    def __init__(self, other: Classifier) -> None:
        self.other = other

    def fit(self, library: MotionLibrary) -> Classifier:
        raise NotImplementedError

    def fit_without(self, library: MotionLibrary, name: str) -> Classifier:
        raise NotImplementedError

    def start(self) -> None:
        self.other.start()

    def update(self, q: np.ndarray, t_s: float) -> ClassPosterior:
        posterior = self.other.update(q, t_s)
        return replace(posterior, labels=tuple(label + self.offset for label in posterior.labels))


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
        assert posterior.labels == tuple(label + (k >= at_rest) + (k >= moving) for label in expected.labels)
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
    with pytest.raises(UsageError, match="prior"):
        streaming(prior={0: -1.0})
    with pytest.raises(UsageError, match="unknown_at_rest"):
        StreamConfig(unknown_at_rest=1.0)
    with pytest.raises((UsageError, ArrayError)):
        StreamConfig(most_replayed=0)


def test_leaving_a_motion_out_leaves_it_out_of_the_rest_learned_too() -> None:
    whole = StreamClassifier(ForestClassifier(HumanModel.kinect12(), ForestSettings(n_trees=10))).fit(library())
    without = whole.fit_without(library(), "0/3")
    assert isinstance(without.classifier, ForestClassifier)
    assert without.classifier.model is not None
    assert "0/3" not in without.classifier.model.exemplars.names
    assert without.lead_in_s >= 0.0
