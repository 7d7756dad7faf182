"""What a process does of an evaluation of reaches: predict one recording with one predictor, as often as asked."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from humanpred_ros.evaluation.reaching.entry import ReachingEntry, ReachingMaterial, Without
from humanpred_ros.evaluation.reaching.predictors import reaching_entry
from humanpred_ros.evaluation.reaching.result import DistanceFigures, RecordingFigures
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.reach_task import ReachTask

WRIST = "right_wrist"
Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class RecordingTask:
    """One recording to predict with one predictor, by name, `runs` times."""

    predictor: str
    recording: ReachRecording
    runs: int


@dataclass(frozen=True)
class RecordingOutcome:
    """Figures of one task, and how long each prediction took, s."""

    figures: RecordingFigures
    times_s: tuple[float, ...]


class Spread(Protocol):
    """Does tasks, in their order or side by side; see `map_processes`."""

    def __call__(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        jobs: int,
        progress: Callable[[int], None] | None = None,
    ) -> list[Result]:
        """Return `function(task)` of every task, in the order of the tasks."""
        ...


class RecordingRuns:
    """Does tasks; a process keeps it, with what all tasks share.

    Args:
        material: what predictors are made of.
        seed: of the runs; run k of any recording and predictor draws from (seed, k).
    """

    def __init__(self, material: ReachingMaterial, seed: int) -> None:
        self._material, self._seed = material, seed
        self._prepared: dict[str, Without] = {}

    def __reduce__(self) -> tuple[type[RecordingRuns], tuple[ReachingMaterial, int]]:
        """Leave what was prepared behind: predictors need not be able to travel."""
        return RecordingRuns, (self._material, self._seed)

    def __call__(self, task: RecordingTask) -> RecordingOutcome:
        """Predict and compare; the predictor knows nothing of the recording, unless it is one `of_tested`."""
        recording, model = task.recording, self._material.model
        if task.predictor not in self._prepared:
            self._prepared[task.predictor] = reaching_entry(task.predictor).prepare(self._material)
        predictor, reach = self._prepared[task.predictor](recording.name), ReachTask.of(recording)
        reaches, times_s = [], []
        for run in range(task.runs):
            rng = np.random.default_rng([self._seed, run])
            begin = time.perf_counter()
            reaches.append(predictor.predict(reach, rng))
            times_s.append(time.perf_counter() - begin)
        metric = ReachMetric(model)
        figures = RecordingFigures(
            recording.name,
            DistanceFigures.of([metric.between(q, recording.active.q) for q in reaches]),
            model.forward(reaches[0])[WRIST],
        )
        return RecordingOutcome(figures, tuple(times_s))


def long_first(tasks: Sequence[RecordingTask]) -> list[int]:
    """Return the numbers of the tasks in the order in which processes are busy until the end."""

    def length(number: int) -> tuple[float, float]:
        task = tasks[number]
        entry: ReachingEntry = reaching_entry(task.predictor)
        duration_s = task.recording.active.duration_s
        # A single plan takes as long for any duration; plans on the way come every 0.1 s.
        return task.runs * (duration_s if entry.replanned else 0.1 if entry.by_chance else 0.0), -number

    return sorted(range(len(tasks)), key=length, reverse=True)
