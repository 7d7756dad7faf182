"""What the time of an update grows with: one thing is changed at a time, all else stays the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from humanpred_ros.evaluation.occupancy_runs import P1_RESOLUTION_M
from humanpred_ros.evaluation.predictor_bench.people import People
from humanpred_ros.evaluation.predictor_bench.timing import Timing, update_seconds
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.placement import placed, turn_and_shift
from humanpred_ros.occupancy.predictor import Predictor, PredictorRequest, make_predictor
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR
from humanpred_ros.reaching.futures import ReachFuturesSettings
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.training import TrainedModel, train_model

#: Lengths of the motions whose last postures are timed, and how many of these.
_FRAMES_SEEN = (100, 1000, 10000)
_LAST_FRAMES = 100
#: Numbers of places that reaching is timed with, and how many first postures.
_PLACES = (1, 2, 4, 8, 16)
_FIRST_POSTURES = 20
_UPDATE = "update of the default"


@dataclass(frozen=True)
class Growth:
    """One thing changed, all else the same: `size` of `what`, and the timing there."""

    name: str
    what: str
    size: int
    timing: Timing


def growth_of_default(people: People, model: TrainedModel, report: Callable[[str], None]) -> tuple[Growth, ...]:
    """Measure what the default classifier and predictor grow with: classes, voxels, frames seen."""
    return (
        *_with_classes(people, report),
        *_with_voxels(people, model, report),
        *_with_frames(people, model, report),
    )


def growth_of_reaching(everybody: Sequence[People], report: Callable[[str], None]) -> Iterator[Growth]:
    """Measure reaching with ever more places, each human beside the other.

    First postures of reaches, when every place is as probable as any other: the most that `reaching` ever does.
    """
    futures = ReachFuturesSettings().n_samples
    for count in _PLACES:
        for people in everybody:
            report(f"{count} places, {people.human_name}")
            predictor = ReachingPredictor(people.knowledge, people.grid(), np.eye(4), people.places(count).by_label)
            begun = (list(people.played) * _FIRST_POSTURES)[:_FIRST_POSTURES]
            timing = Timing.of(update_seconds(predictor, begun, n_frames=1))
            yield Growth(
                f"update of reaching, {people.human_name}, {futures} futures for each", "places", count, timing
            )


def _with_classes(people: People, report: Callable[[str], None]) -> Iterator[Growth]:
    """Two classes, four, and so on to twice as many as there are; the new ones are the old, one metre aside."""
    library, human, grid = people.training, people.human, people.grid()
    aside = turn_and_shift(0.0, (1.0, 0.0, 0.0))
    offset = max(library.labels) - min(library.labels) + 1
    moved = [replace(placed(motion, aside), label=(motion.label or 0) + offset) for motion in library]
    doubled = replace(library, motions=(*library.motions, *moved))
    n = 2
    while n <= len(doubled.labels):
        report(f"{n} classes")
        few = doubled.select(lambda motion, kept=doubled.labels[:n]: motion.label in kept)  # type: ignore[misc]
        model = train_model(few, human, {DEFAULT_CLASSIFIER: None})
        recognised = Timing.of(update_seconds(model.classifier(DEFAULT_CLASSIFIER), people.played))
        yield Growth("recognition of the default", "classes", n, recognised)
        updated = Timing.of(update_seconds(_default(model, human, grid), people.played))
        yield Growth(_UPDATE, "classes", n, updated)
        n *= 2


def _with_voxels(people: People, model: TrainedModel, report: Callable[[str], None]) -> Iterator[Growth]:
    for resolution_m in (2 * P1_RESOLUTION_M, P1_RESOLUTION_M, P1_RESOLUTION_M / 2):
        grid = people.grid(resolution_m)
        report(f"{grid.size} voxels")
        timing = Timing.of(update_seconds(_default(model, people.human, grid), people.played))
        yield Growth(_UPDATE, "voxels", grid.size, timing)


def _with_frames(people: People, model: TrainedModel, report: Callable[[str], None]) -> Iterator[Growth]:
    """The last postures of ever longer motions: the played ones over and over, never started anew."""
    postures, dof_names = np.vstack([motion.q for motion in people.played]), people.training.dof_names
    for n_frames in _FRAMES_SEEN:
        report(f"{n_frames} frames")
        endless = Motion(np.arange(n_frames) / 60, np.resize(postures, (n_frames, len(dof_names))), dof_names)
        seconds = update_seconds(_default(model, people.human, people.grid()), [endless])[-_LAST_FRAMES:]
        yield Growth(_UPDATE, "frames seen", n_frames, Timing.of(seconds))


def _default(model: TrainedModel, human: HumanModel, grid: VoxelGrid) -> Predictor:
    return make_predictor(DEFAULT_PREDICTOR, PredictorRequest(human, grid, np.eye(4), model))
