"""Classifiers judge one motion from its start; sensors deliver people who stand in between. This joins the two."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.onset import BodyPoints, MotionState, OnsetConfig, OnsetDetector


@dataclass(frozen=True)
class StreamConfig:
    """How a classifier is run on a stream.

    Attributes:
        onset: when something counts as a motion.
        lead_in_s: the classifier is shown the rest from so long before a motion's onset on, as it saw it when it
            learned; None for the median of the library it is fitted to (`fallback_lead_in_s` if it was fitted before).
        fallback_lead_in_s: as long as library_b's motions rest before they begin.
        most_replayed: at an onset, this many buffered postures are shown to the classifier at most, evenly chosen: they
            are shown at once, and that must not take longer than the sensor's next frame.
        unknown_at_rest: probability of no class to give at rest.
    """

    onset: OnsetConfig = field(default_factory=OnsetConfig)
    lead_in_s: float | None = None
    fallback_lead_in_s: float = 0.25
    most_replayed: int = 10
    unknown_at_rest: float = 0.0

    def __post_init__(self) -> None:
        for name in ("lead_in_s", "fallback_lead_in_s"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < np.inf:
                raise UsageError(f"stream: wanted {name} finite and not negative, got {value}")
        if self.most_replayed < 1:
            raise UsageError(f"stream: wanted most_replayed of 1 or more, got {self.most_replayed}")
        if not 0.0 <= self.unknown_at_rest < 1.0:
            raise UsageError(f"stream: wanted unknown_at_rest within [0, 1), got {self.unknown_at_rest}")


class StreamClassifier(Classifier):
    """Runs any classifier on an endless stream: prior at rest, a new motion at each onset.

    At rest the posterior is the prior, and the classifier is not asked. When an onset is found, it is started anew and
    shown the buffered postures since shortly before the motion really began, so that nothing of it is lost.

    Attributes:
        config: the settings.
        classifier: the one that is run; its state belongs to this object.
    """

    def __init__(
        self,
        classifier: Classifier,
        config: StreamConfig | None = None,
        *,
        human: HumanModel | None = None,
        prior: Mapping[int, float] | None = None,
    ) -> None:
        """Wrap a classifier, fitted or to be fitted.

        Args:
            classifier: any.
            config: settings.
            human: whose postures come; P1's 12-DoF human if None.
            prior: probability of each class at rest, equal ones if None.

        Raises:
            UsageError: a prior that is negative or zero altogether, or a human without a right arm.
        """
        self.config = StreamConfig() if config is None else config
        self.classifier = classifier
        self._points = BodyPoints(HumanModel.kinect12() if human is None else human)
        if prior is not None and (min(prior.values(), default=0.0) < 0 or not 0 < sum(prior.values()) < np.inf):
            raise UsageError(f"stream: wanted a prior of non-negative numbers, not all zero, got {dict(prior)}")
        self._prior = prior
        self._learn({})
        #: The posterior at rest; the classes are known from the first posture on.
        self._rests: ClassPosterior | None = None
        self._detector = OnsetDetector(self.config.onset)
        self.start()

    @property
    def motion_state(self) -> MotionState | None:
        """Whether the person moves, and since when; None before the first posture."""
        return self._detector.state

    @property
    def lead_in_s(self) -> float:
        """Rest shown before the onset: the setting, or what the library it was fitted to has."""
        if self.config.lead_in_s is not None:
            return self.config.lead_in_s
        return self.config.fallback_lead_in_s if self._learned_s is None else self._learned_s

    def fit(self, library: MotionLibrary) -> StreamClassifier:
        """Fit the classifier, and learn how long the library's motions rest at first; return self."""
        self.classifier = self.classifier.fit(library)
        rests = {motion.name: self._rests_s(motion) for motion in library}
        self._learn({name: rests_s for name, rests_s in rests.items() if rests_s is not None})
        self._rests = None
        self.start()
        return self

    def fit_without(self, library: MotionLibrary, name: str) -> StreamClassifier:
        """Return a new one whose classifier is fitted without one motion; that one's rest does not count either."""
        name = library.find(name).name
        other = StreamClassifier(
            self.classifier.fit_without(library, name),  # type: ignore[attr-defined]
            self.config,
            human=self._points.human,
            prior=self._prior,
        )
        other._learn({key: value for key, value in self._lead_ins_s.items() if key != name})
        return other

    def start(self) -> None:
        """Forget the stream: the next posture is the first of a person at rest."""
        # The classifier is started at each onset; it need not have learned yet.
        self._detector.start()
        self._buffer: deque[tuple[float, FloatArray]] = deque()

    def classes_changed(self) -> None:
        """Ask the classifier for its classes at the next posture: it has others now. A motion under way goes on."""
        self._rests = None

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` and return the posterior; the prior, with no frames seen, at rest.

        A call that raises leaves the stream as it was. A step between stamps longer than `config.onset.gap_s` ends
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
        while self._buffer[0][0] < t_s - self.lead_in_s - self.config.onset.lookback_s:
            self._buffer.popleft()
        if not state.moving:
            return replace(rests, t_s=t_s)
        return self._replay(state.since_s, before) if posterior is None else posterior

    def _tried(self, q: FloatArray, t_s: float, in_motion: ClassPosterior | None) -> ClassPosterior:
        """Return the posterior at rest, after trying a posture at which an onset may be found as the first of a motion.

        Before the first posture of all nobody knows the classes. A classifier that is in a motion is not disturbed.
        """
        if self._rests is None and in_motion is not None:
            self._rests = self._prior_over(in_motion.labels)
        if self._rests is None or self._detector.may_begin(t_s):
            self.classifier.start()
            labels = self.classifier.update(q, t_s).labels
            if self._rests is None:
                self._rests = self._prior_over(labels)
        return self._rests

    def _replay(self, since_s: float, before: MotionState | None) -> ClassPosterior:
        """Show the classifier the motion so far; nothing from before the rest it begins from."""
        from_s = since_s - self.lead_in_s
        if before is not None:
            from_s = max(from_s, before.since_s)
        frames = [frame for frame in self._buffer if frame[0] >= from_s] or [self._buffer[-1]]
        chosen = np.linspace(len(frames) - 1, 0, min(len(frames), self.config.most_replayed)).round().astype(int)
        self.classifier.start()
        for k in chosen[:0:-1]:
            with suppress(HumanPredError):  # a posture at rest that the classifier would have refused
                self.classifier.update(frames[k][1], frames[k][0])
        return self.classifier.update(frames[-1][1], frames[-1][0])

    def _prior_over(self, labels: tuple[int, ...]) -> ClassPosterior:
        share = np.array([1.0 if self._prior is None else self._prior.get(label, 0.0) for label in labels])
        if not share.sum() > 0:
            raise UsageError(f"stream: wanted a prior for some of the classes {labels}, got one for {self._prior}")
        unknown = self.config.unknown_at_rest
        probability = (1.0 - unknown) * share / share.sum()
        return ClassPosterior(labels, probability, np.zeros(len(labels)), 0.0, 0, unknown)

    def _learn(self, lead_ins_s: dict[str, float]) -> None:
        """Take, by motion, for how long each rests at first."""
        self._lead_ins_s = lead_ins_s
        self._learned_s = float(np.median(list(lead_ins_s.values()))) if lead_ins_s else None

    def _rests_s(self, motion: Motion) -> float | None:
        """Return for how long a motion rests before its onset, None if none is found."""
        detector = OnsetDetector(self.config.onset)
        for q, t_s in zip(motion.q, motion.t_s.tolist(), strict=True):
            state = detector.update(self._points(q), t_s)
            if state.moving:
                return state.since_s - float(motion.t_s[0])
        return None
