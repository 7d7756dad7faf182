"""The arm beside recorded people, simulated in one process and in the data's clock, without ROS.

The person makes a recorded motion and does not react; every posture is given to a predictor, and the replanner answers
every occupancy. A stepped run over DDS gives the same decisions as `drive` with `predicted` occupancies, bit for bit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import LibrarySettings
from humanpred_ros.evaluation.leave_one_out import LeaveOneOut
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.csv_files import read_records
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.occupancy.predictor import Predictor, predictor_type
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.planning.decision import ARRIVED, Decision
from humanpred_ros.planning.pace import Pace
from humanpred_ros.planning.protective_distance import ProtectiveDistance, SeenBody, SpeedFactor
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR
from humanpred_ros.recognition.classifier import check_trainable
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.settings import setting


def predicted(predictor: Predictor, motion: Motion, threshold: float, n_held: int = 0) -> Iterator[Occupancy]:
    """Yield the occupancy that reaches the planner after each posture.

    Args:
        predictor: told to start anew.
        motion: DoFs in the predictor's order.
        threshold: voxels at or below this probability do not reach the planner, as over DDS.
        n_held: how often the last posture is repeated at the end, at the motion's median period.
    """
    offsets_ns, postures = motion.timeline(n_held)
    predictor.start()
    for offset_ns, q in zip(offsets_ns, postures, strict=True):
        yield predictor.update(q, offset_ns * 1e-9).occupancy.sparse(threshold)


#: So long the person has been in the first posture when a run begins, s: the guard has made up its mind.
_GUARDED_BEFORE_S = 4.0
_GUARD_STOP = "separation guard: the person is too close"


def drive(
    replanner: Replanner,
    q_start: ArrayLike,
    occupancies: Iterable[Occupancy],
    n_least: int = 0,
    begin_s: float = 0.0,
) -> list[Decision]:
    """Let the arm work while occupancies come in; return one decision for each.

    Args:
        replanner: told to start anew.
        q_start: (D,) where the arm rests at first.
        occupancies: by ascending stamp.
        n_least: so many are answered even if the arm arrives before; after that, arriving ends the run.
        begin_s: since when the arm rests; the first step is due one period later.
    """
    replanner.start(q_start, begin_s)
    decisions: list[Decision] = []
    for occupancy in occupancies:
        decision = replanner.respond(occupancy)
        decisions.append(decision)
        if decision.action == ARRIVED and len(decisions) >= n_least:
            break
    return decisions


def drive_guarded(
    replanner: Replanner, scene: Scene, human: HumanModel, motion: Motion, occupancies: Iterable[Occupancy], n_held: int
) -> tuple[list[Decision], Pace]:
    """Let the arm work as `simulation.drive` does, while a guard with default settings looks at every posture.

    A factor counts from the posture on that it follows from. After a stop the arm is planned for again, from where it
    stands, as soon as it may move.

    Args:
        replanner: told to start anew.
        scene, human, motion: who and where.
        occupancies: one for each posture.
        n_held: how often the last posture is repeated at the end.

    Returns:
        The decisions, stops of the guard's among them, and the pace of the controller's time.
    """
    protective = ProtectiveDistance(human, scene.arm, scene.T_world_human)
    body, speed = SeenBody(), SpeedFactor(protective.settings)

    def wanted(q_person: np.ndarray, t_s: float, q: np.ndarray, v: np.ndarray) -> float:
        body.see(q_person, t_s)
        return speed.follow(protective.separation([body], q, v, speed.factor).factor, t_s)

    postures, rest = motion.timeline(n_held)[1], np.zeros(len(scene.start))
    for t_s in np.arange(-_GUARDED_BEFORE_S, 0.0, motion.period_s):
        wanted(postures[0], float(t_s), scene.start, rest)
    replanner.set_factor(1.0, 0.0)
    replanner.start(scene.start, 0.0)
    decisions: list[Decision] = []
    changes = list(replanner.pace.changes)
    for k, (occupancy, q_person) in enumerate(zip(occupancies, postures, strict=False)):
        t_s = occupancy.t_s
        q, v, _ = replanner.state_at(t_s)
        factor = wanted(q_person, t_s, q, v)
        stop = replanner.set_factor(factor, t_s, "" if factor else _GUARD_STOP)
        if replanner.pace.changes[-1] != changes[-1]:
            changes.append(replanner.pace.changes[-1])
        if stop is not None:
            decisions.append(stop)
        elif factor and replanner.lost:
            replanner.regain(q, t_s)
        decisions.append(replanner.respond(occupancy))
        if decisions[-1].action == ARRIVED and k + 1 >= len(motion):
            break
    replanner.set_factor(1.0, t_s)  # for whoever has it next
    return decisions, Pace(tuple(changes))


class PredictedOccupancies:
    """The occupancies that follow from a motion, posture by posture, then from its last posture, held.

    Predictions do not depend on what the arm does, so runs with different seeds or methods share them. They are made
    as far as somebody reads, and kept as the few voxels that are not zero.
    """

    def __init__(self, predictor: Predictor, motion: Motion, threshold: float, n_held: int) -> None:
        """Take a predictor that nobody else uses meanwhile; other arguments as for `predicted`."""
        self._grid: VoxelGrid = predictor.grid
        self._source = predicted(predictor, motion, threshold, n_held)
        self._made: list[tuple[float, NDArray[np.int64], NDArray[np.float32]]] = []

    def since(self, posture: int) -> Iterator[Occupancy]:
        """Yield the occupancies from that of one posture on, counted from 0."""
        while self._make(posture):
            yield self.after(posture)
            posture += 1

    def after(self, posture: int) -> Occupancy:
        """Return the occupancy that follows from the postures up to one.

        Raises:
            IndexError: the person makes no such posture.
        """
        if not self._make(posture):
            raise IndexError(f"wanted one of {len(self._made)} postures, got {posture}")
        t_s, flat, values = self._made[posture]
        probability = np.zeros(self._grid.size, dtype=np.float32)
        probability[flat] = values
        return Occupancy(self._grid, probability.reshape(self._grid.shape), t_s)

    def _make(self, posture: int) -> bool:
        for occupancy in itertools.islice(self._source, max(0, posture + 1 - len(self._made))):
            flat = occupancy.voxels_above(0.0)
            self._made.append((occupancy.t_s, flat, occupancy.probability.ravel()[flat]))
        return posture < len(self._made)


def nobody(grid: VoxelGrid, motion: Motion, n_held: int) -> Iterator[Occupancy]:
    """Yield occupancies of the same stamps without anybody in them: what a planner sees that knows of no human."""
    nothing = np.zeros(grid.shape, dtype=np.float32)
    for offset_ns in motion.timeline(n_held)[0]:
        yield Occupancy(grid, nothing, offset_ns * 1e-9)


#: What the arm goes by: the predictor that it is told by (None: nobody), and what that is.
METHODS: Mapping[str, tuple[str | None, str]] = MappingProxyType(
    {
        "ours": ("forecast", "the default predictor, forecast, with the classifier forest"),
        "ours_p1": ("swept_volume", "P1's predictor, swept_volume, with the classifier gmm"),
        "current": ("current", "current occupancy only: the body where it is now"),
        "wait": ("current", "rests until the human's motion is over, then goes by the last posture"),
        "basic": (None, "smoothness and obstacles only: knows of no human"),
        "guard": (None, "basic, slowed and stopped by a separation guard that sees every posture"),
        "ours_guard": ("forecast", "ours, slowed and stopped by the same guard"),
    }
)


@dataclass(frozen=True)
class RunSettings:
    """How all runs are made."""

    #: of the arm; period and seed are set for each run. One thread: processes fill the cores.
    replanner: ReplannerConfig = field(default_factory=lambda: ReplannerConfig(threads=1))
    steps: int = 20  #: replanning steps per human motion (P1: 20, so 5 % each)
    threshold: float = 0.001  #: voxels at or below this probability do not reach the planner
    hold_s: float = 4.0  #: how long the human stays at the end, for the arm to arrive; a later arrival does not count
    gmm: GmmSettings = field(default_factory=GmmSettings)  #: settings of P1's mixtures
    #: so many motions of every class are held out together: P1 learns nothing from the first 5 of each. The same goes
    #: for those that follow: beside motion 7, all but motions 5 to 9 were learned from.
    hold_out: int = 5

    def replanner_config(self, motion: Motion, seed: int) -> ReplannerConfig:
        """Return the replanner's settings beside one motion."""
        return self.replanner.replaced(period_s=motion.duration_s / self.steps, seed=seed)


class SimulationSettings(LibrarySettings):
    """Settings of an evaluation of the arm beside recorded people."""

    hold_out: int = setting(5, "motions of every class that are held out together; the first 5 in P1", low=0)
    components: int = setting(GmmSettings().n_components, "gmm: Gaussians per class", low=1)

    def material(self, how: RunSettings | None) -> tuple[MotionLibrary, RunSettings]:
        """Return the library, and how runs are made: `how`, or as the settings say.

        Raises:
            LibraryFormatError: a library that nothing can be learned from.
            HumanModelError: a library of other DoFs.
        """
        library = self.read_library()
        gmm = GmmSettings(n_components=self.components, seed=self.seed)
        how = how or RunSettings(gmm=gmm, hold_out=self.hold_out)
        HumanModel.kinect12().check_dofs(library.dof_names)
        check_trainable(training_library(library, how.hold_out))
        return library, how


class World:
    """A library, and what is made from it on demand; can be sent to another process before it is used."""

    def __init__(self, library: MotionLibrary, settings: RunSettings) -> None:
        self.library, self.settings, self.human = library, settings, HumanModel.kinect12()
        self._scenes: dict[str, Scene] = {}
        self._folds: dict[tuple[str, int, object, bytes], LeaveOneOut] = {}

    def scene(self, name: str) -> Scene:
        """Return a scene of the package, or of a YAML file."""
        if name not in self._scenes:
            self._scenes[name] = load_scene(name)
        return self._scenes[name]

    def predictions(self, predictor: str, scene: Scene, motion: Motion, n_held: int) -> PredictedOccupancies:
        """Return what a predictor says of a motion that it has not learned from.

        `forecast` goes with the default classifier, `swept_volume` with P1's. Scenes of one grid and placement share
        what was learned.
        """
        group = group_of(self.library, motion, self.settings.hold_out)
        if not predictor_type(predictor).needs_model:
            group = 0
        key = (predictor, group, scene.grid, scene.T_world_human.tobytes())
        if key not in self._folds:
            self._folds[key] = LeaveOneOut(
                predictor,
                training_library(self.library, self.settings.hold_out, group),
                self.human,
                scene.grid,
                scene.T_world_human,
                classifier=DEFAULT_CLASSIFIER if predictor == DEFAULT_PREDICTOR else "gmm",
                gmm=self.settings.gmm,
            )
        return PredictedOccupancies(self._folds[key].without(motion.name), motion, self.settings.threshold, n_held)

    def swept(self, scene: Scene, motion: Motion) -> Occupancy:
        """Return the voxels that the body really sweeps in a motion, stamped with its end."""
        mask = BodyVoxeliser(self.human, scene.grid, scene.T_world_human).mask(motion.q)
        return Occupancy(scene.grid, mask.astype(np.float32), motion.duration_s)


def read_published(path: Path, **columns: Callable[[str], Any]) -> list[tuple[Any, ...]]:
    """Return the rows of a published table as tuples of these columns; empty if there is no such file.

    Raises:
        UsageError: a file without these columns, or with values that they cannot have.
        LibraryFormatError: a file that cannot be read, or is empty.
    """
    if not path.is_file():
        return []
    try:
        return [tuple(kind(row[name]) for name, kind in columns.items()) for row in read_records(path)]
    except (KeyError, ValueError) as trouble:
        raise UsageError(
            f"{path}: wanted a CSV file with the columns {', '.join(columns)}, got {type(trouble).__name__}: {trouble};"
            " correct or remove it"
        ) from trouble


def training_library(library: MotionLibrary, hold_out: int, group: int = 0) -> MotionLibrary:
    """Return the library without a group of motions of every class: group 0 is the first `hold_out` of each.

    Raises:
        LibraryFormatError: nothing is left.
    """
    held = slice(group * hold_out, (group + 1) * hold_out)
    out = {motion.name for label in library.labels for motion in library.of_class(label)[held]}
    return library.select(lambda motion: motion.name not in out)


def group_of(library: MotionLibrary, motion: Motion, hold_out: int) -> int:
    """Return the group of motions that a motion is held out with; 0 if none are (it is then left out alone)."""
    if not hold_out or motion.label is None:
        return 0
    names = [other.name for other in library.of_class(motion.label)]
    return names.index(motion.name) // hold_out


def first_of_classes(library: MotionLibrary, count: int) -> list[str]:
    """Return the names of the first `count` motions of every class."""
    return [motion.name for label in library.labels for motion in library.of_class(label)[:count]]


def held_postures(motion: Motion, hold_s: float) -> int:
    """Return how often a motion's last posture is repeated to be held for `hold_s`."""
    return math.ceil(hold_s / motion.period_s)
