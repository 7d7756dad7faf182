"""How long one posture takes: to be recognised, to become occupancy, and through the node over DDS.

Medians of single calls, taken in one process on one core; what each grows with is measured by changing one thing at a
time. Machines differ and are shared, so ratios within one run say more than the figures.
"""

from __future__ import annotations

import gc
import json
import os
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros import plugins, topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.bench_nodes import (
    RATE_HZ,
    PostureAnswer,
    posture_answers,
    replay,
    write_motion,
    write_scene_for,
)
from humanpred_ros.evaluation.framework import Begin, Column, LibrarySettings, OutputSettings, Report, Table
from humanpred_ros.evaluation.occupancy_scores import P1_RESOLUTION_M, grid_around
from humanpred_ros.evaluation.processes import NodeGroup, ParameterValue, free_domain_id
from humanpred_ros.evaluation.timing import MachineLoad, Spread, growth_plot
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel, human_named, name_of_human
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary, placed, turn_and_shift
from humanpred_ros.occupancy.people import MOST_PEOPLE, PeoplePredictor
from humanpred_ros.occupancy.predictor import Predictor, PredictorRequest, make_predictor
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR
from humanpred_ros.reaching.futures import ReachFuturesSettings
from humanpred_ros.reaching.places import Places, reach_ends
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor, ReachKnowledge
from humanpred_ros.recognition.classifier import Classifier
from humanpred_ros.recognition.training import TrainedModel, save_model, train_model
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import load_scene
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
#: The predictor that is told places, and how many.
TOLD, PLACES = "reaching", 8
_NODE = "occupancy_predictor"
#: Places so close to each other that few can be ruled out before the hand arrives: the most there is to do.
_APART_M = 0.02
#: Where a library shows fewer places than are told, it is told the same ones again, so much higher.
_HIGHER_M = 0.05
#: Length of a run, and of its beginning that does not count: caches, and what is compiled at its first use.
_SECONDS, _SETTLING_S = 12.0, 2.0


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
    growth += [*_with_people(people, model), *_with_places(everybody, begin)]
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
    one, two = (row["us"].median for row in growth if row["what"] == "people" and row["size"] <= 2)
    notes = (f"Two people take {two / one:.2f} times as long as one.", *load.notes())
    return Report(f"{library.name}: one posture", tables, figures, notes, lambda: growth_plot(points, "µs"))


def update_us(
    subject: Predictor | Classifier | _AllPeople, motions: Sequence[Motion], n_frames: int | None = None
) -> list[float]:
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
    moved = [replace(placed(motion, aside), label=f"{motion.label} aside") for motion in library]
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


def _with_people(people: People, model: TrainedModel) -> Iterator[dict[str, Any]]:
    """Up to four people who make the same motions, each with a predictor of their own, and the occupancy of all."""
    predictor = _default(model, people.human, people.grid())
    for n in range(1, MOST_PEOPLE + 1):
        crowd, names = PeoplePredictor(predictor), [f"body_{k}" for k in range(n)]
        yield _row("update and occupancy of all", "people", n, update_us(_AllPeople(crowd, names), people.played))


class _AllPeople:
    """Several people who move alike, timed as one predictor is."""

    def __init__(self, people: PeoplePredictor, names: Sequence[str]) -> None:
        self._people, self._names = people, names
        self.start()

    def start(self) -> None:
        for name in self._names:
            self._people.start(name)

    def update(self, q: FloatArray, t_s: float) -> object:
        self._people.update(dict.fromkeys(self._names, (q, t_s)))
        return self._people.occupancy(self._names, t_s)


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
                Column("on one core", "one_core"),
            ),
            "Delay: from a posture's publication to the receipt of its occupancy by the recorder.",
        )


@dataclass(frozen=True, eq=False)
class People:
    """A library in two parts, and what is learned from the first."""

    human_name: str  #: whose postures these are
    training: MotionLibrary  #: what is learned from
    played: tuple[Motion, ...]  #: what is played

    @classmethod
    def of(cls, library: MotionLibrary, n_played: int) -> People:
        """Play the first motions of the first class; of a library without classes the first ones, at most half.

        Raises:
            HumanModelError: a library of no human there is.
            LibraryFormatError: nothing is left to learn from.
        """
        name = name_of_human(library.dof_names)
        some = library.of_class(library.labels[0]) if library.labels else library.motions[: len(library) // 2]
        played = {motion.name for motion in some[:n_played]}
        training = library.select(lambda motion: motion.name not in played)
        return cls(name, training, some[:n_played])

    @cached_property
    def human(self) -> HumanModel:
        """The human of that name."""
        return human_named(self.human_name)

    @cached_property
    def model(self) -> TrainedModel | None:
        """The trained model; None without classes."""
        return train_model(self.training, self.human) if self.training.labels else None

    @cached_property
    def knowledge(self) -> ReachKnowledge:
        """What `reaching` learned, as the node learns it."""
        if self.model is not None:
            return ReachKnowledge.of_model(self.model, self.human)
        return ReachKnowledge.of_library(self.training, self.human)

    def grid(self, resolution_m: float = P1_RESOLUTION_M) -> VoxelGrid:
        """Return a grid of P1's size around them."""
        return grid_around(self.training, self.human, resolution_m)

    def places(self, count: int) -> Places:
        """Return `count` places in their frame: of the classes, or where each motion ended if there are none."""
        ends = reach_ends(self.training, self.human)
        shown = Places.of_ends(ends).places_m if self.training.labels else np.array([end.place_m for end in ends])
        k = np.arange(count)
        higher = np.outer(k // len(shown), (0.0, 0.0, _HIGHER_M))
        return Places(tuple(map(str, k.tolist())), shown[k % len(shown)] + higher)


def measure_node(people: People, predictor: str, folder: Path) -> dict[str, Any]:
    """Play the first played motion to the node, back and forth, and return the figures.

    Args:
        people: who reach.
        predictor: `reaching` is told `PLACES` places.
        folder: new folder for model, bag and logs.

    Raises:
        UsageError: a node that failed, or published next to nothing.
        HumanPredError: a library that the node cannot use.
    """
    folder.mkdir(parents=True)
    scene = write_scene_for(folder / "scene.yaml", people.training).resolve()
    places = {"places": _entries(people, scene)} if predictor == TOLD else {}
    parameters: dict[str, ParameterValue] = {
        "scene": str(scene),
        "predictor": predictor,
        "human": people.human_name,
        "listener": "run_recorder",
        **places,
    }
    if people.model is not None:
        save_model(people.model, folder / "model.npz")
        parameters["model"] = str((folder / "model.npz").resolve())
    else:
        parameters["library"] = str(write_library_bag(people.training, folder / "library").resolve())
    motion = write_motion(folder / "back_and_forth", people.training, people.played[0], _SECONDS)
    wait_for = f"{topics.human_joint_states('<id>')},{topics.OCCUPANCY}"
    info = json.dumps({"bench": "predictor"})
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        group.start(
            "run_recorder", {"output": str(folder / "bag"), "stay": False, "run_info": info, "wait_for": wait_for}
        )
        node = group.start(_NODE, parameters)
        one_core = hold_to_one_core(node.process.pid)
        usage = replay(group, motion)
    answers = settled(posture_answers(BagReader(folder / "bag")))
    median_hz, slow_hz = rates_hz(answers)
    delay = Spread.of([answer.delay_ms for answer in answers if answer.heard_ns is not None])
    return {
        "human": people.human_name,
        "predictor": predictor,
        "places": PLACES if places else None,
        "sent_hz": RATE_HZ,
        "median_hz": median_hz,
        "slow_hz": slow_hz,
        "delay_ms": delay,
        "postures": len(answers),
        "skipped": len(answers) - delay.n,
        "cpu_percent": next((entry.cpu_percent for entry in usage if entry.node == _NODE), float("nan")),
        "one_core": one_core,
    }


def settled(answers: Sequence[PostureAnswer]) -> Sequence[PostureAnswer]:
    """Return the answers to all postures but those of the beginning."""
    begin_ns = min(answer.stamp_ns for answer in answers) + round(_SETTLING_S * 1e9)
    return [answer for answer in answers if answer.stamp_ns >= begin_ns]


def rates_hz(answers: Sequence[PostureAnswer]) -> tuple[float, float]:
    """Return occupancies a second, from the time between one and the next: median and 1st percentile.

    Raises:
        UsageError: fewer than two occupancies.
    """
    heard_s = np.sort([answer.heard_ns * 1e-9 for answer in answers if answer.heard_ns is not None])
    if len(heard_s) < 2:
        raise UsageError(
            f"bench predictor: wanted occupancies of {len(answers)} postures, got {len(heard_s)}; is the machine busy?"
        )
    median, slow = 1.0 / np.quantile(np.diff(heard_s), (0.5, 0.99))
    return float(median), float(slow)


def hold_to_one_core(pid: int) -> bool:
    """Let a process that has just started, and every thread it is going to start, use the last core of ours only.

    Returns whether this system can do that.
    """
    if not hasattr(os, "sched_setaffinity"):
        return False
    os.sched_setaffinity(pid, {max(os.sched_getaffinity(0))})
    return True


def _entries(people: People, scene: Path) -> list[str]:
    """Return places around where the played motion goes, as the node's parameter wants them."""
    higher = np.outer(np.arange(PLACES), (0.0, 0.0, _APART_M))
    places_m = people.places(1).moved(load_scene(scene).T_world_human).places_m + higher
    return [f"{label} {x!r} {y!r} {z!r}" for label, (x, y, z) in enumerate(places_m.tolist())]
