"""How long one prediction takes: measured by itself, in one process, while the evaluation does nothing else."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.evaluation.reaching.entry import ReachingMaterial
from humanpred_ros.evaluation.reaching.predictors import reaching_entry
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.reach_task import ReachTask

#: The duration that the project's target is about, s.
TARGET_DURATION_S = 1.3
#: Predictions that are timed, and before these what is done once (compiling, distances to the table).
_TIMED, _FIRST = 15, 2


@dataclass(frozen=True)
class PredictionTime:
    """Times of one predictor.

    Attributes:
        predictor: its name.
        recording, duration_s: what was predicted.
        median_ms, slowest_ms: of 15 predictions.
        processor_ms: median of the processor time, which other work on the machine matters less to.
    """

    predictor: str
    recording: str
    duration_s: float
    median_ms: float
    slowest_ms: float
    processor_ms: float


def prediction_times(
    names: Sequence[str], recordings: Sequence[ReachRecording], material: ReachingMaterial
) -> tuple[PredictionTime, ...]:
    """Time those predictors that plan a reach once, on the recording nearest to 1.3 s; several plans are several."""
    recording = min(recordings, key=lambda entry: abs(entry.active.duration_s - TARGET_DURATION_S))
    reach = ReachTask.of(recording)
    found = []
    for name in names:
        entry = reaching_entry(name)
        if not entry.by_chance or entry.replanned:
            continue
        predictor = entry.prepare(material)(recording.name)
        times_s, processor_s = [], []
        for run in range(_FIRST + _TIMED):
            rng = np.random.default_rng(run)
            begin, processor_begin = time.perf_counter(), time.process_time()
            predictor.predict(reach, rng)
            times_s.append(time.perf_counter() - begin)
            processor_s.append(time.process_time() - processor_begin)
        timed_ms = 1e3 * np.array(times_s[_FIRST:])
        found.append(
            PredictionTime(
                name,
                recording.name,
                recording.active.duration_s,
                float(np.median(timed_ms)),
                float(timed_ms.max()),
                1e3 * float(np.median(processor_s[_FIRST:])),
            )
        )
    return tuple(found)
