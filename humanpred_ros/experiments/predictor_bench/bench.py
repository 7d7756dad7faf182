"""How long one posture takes: to be recognised, to become occupancy, and through the node over DDS.

Medians of single calls, taken in one process on one core; what each grows with is measured by changing one thing at a
time. Machines differ and are shared, so ratios within one run say more than the figures.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.experiments.evaluation_grid import P1_RESOLUTION_M, grid_around
from humanpred_ros.experiments.processes import NodeGroup, free_domain_id
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.placement import placed, turn_and_shift
from humanpred_ros.occupancy.grid import VoxelGrid
from humanpred_ros.occupancy.predictor import DEFAULT_PREDICTOR, OccupancyPredictor
from humanpred_ros.predictors.factory import PREDICTORS, make_predictor
from humanpred_ros.predictors.reach_sources import ReachKnowledge
from humanpred_ros.reaching.goals.places import GoalPlaces
from humanpred_ros.recognition.classifier import DEFAULT_CLASSIFIER, IntentClassifier
from humanpred_ros.recognition.model_file import save_model
from humanpred_ros.recognition.registry import CLASSIFIERS, trained_classifier
from humanpred_ros.recognition.training import TrainedModel, train_model
from humanpred_ros.recording.reader import BagReader
from humanpred_ros.resources import locate

#: Postures fed before anything is timed: caches and the processor's clock settle.
_WARM_UP = 30
#: Lengths of the motions whose last postures are timed.
_FRAMES_SEEN = (100, 1000, 10000)
#: Numbers of places that reaching is timed with, how many first postures, and how far apart places are stacked.
_GOALS = (1, 2, 4, 8, 16)
_FIRST_POSTURES = 20
_HIGHER_M = 0.05
_POSTURES = "/humans/bodies/body_0/joint_states"
_OCCUPANCY = "/human_occupancy"


@dataclass(frozen=True)
class Timing:
    """Median and 99th percentile of `n` calls, microseconds."""

    median_us: float
    p99_us: float
    n: int

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        """Return the figures of durations in seconds."""
        if not len(seconds):
            raise UsageError("bench: wanted at least one call timed, got none; play more motions")
        median, p99 = np.quantile(np.asarray(seconds) * 1e6, (0.5, 0.99))
        return cls(float(median), float(p99), len(seconds))


@dataclass(frozen=True)
class Growth:
    """One thing changed, all else the same: `size` of `what`, and the timing there."""

    name: str
    what: str
    size: int
    timing: Timing


@dataclass(frozen=True)
class PredictorBench:
    """All that `humanpred bench predictor` measures.

    Attributes:
        library: name of the library; motions, classes: its size.
        recognition: by classifier.
        update: whole update by predictor, recognition included, on P1's grid.
        growth: of the default classifier and predictor, and of reaching with the number of places.
        node: posture to occupancy over DDS, at the recorder; None if left out.
    """

    library: str
    motions: int
    classes: int
    recognition: dict[str, Timing]
    update: dict[str, Timing]
    growth: tuple[Growth, ...]
    node: Timing | None


def bench_predictor(
    library: MotionLibrary, *, n_motions: int, folder: Path | None, report: Callable[[str], None]
) -> PredictorBench:
    """Measure everything.

    Args:
        library: its first `n_motions` of the first class are played, and not trained on.
        n_motions: how many.
        folder: where the node's run is kept; None leaves the node out.
        report: told what is measured next.

    Raises:
        HumanPredError: an unusable library, or a node that failed.
    """
    human = HumanModel.kinect12()
    played = library.of_class(library.labels[0])[:n_motions]
    names = {motion.name for motion in played}
    training = library.select(lambda motion: motion.name not in names)
    report(f"training on {len(training)} motions")
    model = train_model(training, human)
    grid = grid_around(training, human)
    recognition = {}
    for name in CLASSIFIERS:
        report(f"classifier {name}")
        recognition[name] = _timed(trained_classifier(name, model, human), played)
    update = {}
    for name in PREDICTORS:
        report(f"predictor {name}")
        update[name] = _timed(make_predictor(name, model, human, grid, np.eye(4)), played)
    growth = (
        *_with_classes(training, played, human, report),
        *_with_voxels(training, model, played, human, report),
        *_with_frames(training, model, played, human, report),
        *_with_goals(training, model, played, human, report),
    )
    node = None
    if folder is not None:
        report("the node over DDS")
        node = node_latency(folder)
    return PredictorBench(library.name, len(library), len(library.labels), recognition, update, growth, node)


def _with_classes(
    library: MotionLibrary, played: Sequence[Motion], human: HumanModel, report: Callable[[str], None]
) -> list[Growth]:
    """Two classes, four, and so on to twice as many as there are; the new ones are the old, one metre aside."""
    found, n = [], 2
    aside = turn_and_shift(0.0, (1.0, 0.0, 0.0))
    offset = max(library.labels) - min(library.labels) + 1
    moved = [replace(placed(motion, aside), label=(motion.label or 0) + offset) for motion in library]
    doubled = replace(library, motions=(*library.motions, *moved))
    while n <= len(doubled.labels):
        report(f"{n} classes")
        labels = doubled.labels[:n]
        part = doubled.select(lambda motion, kept=labels: motion.label in kept)  # type: ignore[misc]
        model = train_model(part, human)
        grid = grid_around(library, human)
        found += [
            Growth("recognition of the default", "classes", n, _timed(model.forest_classifier(human), played)),
            Growth("update of the default", "classes", n, _timed(_default(model, human, grid), played)),
        ]
        n *= 2
    return found


def _with_voxels(
    library: MotionLibrary,
    model: TrainedModel,
    played: Sequence[Motion],
    human: HumanModel,
    report: Callable[[str], None],
) -> list[Growth]:
    found = []
    for resolution_m in (2 * P1_RESOLUTION_M, P1_RESOLUTION_M, P1_RESOLUTION_M / 2):
        grid = grid_around(library, human, resolution_m)
        report(f"{grid.size} voxels")
        found.append(Growth("update of the default", "voxels", grid.size, _timed(_default(model, human, grid), played)))
    return found


def _with_frames(
    library: MotionLibrary,
    model: TrainedModel,
    played: Sequence[Motion],
    human: HumanModel,
    report: Callable[[str], None],
) -> list[Growth]:
    """The last hundred postures of ever longer motions: the played ones over and over, never started anew."""
    found = []
    for n_frames in _FRAMES_SEEN:
        report(f"{n_frames} frames")
        predictor = _default(model, human, grid_around(library, human))
        postures = np.vstack([motion.q for motion in played])
        seconds = []
        for k in range(n_frames):
            begin = time.perf_counter()
            predictor.update(postures[k % len(postures)], k / 60)
            if k >= n_frames - 100:
                seconds.append(time.perf_counter() - begin)
        found.append(Growth("update of the default", "frames seen", n_frames, Timing.of(seconds)))
    return found


def _with_goals(
    library: MotionLibrary,
    model: TrainedModel,
    played: Sequence[Motion],
    human: HumanModel,
    report: Callable[[str], None],
) -> list[Growth]:
    """First postures of reaches, when every place is as probable as any other: the most that `reaching` ever does."""
    found = []
    knowledge, grid = ReachKnowledge.of_model(model, human), grid_around(library, human)
    places = GoalPlaces.of_library(library, human).places_m
    for n_goals in _GOALS:
        report(f"{n_goals} goals")
        # The library's places over and over, a little higher each time.
        higher = np.array([0.0, 0.0, _HIGHER_M])
        told = np.array([places[k % len(places)] + k // len(places) * higher for k in range(n_goals)])
        predictor = knowledge.predictor(grid, np.eye(4), GoalPlaces(tuple(range(n_goals)), told))
        seconds = []
        for motion in (list(played) * _FIRST_POSTURES)[:_FIRST_POSTURES]:
            predictor.start()
            begin = time.perf_counter()
            predictor.update(motion.q[0], float(motion.t_s[0]))
            seconds.append(time.perf_counter() - begin)
        found.append(Growth("update of reaching, 16 futures for each", "goals", n_goals, Timing.of(seconds)))
    return found


def node_latency(folder: Path) -> Timing:
    """Play a shipped reach in real time to the node, and return when its occupancy came after each posture.

    Both times are the recorder's, which hears postures and occupancies in a third process.

    Args:
        folder: new folder for the run: model, bag and logs.

    Raises:
        HumanPredError: a node that failed.
    """
    human, library = HumanModel.kinect12(), load_library(locate("synthetic_reaches", "bags"))
    played = library.of_class(library.labels[0])[0]
    folder.mkdir(parents=True)
    save_model(train_model(library.select(lambda motion: motion.name != played.name), human), folder / "model.npz")
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        group.start("run_recorder", {"output": str(folder / "bag"), "wait_for": f"{_POSTURES},{_OCCUPANCY}"})
        group.start(
            "occupancy_predictor",
            {"scene": "four_places", "model": str((folder / "model.npz").resolve()), "listener": "run_recorder"},
        )
        tracker = group.start(
            "skeleton_tracker_replay",
            {
                "library": "synthetic_reaches",
                "trajectory": played.name,
                "hold_last_s": 1.0,
                "wait_for": "run_recorder,occupancy_predictor",
                "listener": "occupancy_predictor",
            },
        )
        while tracker.running:
            group.check()
            time.sleep(0.05)
        group.check()
        time.sleep(0.3)  # the last messages reach the recorder after the tracker has ended
    heard: dict[str, dict[tuple[int, int], int]] = {}
    bag = BagReader(folder / "bag")
    for topic in (_POSTURES, _OCCUPANCY):
        messages = ((log_ns, message.header.stamp) for log_ns, message in bag.decoded(topic))
        heard[topic] = {(stamp.sec, stamp.nanosec): log_ns for log_ns, stamp in messages}
    answered = [(log_ns - heard[_POSTURES][stamp]) * 1e-9 for stamp, log_ns in heard[_OCCUPANCY].items()]
    return Timing.of(answered[1:])  # the first message of all waits for caches


def _default(model: TrainedModel, human: HumanModel, grid: VoxelGrid) -> OccupancyPredictor:
    return make_predictor(DEFAULT_PREDICTOR, model, human, grid, np.eye(4), classifier=DEFAULT_CLASSIFIER)


def _timed(subject: OccupancyPredictor | IntentClassifier, played: Sequence[Motion]) -> Timing:
    """Return the timing of `update` over whole motions."""
    for q, t_s in zip(played[0].q[:_WARM_UP], played[0].t_s, strict=False):
        subject.update(q, float(t_s))
    seconds = []
    gc.collect()
    for motion in played:
        subject.start()
        for q, t_s in zip(motion.q, motion.t_s.tolist(), strict=True):
            begin = time.perf_counter()
            subject.update(q, t_s)
            seconds.append(time.perf_counter() - begin)
    return Timing.of(seconds)
