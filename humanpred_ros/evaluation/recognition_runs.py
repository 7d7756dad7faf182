"""The runs of an evaluation of recognition: learn without one motion or class, then see what is said about it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from humanpred_ros import plugins
from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation.leave_one_out import LEARNS_CLASSES, LEARNS_FROM_OTHERS, Needs, fitted_without
from humanpred_ros.evaluation.recognition_scores import IntArray, percent_indices
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.motion import Motion, MotionLibrary, resample
from humanpred_ros.reaching.place_classifier import PlaceClassifier
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior, classifier_type
from humanpred_ros.settings import Settings

#: With one of three classes left out, two are left: the least that can be told apart.
LEAST_CLASSES_FOR_UNKNOWN = 3
#: The whole library is fitted again, for the timing, until this much time has passed.
_FIT_TIMING_S = 1.0
_MOST_FITS = 5

#: Infers to which of the classes' places a reach goes; evaluated beside the classifiers.
REACHING = "reaching"


def evaluated_names() -> tuple[str, ...]:
    """Return the names of what can be evaluated: the installed classifiers, and `REACHING`."""
    return (*plugins.names(plugins.CLASSIFIERS), REACHING)


def evaluated_type(name: str) -> type[Classifier]:
    """Return the class of a name of `evaluated_names`. Raises UsageError for another."""
    return PlaceClassifier if name == REACHING else classifier_type(name)


def needs_of(name: str) -> Needs:
    """Return what a library must have for a classifier to be tested on motions left out of it."""
    return LEARNS_FROM_OTHERS if name == REACHING else LEARNS_CLASSES


def learned_of_class(name: str) -> str:
    """Return in words what a classifier knows of the class of the motion it is tested on."""
    return "its place only" if name == REACHING else "its motions"


@dataclass(frozen=True)
class ClassifierChoice:
    """A classifier to evaluate: its name, and its settings; None for the default ones."""

    name: str
    settings: Settings | None = None

    def make(self, human: HumanModel) -> Classifier:
        """Return a new classifier to be fitted. Raises UsageError for an unknown name, or settings of another."""
        kind = evaluated_type(self.name)
        return kind(human) if self.settings is None else kind(human, self.settings)


@dataclass(frozen=True)
class Trace:
    """What a classifier said while one motion was played to it.

    Attributes:
        known: (100, C) at each percent, the probabilities given that the motion belongs to a class it learned.
        unknown: (100,) the probability of no class.
        refused: number of postures that the classifier refused; its posterior then stays what it was.
        update_ns: (T,) duration of each update.
    """

    known: FloatArray
    unknown: FloatArray
    refused: int
    update_ns: IntArray


@dataclass(frozen=True)
class LeftOutMotion:
    """Task: learn without this motion, then recognise it."""

    name: str

    def __str__(self) -> str:
        return f"motion {self.name}"


@dataclass(frozen=True)
class LeftOutClass:
    """Task: learn without this class, then see what is said about its motions."""

    label: int

    def __str__(self) -> str:
        return f"class {self.label}"


Task = LeftOutMotion | LeftOutClass


@dataclass(frozen=True)
class Outcome:
    """Result of one task.

    Attributes:
        traces: of a left-out motion, as recorded and at each further speed; of a left-out class, one for each of
            its motions.
        fit_s: durations of the fits of the whole library, in the first task of a process.
        cpu_s: processor time spent, by part.
    """

    traces: tuple[Trace, ...]
    fit_s: tuple[float, ...]
    cpu_s: dict[str, float]


class LeftOutRuns:
    """Runs tasks; the classifier fitted to the whole library is made once in each process."""

    def __init__(self, choice: ClassifierChoice, library: MotionLibrary, speeds: Sequence[float]) -> None:
        """Prepare the runs; `speeds` are further speeds, as factors of the recorded one."""
        self.choice = choice
        self.speeds = tuple(speeds)
        self.library = library

    def __call__(self, task: Task) -> Outcome:
        """Run one task. Raises what the classifier's fit raises."""
        return self._left_out_motion(task.name) if isinstance(task, LeftOutMotion) else self._left_out_class(task.label)

    @cached_property
    def _human(self) -> HumanModel:
        return human_with(self.library.dof_names)

    @cached_property
    def _fitted(self) -> tuple[Classifier, tuple[float, ...]]:
        times: list[float] = []
        while True:
            classifier = self.choice.make(self._human)
            begun = time.perf_counter()
            classifier = classifier.fit(self.library)
            times.append(time.perf_counter() - begun)
            if sum(times) > _FIT_TIMING_S or len(times) == _MOST_FITS:
                return classifier, tuple(times)

    def _left_out_motion(self, name: str) -> Outcome:
        new = "_fitted" not in self.__dict__
        whole, fit_s = self._fitted
        motion, labels = self.library.find(name), self.library.labels
        clock = [time.process_time()]
        classifier = fitted_without(whole, self.library, name)
        clock.append(time.process_time())
        traces = [play(classifier, motion, labels)]
        clock.append(time.process_time())
        traces += [play(classifier, at_speed(motion, speed), labels) for speed in self.speeds]
        clock.append(time.process_time())
        parts = ("fitting without a motion", "recognising it", "recognising it at other speeds")
        cpu_s = dict(zip(parts, np.diff(clock).tolist(), strict=True))
        return Outcome(tuple(traces), fit_s if new else (), cpu_s)

    def _left_out_class(self, label: int) -> Outcome:
        begun = time.process_time()
        rest = self.library.select(lambda motion: motion.label != label)
        classifier = self.choice.make(self._human).fit(rest)
        traces = tuple(play(classifier, motion, rest.labels) for motion in self.library.of_class(label))
        return Outcome(traces, (), {"unknown motions": time.process_time() - begun})


def play(classifier: Classifier, motion: Motion, labels: tuple[int, ...]) -> Trace:
    """Show a motion to a copy of a classifier, posture by posture as a sensor would, and return what it said.

    A copy, because what a classifier keeps from one motion to the next, such as where the person stands, must not come
    from a motion it is tested on. Until the first posture it accepts, all `labels`, the classes it learned, are equal.
    """
    classifier = deepcopy(classifier)
    classifier.start()
    known = np.zeros((len(motion), len(labels)))
    unknown = np.zeros(len(motion))
    update_ns = np.zeros(len(motion), dtype=np.int64)
    last: ClassPosterior | None = None
    refused = 0
    for k, (q, t_s) in enumerate(zip(motion.q, motion.t_s.tolist(), strict=True)):
        begun = time.perf_counter_ns()
        try:
            last = classifier.update(q, t_s)
        except HumanPredError:
            refused += 1
        update_ns[k] = time.perf_counter_ns() - begun
        if last is None:
            known[k] = 1.0 / len(labels)
        else:
            known[k] = last.given_known[[last.labels.index(label) for label in labels]]
            unknown[k] = last.unknown
    seen = percent_indices(len(motion))
    return Trace(known[seen], unknown[seen], refused, update_ns)


def at_speed(motion: Motion, speed: float) -> Motion:
    """Return the motion as a sensor of the same period would see it, done `speed` times as fast.

    Postures between frames are interpolated linearly, which takes some of the tracker's noise away.

    Raises:
        MotionError: so fast that fewer than two postures are left.
    """
    step_s = speed * motion.period_s
    # Stamps are rounded to nanoseconds: a step that ends this little after the last frame ends on it.
    n = int((motion.duration_s + 1e-9 * len(motion)) / step_s) + 1
    stamps = np.minimum(motion.t_s[0] + step_s * np.arange(n), motion.t_s[-1])
    seen = resample(motion, t_s=stamps)
    return Motion(
        motion.period_s * np.arange(n, dtype=np.float64), seen.q, seen.dof_names, seen.label, seen.index, seen.frame_id
    )


def tasks_for(library: MotionLibrary, with_unknown: bool) -> list[Task]:
    """Return the tasks for one classifier, the long ones first, motions in the order of the library."""
    classes: list[Task] = []
    if with_unknown and unknown_left_out(library) is None:
        classes = [LeftOutClass(label) for label in library.labels]
    return classes + [LeftOutMotion(motion.name) for motion in library]


def unknown_left_out(library: MotionLibrary) -> str | None:
    """Return why no class of a library can be left out as a whole, in words; None if each can."""
    n = len(library.labels)
    if n >= LEAST_CLASSES_FOR_UNKNOWN:
        return None
    return (
        f"leaving out a whole class takes at least {LEAST_CLASSES_FOR_UNKNOWN}, so that two are left to tell apart; "
        f"{library.name} has {n}"
    )
