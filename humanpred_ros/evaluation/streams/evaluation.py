"""Does the system know, in a stream of standing and reaching, when a reach begins and ends, and still recognise it?"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.evaluation.outputs import plain
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.recognition_runs import make_evaluated
from humanpred_ros.evaluation.streams.runs import PERCENTS, VARIANTS, Outcome, StreamRuns
from humanpred_ros.evaluation.streams.scores import FalseStarts, MotionScore, OnsetFigures, onset_figures
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.onset import OnsetConfig


@dataclass(frozen=True)
class StreamEvaluationConfig:
    """How to evaluate.

    Attributes:
        classifier: name in the registry, None to look at onsets and ends only.
        seed: of order, pauses and noise.
        standing_s: duration of mere standing, on which false starts are counted.
        tolerance_s: an onset announced within this of the true one is found in time.
        jobs: number of processes; changes times only.

    Raises:
        UsageError: impossible numbers, or an unknown classifier.
    """

    classifier: str | None = None
    seed: int = 0
    standing_s: float = 1800.0
    tolerance_s: float = 0.2
    jobs: int = 1

    def __post_init__(self) -> None:
        for name in ("standing_s", "tolerance_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise UsageError(f"streams: wanted {name} finite and above 0, got {value}")
        if self.seed < 0:
            raise UsageError(f"seed: wanted a number of at least 0, got {self.seed}")
        if self.classifier is not None:
            make_evaluated(self.classifier)


@dataclass(frozen=True)
class VariantResult:
    """Onsets and ends in one kind of streams.

    Attributes:
        name: of the variant.
        groups: figures by group of recorded motions: all, even and odd rounds, flagged or not; None of empty ones.
        made: of the returns that were made, None where motions come back by themselves.
        false_starts: onsets announced in the streams between motions.
        streams_s: duration of all streams.
        standing_starts: onsets announced while the person only stood, by rounds: all, even, odd.
        standing_s: durations of that.
    """

    name: str
    groups: Mapping[str, OnsetFigures | None]
    made: OnsetFigures | None
    false_starts: FalseStarts
    streams_s: float
    standing_starts: Mapping[str, int]
    standing_s: Mapping[str, float]

    def per_ten_minutes(self, rounds: str = "all") -> float:
        """Return the false starts per ten minutes of mere standing."""
        return 600.0 * self.standing_starts[rounds] / self.standing_s[rounds]


@dataclass(frozen=True)
class RecognitionResult:
    """Share of motions recognised at each of `percents`, in the stream and each alone, by group."""

    percents: tuple[int, ...]
    n_motions: Mapping[str, int]
    in_stream: Mapping[str, tuple[float, ...]]
    alone: Mapping[str, tuple[float, ...]]
    refused: int


@dataclass(frozen=True)
class StreamEvaluation:
    """Everything an evaluation of streams found.

    Attributes:
        variants: the first is as recorded.
        recognition: None without a classifier.
        motions: of each recorded motion in the streams as recorded, what was announced.
        detector_us, stream_us: median and 99th percentile of an update: detection only, and with the classifier.
        most_us: longest update with the classifier; where an onset is found, it is shown the buffered postures.
        wall_s: duration of the evaluation.
    """

    variants: tuple[VariantResult, ...]
    recognition: RecognitionResult | None
    motions: tuple[MotionScore, ...]
    detector_us: tuple[float, float]
    stream_us: tuple[float, float] | None
    most_us: float | None
    wall_s: float

    def to_json(self) -> dict[str, Any]:
        """Return all figures as plain values."""
        found: dict[str, Any] = plain(asdict(self))
        for variant, values in zip(self.variants, found["variants"], strict=True):
            values["false_starts_per_ten_minutes"] = {
                rounds: variant.per_ten_minutes(rounds) for rounds, s in variant.standing_s.items() if s > 0
            }
        return found


def evaluate_streams(
    library: MotionLibrary,
    config: StreamEvaluationConfig,
    *,
    onset: OnsetConfig | None = None,
    flagged: frozenset[str] = frozenset(),
    progress: Callable[[int], None] | None = None,
) -> StreamEvaluation:
    """Make a stream of each recording round, left out of learning, and look at what is announced on it.

    The motions with one index, one of every class, are a round: a stream holds many motions, none of which may have
    been learned from.

    Args:
        library: whose motions are all in the streams.
        config: how.
        onset: the detector's settings.
        flagged: motions (`class/index`) which somebody knows to be mistracked. All count; figures without them and of
            them alone are given beside.
        progress: called with the number of rounds done.

    Raises:
        LibraryFormatError: a library without labels, or of one round, or what the classifier cannot learn.
    """
    begun = time.perf_counter()
    rounds = check_rounds(library)
    runs = StreamRuns(library, config.classifier, onset or OnsetConfig(), config.seed, config.standing_s)
    outcomes = dict(zip(rounds, map_processes(runs, rounds, config.jobs, progress), strict=True))
    names = {motion.name: motion.index for motion in library}
    groups: dict[str, Callable[[str], bool]] = {
        "all": lambda name: True,
        "even rounds": lambda name: names[name] % 2 == 0,
        "odd rounds": lambda name: names[name] % 2 == 1,
        "not flagged": lambda name: name not in flagged,
        "not flagged, odd rounds": lambda name: name not in flagged and names[name] % 2 == 1,
        "flagged": lambda name: name in flagged,
    }
    detector_us = np.concatenate([outcome.detector_us for outcome in outcomes.values()])
    stream_us = np.concatenate([outcome.stream_us for outcome in outcomes.values()])
    timed = len(stream_us) > 0
    recorded = [s for o in outcomes.values() for s in o.variants[VARIANTS[0].name].scores if not s.made]
    return StreamEvaluation(
        variants=tuple(_variant(variant.name, outcomes, groups, config.tolerance_s) for variant in VARIANTS),
        recognition=_recognition(outcomes, groups) if config.classifier is not None else None,
        motions=tuple(recorded),
        detector_us=_median_and_99(detector_us),
        stream_us=_median_and_99(stream_us) if timed else None,
        most_us=float(stream_us.max()) if timed else None,
        wall_s=time.perf_counter() - begun,
    )


def check_rounds(library: MotionLibrary) -> list[int]:
    """Return the indices of the library's rounds; raises LibraryFormatError if none can be left out."""
    unlabelled = [motion.name for motion in library if motion.label is None]
    if unlabelled:
        raise LibraryFormatError(
            f"library {library.name}: wanted a class for every motion, {unlabelled[0]} has none; label it"
        )
    rounds = sorted({motion.index for motion in library})
    if len(rounds) < 3:
        raise LibraryFormatError(
            f"library {library.name}: wanted at least 3 recording rounds (motions of one index), so that two are left "
            f"to learn from, got {len(rounds)}; record more"
        )
    return rounds


def _variant(
    name: str, outcomes: Mapping[int, Outcome], groups: Mapping[str, Callable[[str], bool]], tolerance_s: float
) -> VariantResult:
    found = {index: outcome.variants[name] for index, outcome in outcomes.items()}
    scores = [score for outcome in found.values() for score in outcome.scores]
    halves = {"all": (0, 1), "even rounds": (0,), "odd rounds": (1,)}
    return VariantResult(
        name=name,
        groups={
            group: onset_figures([s for s in scores if not s.made and belongs(s.name)], tolerance_s)
            for group, belongs in groups.items()
        },
        made=onset_figures([s for s in scores if s.made], tolerance_s),
        false_starts=sum((outcome.false_starts for outcome in found.values()), FalseStarts(0, 0, 0)),
        streams_s=sum(outcome.stream_s for outcome in found.values()),
        standing_starts={
            half: sum(outcome.standing_starts for index, outcome in found.items() if index % 2 in parities)
            for half, parities in halves.items()
        },
        standing_s={
            half: sum(outcome.standing_s for index, outcome in found.items() if index % 2 in parities)
            for half, parities in halves.items()
        },
    )


def _recognition(outcomes: Mapping[int, Outcome], groups: Mapping[str, Callable[[str], bool]]) -> RecognitionResult:
    found = [recognition for outcome in outcomes.values() for recognition in outcome.recognition]
    members = {group: [r for r in found if belongs(r.name)] for group, belongs in groups.items()}
    filled = {group: chosen for group, chosen in members.items() if chosen}
    return RecognitionResult(
        percents=PERCENTS,
        n_motions={group: len(chosen) for group, chosen in filled.items()},
        in_stream={group: _shares([r.in_stream for r in chosen]) for group, chosen in filled.items()},
        alone={group: _shares([r.alone for r in chosen]) for group, chosen in filled.items()},
        refused=sum(outcome.refused for outcome in outcomes.values()),
    )


def _shares(right: list[tuple[bool, ...]]) -> tuple[float, ...]:
    return tuple(float(share) for share in np.mean(np.array(right, dtype=np.float64), axis=0))


def _median_and_99(values: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[float, float]:
    median, top = np.percentile(values, [50, 99])
    return float(median), float(top)
