"""The runs of an evaluation of streams: one recording round left out, made a stream, and recognised within it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from humanpred_ros.errors import HumanPredError, LibraryFormatError
from humanpred_ros.evaluation.recognition_runs import ClassifierChoice
from humanpred_ros.evaluation.recognition_scores import decided_right
from humanpred_ros.evaluation.standing import StandingNoise, standing_noise
from humanpred_ros.evaluation.stream_composed import Placed, Stream, build_stream, returns_home, standing_stream
from humanpred_ros.evaluation.stream_scores import EventLog, FalseStarts, MotionScore, score_events
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.onset import BodyPoints, OnsetDetector, OnsetSettings
from humanpred_ros.recognition.stream import StreamClassifier, StreamSettings

#: Where in the recorded motion recognition is looked at.
PERCENTS = (20, 40, 60, 80, 100)


class Variant(NamedTuple):
    """How a stream differs from the recordings.

    Attributes:
        name: for tables.
        slower: stamps are this many times as far apart.
        least_step_s: frames sooner after the last one are dropped; 0 keeps all.
        mixed: pauses have the noise of all rounds instead of this round's.
    """

    name: str
    slower: float = 1.0
    least_step_s: float = 0.0
    mixed: bool = False


#: The first is the one that figures without a name are of.
VARIANTS = (
    Variant("as recorded"),
    Variant("noise of all rounds mixed", mixed=True),
    Variant("at 30 Hz", least_step_s=1.0 / 30.0),
    Variant("done 1.5 times as slowly", slower=1.5),
)


@dataclass(frozen=True)
class VariantOutcome:
    """Onsets and ends on one stream, and on a person who only stands."""

    scores: tuple[MotionScore, ...]
    false_starts: FalseStarts
    stream_s: float
    standing_starts: int
    standing_s: float


@dataclass(frozen=True)
class Recognition:
    """How one motion was recognised.

    Attributes:
        name: of the motion.
        in_stream, alone: (percents,) whether its class alone was the most probable one, in the stream and by itself.
    """

    name: str
    in_stream: tuple[bool, ...]
    alone: tuple[bool, ...]


@dataclass(frozen=True)
class Outcome:
    """Of one round.

    Attributes:
        variants: by name.
        recognition: empty without a classifier.
        refused: postures that were refused in the stream.
        detector_us, stream_us: (T,) time of each detector update, and of each update with classification.
    """

    variants: dict[str, VariantOutcome]
    recognition: tuple[Recognition, ...]
    refused: int
    detector_us: FloatArray
    stream_us: FloatArray


class StreamRuns:
    """Carries a library to where its rounds are run."""

    def __init__(
        self, library: MotionLibrary, classifier: str | None, onset: OnsetSettings, seed: int, standing_s: float
    ) -> None:
        """Prepare runs.

        Args:
            library: whose motions with one index are one round.
            classifier: its name; None to look at onsets and ends only.
            onset: the detector's settings.
            seed: of pauses, noise and order; each round has its own generator.
            standing_s: duration of mere standing, of all rounds together.
        """
        self.library = library
        self.classifier, self.onset, self.seed, self.standing_s = classifier, onset, seed, standing_s

    @cached_property
    def human(self) -> HumanModel:
        return human_with(self.library.dof_names)

    @cached_property
    def rounds(self) -> tuple[int, ...]:
        return tuple(sorted({motion.index for motion in self.library}))

    @cached_property
    def come_back(self) -> bool:
        return returns_home(self.library, self.human)

    def __call__(self, index: int) -> Outcome:
        """Run one round."""
        variants, detector_us = {}, np.zeros(0)
        for number, variant in enumerate(VARIANTS):
            stream, standing = self.streams(index, variant)
            outcome, us = self._onsets(stream, standing)
            variants[variant.name] = outcome
            if number == 0:
                detector_us = us
        recognition: tuple[Recognition, ...] = ()
        refused, stream_us = 0, np.zeros(0)
        if self.classifier is not None:
            recognition, refused, stream_us = self._recognition(index, self.classifier)
        return Outcome(variants, recognition, refused, detector_us, stream_us)

    def streams(self, index: int, variant: Variant) -> tuple[Stream, Stream]:
        """Return the stream of one round, and one of standing, in one variant."""
        rng = np.random.default_rng((self.seed, index))
        motions = [_slower(motion, variant.slower) for motion in self.library if motion.index == index]
        motions = [motions[k] for k in rng.permutation(len(motions))]
        half = [_slower(motion, variant.slower) for motion in self.library if (motion.index - index) % 2 == 0]
        noise = self._noise(half)
        if not variant.mixed:
            noise = noise.near(index)
        stream = build_stream(motions, self.human, noise, rng, come_back=self.come_back)
        # The most usual of the round's starts: one of them may be mistracked.
        starts = np.stack([motion.q[0] for motion in motions])
        start = starts[np.abs(starts - np.median(starts, axis=0)).sum(axis=1).argmin()]
        standing = standing_stream(start, self.standing_s / len(self.rounds), noise, rng)
        return _thinned(stream, variant.least_step_s), _thinned(standing, variant.least_step_s)

    def _noise(self, half: Sequence[Motion]) -> StandingNoise:
        """Return the noise of every other round, this one among them: what settings were chosen on stays apart."""
        try:
            return standing_noise(half, self.human)
        except LibraryFormatError:
            return standing_noise(self.library.motions, self.human)

    def _onsets(self, stream: Stream, standing: Stream) -> tuple[VariantOutcome, FloatArray]:
        log, us = self._detect(stream)
        scores, false_starts = score_events(stream.placed, log.events)
        still, _ = self._detect(standing)
        starts = sum(event.moving for event in still.events)
        durations = float(stream.t_s[-1] - stream.t_s[0]), float(standing.t_s[-1] - standing.t_s[0])
        return VariantOutcome(scores, false_starts, durations[0], starts, durations[1]), us

    def _detect(self, stream: Stream) -> tuple[EventLog, FloatArray]:
        detector, points, log = OnsetDetector(self.onset), BodyPoints(self.human), EventLog()
        us = np.zeros(len(stream.t_s))
        for k, (q, t_s) in enumerate(zip(stream.q, stream.t_s.tolist(), strict=True)):
            begun = time.perf_counter()
            state = detector.update(points(q), t_s)
            us[k] = 1e6 * (time.perf_counter() - begun)
            log.add(state)
        return log, us

    def _recognition(self, index: int, name: str) -> tuple[tuple[Recognition, ...], int, FloatArray]:
        rest = self.library.select(lambda motion: motion.index != index)
        wrapped = StreamClassifier(ClassifierChoice(name).make(self.human), StreamSettings(onset=self.onset))
        classifier = wrapped.fit(rest)
        stream, _ = self.streams(index, VARIANTS[0])
        known, refused, us = _play(classifier, stream.t_s, stream.q, rest.labels)
        found = []
        for placed in stream.placed:
            if placed.made or placed.label not in rest.labels:
                continue
            motion = self.library.find(placed.name)
            alone, _, _ = _play(classifier.classifier, motion.t_s, motion.q, rest.labels)
            column = rest.labels.index(placed.label)
            found.append(
                Recognition(
                    placed.name,
                    _right(known, _frames_at(stream.t_s, placed), column),
                    _right(alone, [len(motion) * percent // 100 - 1 for percent in PERCENTS], column),
                )
            )
        return tuple(found), refused, us


def _play(
    classifier: Classifier, t_s: FloatArray, q: FloatArray, labels: tuple[int, ...]
) -> tuple[FloatArray, int, FloatArray]:
    """Show postures to a classifier; return (T, C) probabilities of the classes, postures refused, and update times."""
    classifier.start()
    known, us, refused = np.full((len(t_s), len(labels)), 1.0 / len(labels)), np.zeros(len(t_s)), 0
    last: ClassPosterior | None = None
    for k, (posture, stamp_s) in enumerate(zip(q, t_s.tolist(), strict=True)):
        begun = time.perf_counter()
        try:
            last = classifier.update(posture, stamp_s)
        except HumanPredError:
            refused += 1
        us[k] = 1e6 * (time.perf_counter() - begun)
        if last is not None:
            known[k] = [last.of(label) for label in labels]
    return known, refused, us


def _right(known: FloatArray, frames: Sequence[int], column: int) -> tuple[bool, ...]:
    right = decided_right(known[None, list(frames)], np.array([column]))
    return tuple(bool(value) for value in right[0])


def _frames_at(t_s: FloatArray, placed: Placed) -> list[int]:
    """Return the last frame seen at each percent of the recorded piece of a motion."""
    first = int(np.searchsorted(t_s, placed.start_s - 1e-9))
    n = int(np.searchsorted(t_s, placed.stop_s + 1e-9)) - first
    return [first + n * percent // 100 - 1 for percent in PERCENTS]


def _slower(motion: Motion, factor: float) -> Motion:
    return motion if factor == 1.0 else replace(motion, t_s=motion.t_s * factor)


def _thinned(stream: Stream, least_step_s: float) -> Stream:
    """Return the stream a slower sensor would deliver."""
    kept, last_s = [], -np.inf
    for k, t_s in enumerate(stream.t_s.tolist()):
        if t_s - last_s >= least_step_s - 1e-4:  # stamps are rounded
            kept.append(k)
            last_s = t_s
    return Stream(stream.t_s[kept], stream.q[kept], stream.placed)
