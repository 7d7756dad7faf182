"""How early and how surely is a motion recognised that was not learned from (P1 results, Fig. 6)?

Each motion is left out of the library in turn, and each class as a whole, too. A classifier sees a left-out motion as a
sensor would show it, posture by posture with stamps; it does not know how long the motion is going to last. The
classifier `reaching` learns from no motion of a left-out motion's class and knows the class's place; with the class
left out, it does not know the place either.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from humanpred_ros import plugins
from humanpred_ros.evaluation.framework import Advance, Begin, LibrarySettings, Report, chosen_names
from humanpred_ros.evaluation.leave_one_out import (
    LEARNS_CLASSES,
    LEARNS_FROM_OTHERS,
    Needs,
    UpdateLog,
    answers,
    at_speed,
    check_needs,
    fitted_without,
)
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.recognition_report import recognition_plot, recognition_tables
from humanpred_ros.evaluation.recognition_scores import (
    BoolArray,
    advice_beside,
    brier_score,
    calibration,
    confusion,
    curve_figures,
    decided_right,
    log_loss,
    percent_indices,
    quartiles,
    read_reference,
    reference_beside,
    unknown_score,
    worst_drop,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.reaching.place_classifier import PlaceClassifier
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior, classifier_type
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.settings import Settings, setting, setting_of

#: Infers to which of the classes' places a reach goes; evaluated beside the classifiers.
REACHING = "reaching"
#: With one of three classes left out, two are left: the least that can be told apart.
LEAST_CLASSES_FOR_UNKNOWN = 3
#: The least probabilities counted in a log-loss: scikit-learn's old default, and one at which a few motions that are
#: given up for certain do not drown all others.
LOG_LOSS_CLIPS = (1e-15, 1e-3)
_UNKNOWN_AT = (10, 30, 60, 90)


def evaluated_names() -> tuple[str, ...]:
    """Return the names of what can be evaluated: the installed classifiers, and `REACHING`."""
    return (*plugins.names(plugins.CLASSIFIERS), REACHING)


def needs_of(name: str) -> Needs:
    """Return what a library must have for a classifier to be tested on motions left out of it."""
    return LEARNS_FROM_OTHERS if name == REACHING else LEARNS_CLASSES


class ClassifierChoice(NamedTuple):
    """A classifier to evaluate: its name, and its settings; None for the default ones."""

    name: str
    settings: Settings | None = None

    @property
    def kind(self) -> type[Classifier]:
        """Its class. Raises UsageError for an unknown name."""
        return PlaceClassifier if self.name == REACHING else classifier_type(self.name)

    def make(self, human: HumanModel) -> Classifier:
        """Return a new classifier to be fitted. Raises UsageError for an unknown name, or settings of another."""
        return self.kind(human) if self.settings is None else self.kind(human, self.settings)


class RecognitionSettings(LibrarySettings):
    """Settings of `humanpred evaluate recognition`."""

    classifier: tuple[str, ...] = setting(("all",), "classifiers by name; all: those that are installed, and reaching")
    reference: str | None = setting(
        None,
        "published curve to compare with, a CSV file of phase_percent and recognition_rate; none for no curve; by "
        "default reference/authors_fig6_curve.csv beside the library, if it is there",
    )
    speeds: tuple[float, ...] = setting(
        (0.7, 1.0, 1.4), "play the motions at these factors of their speed, too", low=0.01, high=100.0
    )
    unknown: bool = setting(True, "leave out each class as a whole, too, if there are three classes or more")
    components: int = setting_of(GmmSettings, "n_components", description="gmm: Gaussians per class")
    phase: bool = setting_of(GmmSettings, "phase_feature", description="gmm: the phase is a feature beside the posture")
    evidence: Literal["sum", "mean"] = setting_of(
        GmmSettings, "evidence", description="gmm: sum or mean of the postures' log densities"
    )
    window_frames: int = setting(0, "gmm: count only so many last postures; 0 counts all", low=0)

    def check(self) -> None:
        """Raise UsageError for unknown classifiers."""
        _ = self.choices

    @property
    def further_speeds(self) -> tuple[float, ...]:
        """The speeds other than the recorded one, each once, ascending."""
        return tuple(sorted(set(self.speeds) - {1.0}))

    @property
    def choices(self) -> tuple[ClassifierChoice, ...]:
        """The classifiers, each with its settings: the seed, if it has one, and those of gmm."""
        gmm = {
            "n_components": self.components,
            "phase_feature": self.phase,
            "evidence": self.evidence,
            "window_frames": self.window_frames or None,
        }
        choices = []
        for name in chosen_names(self.classifier, evaluated_names(), "classifier"):
            kind = ClassifierChoice(name).kind.settings_type
            values: dict[str, Any] = {"seed": self.seed} if "seed" in kind.model_fields else {}
            values.update(gmm if name == "gmm" else {})
            choices.append(ClassifierChoice(name, kind(**values) if values else None))
        return tuple(choices)


class Trace(NamedTuple):
    """What a classifier said while one motion was shown to it."""

    #: (100, C) at each percent, the probabilities given that the motion belongs to a class it learned
    known: FloatArray
    unknown: FloatArray  #: (100,) the probability of no class
    log: UpdateLog  #: of the updates


def play(classifier: Classifier, motion: Motion, labels: Sequence[str]) -> Trace:
    """Show a motion to a copy of a classifier and return what it said.

    A copy, because what a classifier keeps from one motion to the next, such as where the person stands, must not come
    from a motion it is tested on. Until the first posture it accepts, all `labels`, the classes it learned, are equal.
    """
    log = UpdateLog()
    said = list(answers(deepcopy(classifier), motion.q, motion.t_s, log))
    seen: list[ClassPosterior | None] = [said[k] for k in percent_indices(len(motion))]
    unknown = np.array([0.0 if posterior is None else posterior.unknown for posterior in seen])
    return Trace(np.array([given_known(posterior, labels) for posterior in seen]), unknown, log)


def given_known(posterior: ClassPosterior | None, labels: Sequence[str]) -> FloatArray:
    """Return (C,) the probabilities of the labels if the motion is of one of them; all equal if nothing was said."""
    if posterior is None:
        return np.full(len(labels), 1.0 / len(labels))
    return posterior.given_known[[posterior.labels.index(label) for label in labels]]


@dataclass(frozen=True, eq=False)
class LeftOutRuns:
    """Runs tasks; the classifier fitted to the whole library is made once in each process.

    A task is "motion 3/7" (learn without this motion, then recognise it) or "class 3" (learn without this class, then
    see what is said about its motions).
    """

    choice: ClassifierChoice  #: the classifier
    library: MotionLibrary  #: of which motions and classes are left out
    speeds: tuple[float, ...] = ()  #: at which motions are played besides the recorded one, as factors of it

    def __call__(self, task: str) -> tuple[list[Trace], float | None, float]:
        """Run one task. Raises what the classifier's fit raises.

        Returns:
            The traces of a left-out motion, as recorded and at each further speed, or of each motion of a left-out
            class; the seconds that fitting the whole library took, None if it was fitted before; processor time in s.
        """
        kind, _, name = task.partition(" ")
        new = kind == "motion" and "_fitted" not in self.__dict__
        begun = time.process_time()
        if kind == "motion":
            whole, fit_s = self._fitted
            motion, classifier = self.library.find(name), fitted_without(whole, self.library, name)
            shown, labels = [motion, *(at_speed(motion, speed) for speed in self.speeds)], self.library.labels
        else:
            rest, fit_s = self.library.select(lambda motion: motion.label != name), 0.0
            classifier, labels = self.choice.make(human_with(rest.dof_names)).fit(rest), rest.labels
            shown = list(self.library.of_class(name))
        traces = [play(classifier, motion, labels) for motion in shown]
        return traces, fit_s if new else None, time.process_time() - begun

    @cached_property
    def _fitted(self) -> tuple[Classifier, float]:
        """The classifier that learned from all motions, and how many seconds that took."""
        classifier = self.choice.make(human_with(self.library.dof_names))
        begun = time.perf_counter()
        return classifier.fit(self.library), time.perf_counter() - begun


def tasks_for(library: MotionLibrary, with_unknown: bool) -> list[str]:
    """Return the tasks of `LeftOutRuns`, the long ones first, motions in the order of the library."""
    leave_classes_out = with_unknown and unknown_left_out(library) is None
    return [f"class {label}" for label in library.labels if leave_classes_out] + [f"motion {m.name}" for m in library]


def unknown_left_out(library: MotionLibrary) -> str | None:
    """Return why no class of a library can be left out as a whole, in words; None if each can."""
    n = len(library.labels)
    if n >= LEAST_CLASSES_FOR_UNKNOWN:
        return None
    return (
        f"leaving out a whole class takes at least {LEAST_CLASSES_FOR_UNKNOWN}, so that two are left to tell apart; "
        f"{library.name} has {n}"
    )


def evaluate_classifier(
    choice: ClassifierChoice,
    library: MotionLibrary,
    settings: RecognitionSettings,
    *,
    reference: Mapping[str, Any] | None = None,
    advice: Mapping[str, str] | None = None,
    progress: Advance | None = None,
) -> dict[str, Any]:
    """Leave out each motion, and each class, in turn; return what the classifier said about them as figures.

    Args:
        choice: the classifier.
        library: all of it is evaluated.
        settings: speeds, seed, and how the work is done.
        reference: a published curve to compare with (`read_reference`).
        advice: by motion, what somebody advised to do about it ("exclude", "suspect", "keep"). All motions count
            all the same; figures without those to exclude, and without the suspect ones too, are given beside.
        progress: is called with the number of tasks done, of `tasks_for`.

    Returns:
        Figures by name, as in the JSON file. All but `speeds` and `unknown` are at the recorded speed.

        - `name`, `settings`: of the classifier; `learned_of_class`: what it knew of the tested motion's class;
        - `rate`: (100,) share of motions whose true class alone is the most probable, after each percent of postures;
          `figures` of that curve (`curve_figures`); `reference_rms`: root mean square difference to the published one;
        - `log_loss`: mean over motions and percents of -ln of the true class's probability, given that the motion is
          of some class, by the least probability counted ("clip"); `log_loss_curve`: (100,) per percent, for the larger
          clip; `brier`, `brier_curve`: mean squared distance of posterior and truth, 0 to 2;
        - `calibration` of the probability of the most probable class, given that the motion is of some class;
          `calibration_with_unknown`: without that condition, so that a probability of no class lowers it;
        - `confusion_at_60`: (C, C + 1) true class by decision, undecided last, in the order of the labels;
        - `unknown_on_known`: mean probability of no class on motions of known classes, by percent;
          `unknown_quartiles`: (3, 100) its quartiles; `unknown`: the same on motions of classes never learned
          (`unknown_score`), None if not asked for, or with too few classes;
        - `speeds`: the `rate` at each further `speed`, and by how many percentage points it is lower at worst, beyond
          40 % of the motion, and at which percent; `groups`: curve figures of the motions that are flagged, or not;
        - `refused_postures`, and `timing`: median time to learn the whole library (`fit_s`, of `n_fits`) and of one
          update, 99 % quantile of that, duration of this evaluation, and processor time of all processes.

    Raises:
        LibraryFormatError: too few classes or motions for this classifier, or what the classifier cannot learn.
        MotionError: a speed at which less than two postures are left of a motion.
    """
    begun = time.perf_counter()
    check_needs(library, {choice.name: needs_of(choice.name)}, "--classifier")
    tasks = tasks_for(library, settings.unknown)
    runs = LeftOutRuns(choice, library, settings.further_speeds)
    outcomes = map_processes(runs, tasks, settings.jobs, progress, settings.scheduler)
    n_classes = len(tasks) - len(library)
    motions = [traces for traces, _, _ in outcomes[n_classes:]]
    truth = np.array([library.labels.index(motion.label) for motion in library if motion.label is not None])
    known, unknown = np.stack([t[0].known for t in motions]), np.stack([t[0].unknown for t in motions])
    right = decided_right(known, truth)
    rate = right.mean(axis=0)
    losses = {f"{clip:g}": log_loss(known, truth, clip) for clip in LOG_LOSS_CLIPS}
    brier = brier_score(known, truth)
    rng = np.random.default_rng(settings.seed)
    confidence = known.max(axis=2)
    speeds = []
    for k, speed in enumerate(settings.further_speeds, start=1):
        at = decided_right(np.stack([traces[k].known for traces in motions]), truth).mean(axis=0)
        points, percent = worst_drop(rate, at)
        speeds.append({"speed": speed, "rate": at, "worst_drop_points": points, "worst_drop_percent": percent})
    unknown_by_class = {
        label: np.stack([trace.unknown for trace in traces])
        for label, (traces, _, _) in zip(library.labels, outcomes[:n_classes], strict=False)
    }
    fits = [fit_s for _, fit_s, _ in outcomes if fit_s is not None]
    updates_us = 1e-3 * np.concatenate([traces[0].log.update_ns for traces in motions])
    return {
        "name": choice.name,
        "settings": choice.settings or {},
        "learned_of_class": "its place only" if choice.name == REACHING else "its motions",
        "rate": rate,
        "figures": curve_figures(rate),
        "reference_rms": None if reference is None else float(np.sqrt(np.mean((rate - reference["rate"]) ** 2))),
        "log_loss": {clip: float(loss.mean()) for clip, loss in losses.items()},
        "log_loss_curve": losses[f"{max(LOG_LOSS_CLIPS):g}"],
        "brier": float(brier.mean()),
        "brier_curve": brier,
        "calibration": calibration(confidence, right, rng),
        "calibration_with_unknown": calibration(confidence * (1.0 - unknown), right, rng),
        "confusion_at_60": confusion(known[:, 59], truth),
        "unknown_on_known": {str(percent): float(unknown[:, percent - 1].mean()) for percent in _UNKNOWN_AT},
        "unknown_quartiles": quartiles(unknown),
        "speeds": speeds,
        "unknown": unknown_score(unknown_by_class, unknown) if n_classes else None,
        "groups": list(_groups(library, right, advice or {})),
        "refused_postures": sum(traces[0].log.refused for traces in motions),
        "timing": {
            "fit_s": float(np.median(fits)),
            "n_fits": len(fits),
            "update_us": float(np.median(updates_us)),
            "update_us_p99": float(np.quantile(updates_us, 0.99)),
            "wall_s": time.perf_counter() - begun,
            "cpu_s": sum(cpu_s for _, _, cpu_s in outcomes),
        },
    }


def _groups(library: MotionLibrary, right: BoolArray, advice: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    flags = np.array([advice.get(motion.name, "") for motion in library])
    bad, doubtful = flags == "exclude", flags == "suspect"
    for group, members in (
        ("without excluded", ~bad),
        ("without suspect too", ~bad & ~doubtful),
        ("excluded only", bad),
        ("suspect only", doubtful),
    ):
        if members.any() and (bad | doubtful).any():
            figures = curve_figures(right[members].mean(axis=0))
            yield {"group": group, "n_motions": int(members.sum()), "figures": figures}


def measure(settings: RecognitionSettings, begin: Begin) -> Report:
    """Evaluate every classifier that was asked for.

    Raises:
        HumanPredError: an unusable library or reference, or what a classifier cannot learn.
    """
    path, library = settings.library_path, settings.read_library()
    choices = settings.choices
    check_needs(library, {choice.name: needs_of(choice.name) for choice in choices}, "--classifier")
    reference = None
    if settings.reference != "none":
        reference = read_reference(settings.reference) if settings.reference else reference_beside(path)
    advice = advice_beside(path, library.name)
    n_tasks = len(tasks_for(library, settings.unknown))
    results = [
        evaluate_classifier(
            choice, library, settings, reference=reference, advice=advice, progress=begin(choice.name, n_tasks)
        )
        for choice in choices
    ]
    why_not = unknown_left_out(library) if settings.unknown else None
    return Report(
        f"{library.name}: each of {len(library)} motions left out in turn",
        tuple(recognition_tables(results, library.labels, reference)),
        {
            "library": library_facts(library, by_class=True),
            "labels": library.labels,
            "reference": reference,
            "classifiers": results,
            "unknown_left_out": why_not,
        },
        () if why_not is None else (f"Without unknown motions: {why_not}.",),
        lambda: recognition_plot(results, reference),
    )
