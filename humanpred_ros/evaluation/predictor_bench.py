"""How long one posture takes: to be recognised, to become occupancy, and through the node over DDS.

Medians of single calls, taken in one process on one core; what each grows with is measured by changing one thing at a
time. Machines differ and are shared, so ratios within one run say more than the figures.
"""

from __future__ import annotations

import gc
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import Begin, Column, LibrarySettings, OutputSettings, Report, Table
from humanpred_ros.evaluation.occupancy_scores import P1_RESOLUTION_M
from humanpred_ros.evaluation.predictor_bench_node import TOLD, People, measure_node
from humanpred_ros.evaluation.timing import MachineLoad, Spread, growth_plot
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, placed, turn_and_shift
from humanpred_ros.occupancy.predictor import Predictor, PredictorRequest, make_predictor
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR
from humanpred_ros.reaching.futures import ReachFuturesSettings
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.classifier import Classifier
from humanpred_ros.recognition.training import TrainedModel, train_model
from humanpred_ros.resources import locate
from humanpred_ros.settings import setting, setting_of

#: Postures fed before anything is timed: caches and the processor's clock settle.
_WARM_UP = 30
#: Lengths of the motions whose last postures are timed, and how many of these.
_FRAMES_SEEN = (100, 1000, 10000)
_LAST_FRAMES = 100
#: Numbers of places that reaching is timed with, and how many first postures.
_PLACES = (1, 2, 4, 8, 16)
_FIRST_POSTURES = 20
_UPDATE = "update of the default"


class PredictorBenchSettings(OutputSettings):
    """Settings of `humanpred bench predictor`."""

    library: str = setting_of(LibrarySettings, "library", default="synthetic_reaches")
    frame_period: float = setting_of(LibrarySettings, "frame_period")
    demos: Path | None = setting(
        None, "P2's recordings, or another library of its 23-DoF human: measure reaching with them, too"
    )
    motions: int = setting(5, "motions played for each figure, and not trained on", low=1)
    node: bool = setting(True, "measure the node over DDS, too")


def measure(settings: PredictorBenchSettings, begin: Begin) -> Report:
    """Measure everything.

    Raises:
        HumanPredError: an unusable library, or a node that failed.
    """
    library = load_library(locate(settings.library, "bags"), frame_period_s=settings.frame_period)
    people = People.of(library, settings.motions)
    everybody = [people]
    if settings.demos is not None:
        demos = load_library(settings.demos)
        HumanModel.mocap23().check_dofs(demos.dof_names)
        everybody.append(People.of(demos, settings.motions))
    load, model = MachineLoad(), people.model
    if model is None:
        raise UsageError(
            f"bench predictor: wanted a library with classes, {library.name} has none; name another, or "
            "give reaches without classes as --demos"
        )
    grid, predictors = people.grid(), plugins.names(plugins.PREDICTORS)
    advance = begin("classifiers and predictors", 2 + len(predictors))
    recognition, update = {}, {}
    for name in ("forest", "gmm"):
        recognition[name] = Spread.of(update_us(model.classifier(name), people.played))
        advance(len(recognition))
    for name in predictors:
        predictor = make_predictor(name, PredictorRequest(people.human, grid, np.eye(4), model))
        update[name] = Spread.of(update_us(predictor, people.played))
        advance(2 + len(update))
    growth = [*_with_classes(people, begin), *_with_voxels(people, model), *_with_frames(people, model, begin)]
    growth += _with_places(everybody, begin)
    figures: dict[str, Any] = {
        "library": {"name": library.name, "n_motions": len(library), "n_classes": len(library.labels)},
        "recognition_us": recognition,
        "update_us": update,
        "growth": growth,
        "nodes": list(_nodes(everybody, begin)) if settings.node else [],
        "other_cores": load.other_cores(),
    }
    points = [(row["what"], row["size"], row["name"], row["us"].median) for row in growth]
    tables = tuple(_tables(figures))
    return Report(f"{library.name}: one posture", tables, figures, load.notes(), lambda: growth_plot(points, "µs"))


def update_us(subject: Predictor | Classifier, motions: Sequence[Motion], n_frames: int | None = None) -> list[float]:
    """Return how long each `update` took, in microseconds, over motions that are each started anew.

    Args:
        subject: what is timed.
        motions: at least one.
        n_frames: only so many first postures of each; None for all.
    """
    for q, t_s in _postures(motions[0], _WARM_UP):
        subject.update(q, t_s)
    durations = []
    gc.collect()
    for motion in motions:
        subject.start()
        for q, t_s in _postures(motion, n_frames):
            begin = time.perf_counter()
            subject.update(q, t_s)
            durations.append(1e6 * (time.perf_counter() - begin))
    return durations


def _postures(motion: Motion, n_frames: int | None) -> Iterable[tuple[FloatArray, float]]:
    return zip(motion.q[:n_frames], motion.t_s[:n_frames].tolist(), strict=True)


def _row(name: str, what: str, size: int, durations_us: Sequence[float]) -> dict[str, Any]:
    """Return the figures with one thing changed, all else the same: `size` of `what`."""
    return {"name": name, "what": what, "size": size, "us": Spread.of(durations_us)}


def _with_classes(people: People, begin: Begin) -> Iterator[dict[str, Any]]:
    """Two classes, four, and so on to twice as many as there are; the new ones are the old, one metre aside."""
    library, human, grid = people.training, people.human, people.grid()
    aside = turn_and_shift(0.0, (1.0, 0.0, 0.0))
    offset = max(library.labels) - min(library.labels) + 1
    moved = [replace(placed(motion, aside), label=(motion.label or 0) + offset) for motion in library]
    doubled = replace(library, motions=(*library.motions, *moved))
    advance, n = begin("classes", len(doubled.labels)), 2
    while n <= len(doubled.labels):
        few = doubled.select(lambda motion, kept=doubled.labels[:n]: motion.label in kept)  # type: ignore[misc]
        model = train_model(few, human, {DEFAULT_CLASSIFIER: None})
        recognised = update_us(model.classifier(DEFAULT_CLASSIFIER), people.played)
        yield _row("recognition of the default", "classes", n, recognised)
        yield _row(_UPDATE, "classes", n, update_us(_default(model, human, grid), people.played))
        advance(n)
        n *= 2


def _with_voxels(people: People, model: TrainedModel) -> Iterator[dict[str, Any]]:
    for resolution_m in (2 * P1_RESOLUTION_M, P1_RESOLUTION_M, P1_RESOLUTION_M / 2):
        grid = people.grid(resolution_m)
        yield _row(_UPDATE, "voxels", grid.size, update_us(_default(model, people.human, grid), people.played))


def _with_frames(people: People, model: TrainedModel, begin: Begin) -> Iterator[dict[str, Any]]:
    """The last postures of ever longer motions: the played ones over and over, never started anew."""
    postures, dof_names = np.vstack([motion.q for motion in people.played]), people.training.dof_names
    advance = begin("frames seen", sum(_FRAMES_SEEN))
    for k, n_frames in enumerate(_FRAMES_SEEN, start=1):
        endless = Motion(np.arange(n_frames) / 60, np.resize(postures, (n_frames, len(dof_names))), dof_names)
        durations = update_us(_default(model, people.human, people.grid()), [endless])[-_LAST_FRAMES:]
        yield _row(_UPDATE, "frames seen", n_frames, durations)
        advance(sum(_FRAMES_SEEN[:k]))


def _with_places(everybody: Sequence[People], begin: Begin) -> Iterator[dict[str, Any]]:
    """Reaching with ever more places, each human beside the other.

    First postures of reaches, when every place is as probable as any other: the most that `reaching` ever does.
    """
    futures, advance = ReachFuturesSettings().n_samples, begin("places", max(_PLACES))
    for count in _PLACES:
        for people in everybody:
            predictor = ReachingPredictor(people.knowledge, people.grid(), np.eye(4), people.places(count).by_label)
            begun = (list(people.played) * _FIRST_POSTURES)[:_FIRST_POSTURES]
            name = f"update of reaching, {people.human_name}, {futures} futures for each"
            yield _row(name, "places", count, update_us(predictor, begun, n_frames=1))
        advance(count)


def _default(model: TrainedModel, human: HumanModel, grid: VoxelGrid) -> Predictor:
    return make_predictor(DEFAULT_PREDICTOR, PredictorRequest(human, grid, np.eye(4), model))


def _nodes(everybody: Sequence[People], begin: Begin) -> Iterator[dict[str, Any]]:
    """Run the node with `reaching` and, where there are classes, with the default predictor beside it."""
    pairs = [
        (people, predictor)
        for people in everybody
        for predictor in ((DEFAULT_PREDICTOR, TOLD) if people.training.labels else (TOLD,))
    ]
    advance = begin("runs of the node", len(pairs))
    with tempfile.TemporaryDirectory() as folder:
        for k, (people, predictor) in enumerate(pairs, start=1):
            yield measure_node(people, predictor, Path(folder) / f"{people.human_name}_{predictor}")
            advance(k)


def _tables(figures: dict[str, Any]) -> Iterator[Table]:
    rows = [(f"recognition, {name}", spread) for name, spread in figures["recognition_us"].items()]
    rows += [(f"whole update, {name}", spread) for name, spread in figures["update_us"].items()]
    rows += [(f"{row['name']}, {row['size']} {row['what']}", row["us"]) for row in figures["growth"]]
    yield Table(
        "Microseconds per posture",
        rows,
        (
            Column("", lambda row: row[0]),
            Column("median", lambda row: row[1].median, ".0f"),
            Column("99 %", lambda row: row[1].p99, ".0f"),
            Column("calls", lambda row: row[1].n),
        ),
    )
    if figures["nodes"]:
        yield Table(
            "The node over DDS, 30 postures a second, on one core where the system can hold it to one",
            figures["nodes"],
            (
                Column("predictor", lambda row: f"{row['predictor']}, {row['human']}"),
                Column("places", lambda row: row["places"]),
                Column("occupancies a second, median", lambda row: row["median_hz"], ".1f", "Hz"),
                Column("1 % below", lambda row: row["slow_hz"], ".1f", "Hz"),
                Column("delay, median", lambda row: row["delay_ms"].median, ".1f", "ms"),
                Column("99 % below", lambda row: row["delay_ms"].p99, ".1f", "ms"),
                Column("postures", lambda row: row["postures"]),
                Column("skipped", lambda row: row["skipped"]),
                Column("processor, % of a core", lambda row: row["cpu_percent"], ".0f"),
                Column("cores", lambda row: row["cores"]),
            ),
            "Delay: from a posture's publication to the receipt of its occupancy by the recorder.",
        )
