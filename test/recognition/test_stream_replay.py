"""At an onset the classifier is shown the motion from shortly before it began, in order, once; then each posture."""

from __future__ import annotations

import numpy as np
import pytest
from small_library import DOF_NAMES, REST, small_library

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.stream import StreamClassifier, StreamConfig

ELBOW = DOF_NAMES.index("rElbowZ")


class Witness(Classifier):
    """Remembers what it is shown since the last start; refuses postures whose elbow is bent beyond reason."""

    def __init__(self) -> None:
        self.shown: list[float] = []
        self.starts = 0

    def fit(self, library: MotionLibrary) -> Witness:
        return self

    def fit_without(self, library: MotionLibrary, name: str) -> Witness:
        return Witness()

    def start(self) -> None:
        self.starts += 1
        self.shown = []

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        if q[ELBOW] > 100.0:
            raise ArrayError("witness: wanted an elbow")
        if self.shown and t_s <= self.shown[-1]:
            raise UsageError("witness: out of order")
        self.shown.append(t_s)
        return ClassPosterior((0, 1), np.array([0.9, 0.1]), np.zeros(2), t_s, len(self.shown))


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
    stream = StreamClassifier(witness, StreamConfig(lead_in_s=lead_in_s, most_replayed=1000))
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
        stream = StreamClassifier(witness, StreamConfig(lead_in_s=0.3, most_replayed=most))
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
    stream = StreamClassifier(Witness(), StreamConfig(unknown_at_rest=0.2), prior={1: 3.0, 0: 1.0})
    posterior = stream.update(REST, 0.0)
    assert posterior.labels == (0, 1)
    np.testing.assert_allclose(posterior.probability, [0.2, 0.6])
    with pytest.raises(UsageError, match="prior"):
        StreamClassifier(Witness(), prior={5: 1.0}).update(REST, 0.0)


def test_the_rest_shown_is_as_long_as_the_library_s() -> None:
    motions = []
    for k in range(5):
        t, q = reach_and_back(rest_s=0.4 + 0.05 * k, seed=k)
        motions.append(Motion(t, q, DOF_NAMES, 0, k))
    library = MotionLibrary("lib", tuple(motions))
    whole = StreamClassifier(Witness()).fit(library)
    assert whole.lead_in_s == pytest.approx(0.55, abs=0.12)
    assert whole.fit_without(library, "0/0").lead_in_s > whole.fit_without(library, "0/4").lead_in_s
    assert StreamClassifier(Witness(), StreamConfig(lead_in_s=0.1)).fit(library).lead_in_s == 0.1


def test_a_stream_may_run_for_long() -> None:
    """What is remembered does not grow."""
    t, q = reach_and_back()
    stream = StreamClassifier(Witness())
    for turn in range(3):
        for posture, stamp in zip(q, t.tolist(), strict=True):
            stream.update(posture, stamp + turn * 7.6)
        assert len(stream._buffer) < 60
        assert len(stream._detector._recent) < 40
