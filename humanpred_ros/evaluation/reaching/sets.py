"""From single predictions to the figures of a set of recordings, averaged as P2 averages them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from humanpred_ros.errors import GoalUnreachableError
from humanpred_ros.evaluation.reaching.entry import REFERENCE
from humanpred_ros.evaluation.reaching.predictors import reaching_entry
from humanpred_ros.evaluation.reaching.reference import PublishedRow
from humanpred_ros.evaluation.reaching.result import DistanceFigures, PredictorFigures, ReachingSet, RecordingFigures
from humanpred_ros.evaluation.reaching.runs import WRIST, RecordingOutcome
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.posture_bounds import PostureBounds

#: The row that compares each recording with itself: what a perfect prediction scores.
ITSELF = "itself"


def set_of(
    title: str,
    recordings: Sequence[ReachRecording],
    found: Mapping[tuple[str, str], RecordingOutcome],
    predictors: Sequence[str],
    model: HumanModel,
    published: Sequence[PublishedRow],
    *,
    left_out: bool,
    learned_from: Sequence[ReachRecording],
) -> ReachingSet:
    """Return the figures of recordings.

    Args:
        title: what they are.
        recordings: all that were predicted.
        found: outcomes by predictor and recording.
        predictors: names, in the order of tables.
        model: the human.
        published: rows to print beside.
        left_out: whether the recordings are those learned from, the tested one left out.
        learned_from: the recordings that predictors learn from.
    """
    figures = [
        _predicted(name, [found[name, recording.name] for recording in recordings], recordings)
        for name in predictors
        if left_out or not reaching_entry(name).of_tested
    ]
    return ReachingSet(
        title=title,
        recordings=tuple(_facts(recording, learned_from, model) for recording in recordings),
        wrist_m=tuple(model.forward(recording.active.q)[WRIST] for recording in recordings),
        predictors=(*figures, _itself(recordings, model)),
        published=tuple(published),
        left_out=left_out,
    )


def _predicted(
    name: str, outcomes: Sequence[RecordingOutcome], recordings: Sequence[ReachRecording]
) -> PredictorFigures:
    entry = reaching_entry(name)
    times_ms = 1e3 * np.concatenate([outcome.times_s for outcome in outcomes])
    return _figures(
        name, entry.description, entry.group, len(outcomes[0].times_s),
        [outcome.figures for outcome in outcomes], recordings, float(np.median(times_ms)),
    )  # fmt: skip


def _itself(recordings: Sequence[ReachRecording], model: HumanModel) -> PredictorFigures:
    metric = ReachMetric(model)
    found = [
        RecordingFigures(
            recording.name,
            DistanceFigures.of([metric.between(recording.active.q, recording.active.q)]),
            model.forward(recording.active.q)[WRIST],
        )
        for recording in recordings
    ]
    text = "the recording itself: a perfect prediction"
    return _figures(ITSELF, text, REFERENCE, 1, found, recordings, float("nan"))


def _figures(
    name: str,
    description: str,
    group: str,
    runs: int,
    found: Sequence[RecordingFigures],
    recordings: Sequence[ReachRecording],
    predict_ms: float,
) -> PredictorFigures:
    fit = [entry.figures for entry, r in zip(found, recordings, strict=True) if r.usable_for_learning]
    return PredictorFigures(
        name=name,
        description=description,
        group=group,
        runs=runs,
        recordings=tuple(found),
        average=DistanceFigures.average([entry.figures for entry in found]),
        average_fit=DistanceFigures.average(fit) if fit else None,
        predict_ms=predict_ms,
    )


def _facts(recording: ReachRecording, learned_from: Sequence[ReachRecording], model: HumanModel) -> dict[str, object]:
    return {
        "name": recording.name,
        "n_frames": len(recording.active),
        "duration_s": recording.active.duration_s,
        "unfit": recording.unfit,
        "notes": [*recording.notes, *_beyond(recording, learned_from, model)],
    }


def _beyond(recording: ReachRecording, learned_from: Sequence[ReachRecording], model: HumanModel) -> tuple[str, ...]:
    """Return what is to be said of a goal that is beyond what predictors have seen; it is predicted all the same."""
    others = [other for other in learned_from if other.name != recording.name]
    if not others:
        return ()
    try:
        said = PostureBounds.from_recordings(others, model).check_goal(recording.name, recording.active.q[-1])
    except GoalUnreachableError as far:
        said = (str(far),)
    return tuple(text.removeprefix(f"{recording.name}: ") for text in said)
