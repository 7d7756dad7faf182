"""How well is a reach predicted that was never seen? P2's Tables I to III, beside predictors that anybody can write.

Every recorded reach is predicted from its first and last posture, its duration and the partner beside it, by a
predictor that may have learned from all other recordings (leave one out), and compared by time warping with what the
person really did. Recordings with marker jumps are tested like the others.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from humanpred_ros.checks import FloatArray
from humanpred_ros.errors import UsageError
from humanpred_ros.experiments.evaluation_files import machine_facts
from humanpred_ros.experiments.reaching_entry import ReachingMaterial, Without
from humanpred_ros.experiments.reaching_predictors import REACHING_PREDICTORS
from humanpred_ros.experiments.reaching_reference import (
    DEMONSTRATIONS,
    INTERFERENCE_CASE,
    PUBLISHED,
    PUBLISHED_INTERFERENCE,
    TABLE1,
    PublishedRow,
)
from humanpred_ros.experiments.reaching_result import (
    DistanceFigures,
    PredictorFigures,
    ReachingEvaluation,
    ReachingSet,
    RecordingFigures,
)
from humanpred_ros.experiments.reaching_targets import reference_targets
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.task import ReachTask

#: The row that compares each recording with itself: what a perfect prediction scores.
ITSELF = "itself"


@dataclass(frozen=True)
class ReachingConfig:
    """What is run.

    Attributes:
        predictors: names of `REACHING_PREDICTORS`.
        runs: of each recording, for predictors that chance plays a part in (P2: 10).
        seed: of learning and of the runs.

    Raises:
        UsageError: names or numbers that cannot be.
    """

    predictors: tuple[str, ...] = tuple(REACHING_PREDICTORS)
    runs: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        unknown = [name for name in self.predictors if name not in REACHING_PREDICTORS]
        if unknown or not self.predictors:
            raise UsageError(
                f"predictors: wanted some of {', '.join(REACHING_PREDICTORS)}, got {', '.join(unknown) or 'none'}"
            )
        if self.runs < 1 or self.seed < 0:
            raise UsageError(f"evaluation: wanted at least one run and a seed >= 0, got {self.runs} and {self.seed}")


def evaluate_reaching(
    recordings: Sequence[ReachRecording],
    interference: Sequence[ReachRecording] = (),
    config: ReachingConfig | None = None,
    *,
    model: HumanModel | None = None,
    progress: Callable[[int], None] | None = None,
) -> ReachingEvaluation:
    """Predict all recordings with all predictors and return the figures.

    Args:
        recordings: demonstrations, each predicted from the others.
        interference: reaches that the partner is in the way of, predicted from all demonstrations.
        config: what is run.
        model: the human; P2's 23-DoF human if None.
        progress: called with the number of recordings and predictors done.

    Raises:
        UsageError: no recordings, or fewer than two, of which none could be left out.
    """
    config = config or ReachingConfig()
    if len(recordings) < 2:
        raise UsageError(f"evaluation: wanted at least 2 recordings, to leave one out, got {len(recordings)}")
    model = model or HumanModel.mocap23()
    ordered = sorted(recordings, key=_papers_order)
    material = ReachingMaterial(ordered, model, config.seed)
    work = _Work(config, model, progress)
    predictors = {name: REACHING_PREDICTORS[name].prepare(material) for name in config.predictors}
    seven = {recording.name for recording in ordered} == set(DEMONSTRATIONS)
    demos = work.set_of("leaving the tested one out", ordered, predictors, PUBLISHED if seven else (), left_out=True)
    sets = [demos]
    if interference:
        known = {recording.name for recording in ordered}
        if twice := [recording.name for recording in interference if recording.name in known]:
            raise UsageError(f"interference case: wanted recordings not learned from, got {', '.join(twice)} again")
        published = PUBLISHED_INTERFERENCE if [r.name for r in interference] == [INTERFERENCE_CASE] else ()
        sets.append(work.set_of("partner in the way", interference, predictors, published, left_out=False))
    return ReachingEvaluation(
        settings={"config": asdict(config), "human": model.name, "human_signature": model.signature},
        machine=machine_facts(),
        sets=tuple(sets),
        table1={recording.name: TABLE1[recording.name] for recording in ordered if recording.name in TABLE1},
        targets=reference_targets(demos, sets[1] if len(sets) > 1 else None),
    )


def steps_of(recordings: int, config: ReachingConfig) -> int:
    """Return how often `progress` is called for so many recordings."""
    return recordings * len(config.predictors)


@dataclass
class _Work:
    """One evaluation under way."""

    config: ReachingConfig
    model: HumanModel
    progress: Callable[[int], None] | None
    done: int = 0

    def __post_init__(self) -> None:
        self.metric = ReachMetric(self.model)

    def set_of(
        self,
        title: str,
        recordings: Sequence[ReachRecording],
        predictors: dict[str, Without],
        published: Sequence[PublishedRow],
        *,
        left_out: bool,
    ) -> ReachingSet:
        return ReachingSet(
            title=title,
            recordings=tuple(_facts(recording) for recording in recordings),
            wrist_m=tuple(self.wrist(recording.active.q) for recording in recordings),
            predictors=(
                *(self.predicted(name, without, recordings) for name, without in predictors.items()),
                self.itself(recordings),
            ),
            published=tuple(published),
            left_out=left_out,
        )

    def predicted(self, name: str, without: Without, recordings: Sequence[ReachRecording]) -> PredictorFigures:
        entry = REACHING_PREDICTORS[name]
        runs = self.config.runs if entry.by_chance else 1
        found, times_s = [], []
        for recording in recordings:
            predictor, task = without(recording.name), ReachTask.of(recording)
            reaches = []
            for run in range(runs):
                rng = np.random.default_rng([self.config.seed, run])
                begin = time.perf_counter()
                reaches.append(predictor.predict(task, rng))
                times_s.append(time.perf_counter() - begin)
            distances = [self.metric.between(q, recording.active.q) for q in reaches]
            found.append(RecordingFigures(recording.name, DistanceFigures.of(distances), self.wrist(reaches[0])))
            self.done += 1
            if self.progress is not None:
                self.progress(self.done)
        return _figures(name, entry.description, runs, found, recordings, 1e3 * float(np.median(times_s)))

    def itself(self, recordings: Sequence[ReachRecording]) -> PredictorFigures:
        found = [
            RecordingFigures(
                recording.name,
                DistanceFigures.of([self.metric.between(recording.active.q, recording.active.q)]),
                self.wrist(recording.active.q),
            )
            for recording in recordings
        ]
        return _figures(ITSELF, "the recording itself: a perfect prediction", 1, found, recordings, float("nan"))

    def wrist(self, q: FloatArray) -> FloatArray:
        return self.model.forward(q)["right_wrist"]


def _figures(
    name: str,
    description: str,
    runs: int,
    found: Sequence[RecordingFigures],
    recordings: Sequence[ReachRecording],
    predict_ms: float,
) -> PredictorFigures:
    fit = [entry.figures for entry, r in zip(found, recordings, strict=True) if r.usable_for_learning]
    return PredictorFigures(
        name=name,
        description=description,
        runs=runs,
        recordings=tuple(found),
        average=DistanceFigures.average([entry.figures for entry in found]),
        average_fit=DistanceFigures.average(fit) if fit else None,
        predict_ms=predict_ms,
    )


def _facts(recording: ReachRecording) -> dict[str, object]:
    return {
        "name": recording.name,
        "n_frames": len(recording.active),
        "duration_s": recording.active.duration_s,
        "unfit": recording.unfit,
        "notes": list(recording.notes),
    }


def _papers_order(recording: ReachRecording) -> tuple[int, str]:
    known = recording.name in DEMONSTRATIONS
    return (DEMONSTRATIONS.index(recording.name) if known else len(DEMONSTRATIONS), recording.name)
