"""Everything an evaluation of recognition found, in one immutable object for tables, plots and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from humanpred_ros.evaluation.outputs import plain
from humanpred_ros.evaluation.recognition.reference import ReferenceCurve
from humanpred_ros.evaluation.recognition.scores import Calibration, CurveFigures, IntArray
from humanpred_ros.evaluation.recognition.targets import recognition_targets
from humanpred_ros.evaluation.target import Target
from humanpred_ros.geometry.checks import FloatArray


@dataclass(frozen=True)
class SpeedScore:
    """How well the same motions are recognised when done faster or slower.

    Attributes:
        speed: factor of the recorded speed.
        rate: (100,) share recognised at each percent of the motion.
        worst_drop_points, worst_drop_percent: by how many percentage points the share is below that at the recorded
            speed at worst, beyond 40 % of the motion, and at which percent.
    """

    speed: float
    rate: FloatArray
    worst_drop_points: float
    worst_drop_percent: int


@dataclass(frozen=True)
class UnknownScore:
    """How well motions of classes that were never learned are told from left-out motions of learned ones.

    Attributes:
        says_something: False if the classifier gives the same probability of no class to all motions; its AUROC
            is then None.
        tenths: (10,) percents 10, 20, .. 100 of the following.
        auroc: (10,) probability that an unknown motion gets a higher probability of no class than a known one.
        refused_unknown, refused_known: (10,) share of unknown and known motions whose probability of no class is
            at least `threshold`.
        auroc_at_60: the sixth of `auroc`.
        auroc_at_60_by_class: the same for the motions of each class when it is the one left out.
        refused_at_60_by_class: share of them refused.
        quartiles: (3, 100) quartiles of the probability of no class over the unknown motions.
    """

    says_something: bool
    threshold: float
    tenths: IntArray
    auroc: FloatArray | None
    refused_unknown: FloatArray
    refused_known: FloatArray
    auroc_at_60: float | None
    auroc_at_60_by_class: Mapping[int, float] | None
    refused_at_60_by_class: Mapping[int, float]
    quartiles: FloatArray


@dataclass(frozen=True)
class GroupScore:
    """The curve's figures for part of the motions.

    Attributes:
        group: which motions, in words.
        n_motions: how many.
        figures: of their curve.
    """

    group: str
    n_motions: int
    figures: CurveFigures


@dataclass(frozen=True)
class Timing:
    """Times; the only part of a result that differs from run to run.

    Attributes:
        fit_s: median time to learn the whole library, one BLAS thread.
        n_fits: number of fits timed.
        update_us, update_us_p99: median and 99 % quantile of the time of one update, over all frames of all left-out
            motions.
        wall_s: from start to end of this classifier's evaluation, process start and reading included.
        cpu_s: processor time by part, summed over the processes; fitting the whole library in each comes on top.
    """

    fit_s: float
    n_fits: int
    update_us: float
    update_us_p99: float
    wall_s: float
    cpu_s: Mapping[str, float]


@dataclass(frozen=True)
class ClassifierResult:
    """Leave-one-out figures of one classifier. All but the speeds and the unknown motions are at recorded speed.

    Attributes:
        name, settings: which classifier.
        learned_of_class: what it knew of the tested motion's class, in words; nothing of the motion in any case.
        rate: (100,) share of motions whose true class alone is the most probable, after each percent of postures.
        figures: of that curve.
        reference_rms: root mean square difference to the published curve, if there is one.
        log_loss: mean over motions and percents of -ln of the true class's probability, given that the motion is of
            some class, by the least probability counted ("clip"); one motion given up for certain costs
            -ln(clip) at each percent.
        log_loss_curve: (100,) the same per percent, for the larger clip.
        brier, brier_curve: mean squared distance of posterior and truth, 0 to 2; over all, and per percent.
        calibration: of the probability of the most probable class, given that the motion is of some class.
        calibration_with_unknown: the same without that condition, so that a probability of no class lowers it.
        confusion_at_60: (C, C + 1) true class by decision, undecided last, in the order of the labels.
        unknown_on_known: mean probability of no class at 10, 30, 60 and 90 % of motions of known classes.
        unknown_quartiles: (3, 100) its quartiles over them.
        speeds: further speeds.
        unknown: motions of classes never learned; None if not asked for, or with too few classes.
        groups: parts of the motions that somebody has flagged, if the library has such flags.
        refused_postures: how many postures of the left-out motions the classifier refused.
        timing: times.
    """

    name: str
    settings: Mapping[str, Any]
    learned_of_class: str
    rate: FloatArray
    figures: CurveFigures
    reference_rms: float | None
    log_loss: Mapping[str, float]
    log_loss_curve: FloatArray
    brier: float
    brier_curve: FloatArray
    calibration: Calibration
    calibration_with_unknown: Calibration
    confusion_at_60: IntArray
    unknown_on_known: Mapping[int, float]
    unknown_quartiles: FloatArray
    speeds: tuple[SpeedScore, ...]
    unknown: UnknownScore | None
    groups: tuple[GroupScore, ...]
    refused_postures: int
    timing: Timing


@dataclass(frozen=True)
class RecognitionEvaluation:
    """All classifiers evaluated on one library.

    Attributes:
        library: name, counts and provenance.
        labels: C classes.
        settings: what was asked for, the seed included.
        machine: what times depend on.
        reference: the published curve, if there is one.
        classifiers: in the order asked for.
        unknown_left_out: why no class was left out whole though that was asked for; None if it was done or not asked.
    """

    library: Mapping[str, Any]
    labels: tuple[int, ...]
    settings: Mapping[str, Any]
    machine: Mapping[str, Any]
    reference: ReferenceCurve | None
    classifiers: tuple[ClassifierResult, ...]
    unknown_left_out: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Return all of it as JSON knows it."""
        found: dict[str, Any] = plain(self)
        found["targets"] = plain(self.targets)
        return found

    @property
    def targets(self) -> tuple[Target, ...]:
        """What the project wants of these classifiers, beside what was reached."""
        return recognition_targets({result.name: result.figures for result in self.classifiers})
