"""Runs a classifier, which judges one motion from its start, on a stream of postures with rest in between."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import replace

import numpy as np

from humanpred_ros.errors import HumanPredError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.onset import BodyPoints, MotionState, OnsetDetector, OnsetSettings
from humanpred_ros.settings import Settings, setting


class StreamSettings(Settings):
    """How a classifier is run on a stream."""

    onset: OnsetSettings = setting(OnsetSettings(), "when something counts as a motion")
    lead_in_s: float | None = setting(
        None,
        "the classifier is shown the rest from so long before a motion's onset on, as it saw it when it learned; none: "
        "the median of the library it is fitted to",
        unit="s",
        low=0.0,
    )
    fallback_lead_in_s: float = setting(
        0.25,
        "for a classifier that was fitted before: as library_b's motions rest at first",
        unit="s",
        low=0.0,
    )
    most_replayed: int = setting(
        10,
        "buffered postures shown to the classifier at an onset, at most, evenly chosen: they are shown at once, which "
        "must not take longer than the sensor's next frame",
        low=1,
    )


class StreamClassifier(Classifier):
    """Runs any classifier on an endless stream: at rest all classes are equal, and each onset begins a new motion.

    At rest the classifier is not asked. When an onset is found, it is started anew and
    shown the buffered postures since shortly before the motion really began, so that nothing of it is lost.

    Attributes:
        classifier: the one that is run; its state belongs to this object.
    """

    settings_type = StreamSettings
    settings: StreamSettings

    def __init__(self, classifier: Classifier, settings: StreamSettings | None = None) -> None:
        """Wrap a classifier, fitted or to be fitted.

        Args:
            classifier: any; its human is the one whose postures come.
            settings: the default ones if None.

        Raises:
            UsageError: a human without a right arm.
        """
        super().__init__(classifier.human, settings)
        self.classifier = classifier
        self._points = BodyPoints(self.human)
        #: For how long the library's motions rest at first, median; None if it was not fitted here.
        self._learned_s: float | None = None
        #: The posterior at rest; the classes are known from the first posture on.
        self._rests: ClassPosterior | None = None
        self._detector = OnsetDetector(self.settings.onset)
        self.start()

    @property
    def motion_state(self) -> MotionState | None:
        """Whether the person moves, and since when; None before the first posture."""
        return self._detector.state

    @property
    def lead_in_s(self) -> float:
        """Rest shown before the onset: the setting, or what the library it was fitted to has."""
        if self.settings.lead_in_s is not None:
            return self.settings.lead_in_s
        return self.settings.fallback_lead_in_s if self._learned_s is None else self._learned_s

    def fit(self, library: MotionLibrary) -> StreamClassifier:
        """Fit the classifier, and learn how long the library's motions rest at first; return self."""
        self.classifier = self.classifier.fit(library)
        rests = [rests_s for motion in library if (rests_s := self._rests_s(motion)) is not None]
        self._learned_s = float(np.median(rests)) if rests else None
        self._rests = None
        self.start()
        return self

    def start(self) -> None:
        """Forget the stream: the next posture is the first of a person at rest."""
        # The classifier is started at each onset; it need not have learned yet.
        self._detector.start()
        self._buffer: deque[tuple[float, FloatArray]] = deque()

    def classes_changed(self) -> None:
        """Ask the classifier for its classes at the next posture: it has others now. A motion under way goes on."""
        self._rests = None

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` and return the posterior; at rest, equal ones with no frames seen.

        A call that raises leaves the stream as it was. A step between stamps longer than `settings.onset.gap_s` ends
        what was.

        Raises:
            ArrayError: posture of the wrong shape or not finite; in motion, also one that the classifier refuses.
            MotionError: a stamp that is not finite or not later than the one before.
            UsageError: the classifier has learned nothing yet.
        """
        points = self._detector.check(self._points(q), t_s)
        before = self._detector.state
        continued = self._detector.continues(t_s)
        was_moving = before is not None and before.moving and continued
        # What may raise comes before anything is changed.
        posterior = self.classifier.update(q, t_s) if was_moving else None
        rests = self._tried(q, t_s, posterior)
        state = self._detector.update(points, t_s)
        if not continued:
            self._buffer.clear()
        self._buffer.append((t_s, np.array(q, dtype=np.float64)))
        while self._buffer[0][0] < t_s - self.lead_in_s - self.settings.onset.lookback_s:
            self._buffer.popleft()
        if not state.moving:
            return replace(rests, t_s=t_s)
        return self._replay(state.since_s, before) if posterior is None else posterior

    def _tried(self, q: FloatArray, t_s: float, in_motion: ClassPosterior | None) -> ClassPosterior:
        """Return the posterior at rest, after trying a posture at which an onset may be found as the first of a motion.

        The classes are not known before the first posture of all. A classifier that is in a motion is not disturbed.
        """
        if self._rests is None and in_motion is not None:
            self._rests = _undecided(in_motion.labels)
        if self._rests is None or self._detector.may_begin(t_s):
            self.classifier.start()
            labels = self.classifier.update(q, t_s).labels
            if self._rests is None:
                self._rests = _undecided(labels)
        return self._rests

    def _replay(self, since_s: float, before: MotionState | None) -> ClassPosterior:
        """Show the classifier the motion so far; nothing from before the rest it begins from."""
        from_s = since_s - self.lead_in_s
        if before is not None:
            from_s = max(from_s, before.since_s)
        frames = [frame for frame in self._buffer if frame[0] >= from_s] or [self._buffer[-1]]
        chosen = np.linspace(len(frames) - 1, 0, min(len(frames), self.settings.most_replayed)).round().astype(int)
        self.classifier.start()
        for k in chosen[:0:-1]:
            with suppress(HumanPredError):  # a posture at rest that the classifier would have refused
                self.classifier.update(frames[k][1], frames[k][0])
        return self.classifier.update(frames[-1][1], frames[-1][0])

    def _rests_s(self, motion: Motion) -> float | None:
        """Return for how long a motion rests before its onset, None if none is found."""
        detector = OnsetDetector(self.settings.onset)
        for q, t_s in zip(motion.q, motion.t_s.tolist(), strict=True):
            state = detector.update(self._points(q), t_s)
            if state.moving:
                return state.since_s - float(motion.t_s[0])
        return None


def _undecided(labels: tuple[str, ...]) -> ClassPosterior:
    """Return the posterior before anything was seen of a motion: every class is equally probable."""
    return ClassPosterior(labels, np.full(len(labels), 1.0 / len(labels)), np.zeros(len(labels)), 0.0, 0)
