"""Predictions do not depend on how they are spread over processes; long ones begin first."""

from __future__ import annotations

import dataclasses

import numpy as np
from reaching_people import MODEL, recording

from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.reaching.entry import ReachingMaterial
from humanpred_ros.evaluation.reaching.runs import RecordingOutcome, RecordingRuns, RecordingTask, long_first

RECORDINGS = [recording(seed, n_frames=40) for seed in range(2)]


def test_any_number_of_processes_gives_the_same_figures() -> None:
    runs = RecordingRuns(ReachingMaterial(RECORDINGS, MODEL), seed=3)
    tasks = [RecordingTask(name, entry, 2) for name in ("baseline_0", "bow") for entry in RECORDINGS]
    here = [runs(task) for task in tasks]
    there = map_processes(runs, tasks, 2)

    def plain(outcomes: list[RecordingOutcome]) -> list[object]:
        return [(outcome.figures.recording, dataclasses.asdict(outcome.figures.figures)) for outcome in outcomes]

    assert plain(there) == plain(here)
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.figures.wrist_m, other.figures.wrist_m)
        assert len(other.times_s) == 2


def test_long_tasks_are_done_first() -> None:
    short, long = recording(0, n_frames=40), recording(1, n_frames=90)
    tasks = [
        RecordingTask("hold", long, 1),
        RecordingTask("learned", long, 10),
        RecordingTask("learned_replanned", short, 10),
        RecordingTask("learned_replanned", long, 10),
        RecordingTask("baseline_0", short, 2),
    ]
    assert long_first(tasks) == [3, 2, 1, 4, 0]
