"""Scenes, person and predictors of evaluations that plan: made where they are used, once in every process."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from humanpred_ros.evaluation.interference.occupancies import PredictedOccupancies
from humanpred_ros.evaluation.leave_one_out import FoldSettings, LeaveOneOut, leave_one_out
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.occupancy.predictor import DEFAULT_PREDICTOR, predictor_type
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.recognition.classifier import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.robot.scene import Scene, load_scene


@dataclass(frozen=True)
class RunSettings:
    """How all runs are made.

    Attributes:
        replanner: of the arm; period and seed are set for each run. One thread: processes fill the cores.
        steps: replanning steps per human motion (P1: 20, so 5 % each).
        threshold: voxels at or below this probability do not reach the planner.
        hold_s: how long the human stays at the end, for the arm to arrive; who has not by then never does.
        gmm: settings of P1's mixtures.
        hold_out: so many motions of every class are held out together: P1 learns nothing from the first 5 of each.
            The same goes for those that follow: who is shown motion 7 has learned from all but 5 to 9.
    """

    replanner: ReplannerConfig = field(default_factory=lambda: ReplannerConfig(threads=1))
    steps: int = 20
    threshold: float = 0.001
    hold_s: float = 4.0
    gmm: GmmSettings = field(default_factory=GmmSettings)
    hold_out: int = 5

    def replanner_config(self, motion: Motion, seed: int) -> ReplannerConfig:
        """Return the replanner's settings beside one motion."""
        return self.replanner.replaced(period_s=motion.duration_s / self.steps, seed=seed)

    def held_postures(self, motion: Motion) -> int:
        """Return how often the motion's last posture is repeated."""
        return math.ceil(self.hold_s / motion.period_s)


class World:
    """A library, and what is made from it on demand; can be sent to another process."""

    def __init__(self, library: MotionLibrary, settings: RunSettings) -> None:
        # A library's provenance cannot be pickled, and nobody learns from it.
        self._name, self._motions, self.settings = library.name, library.motions, settings

    def scene(self, name: str) -> Scene:
        """Return a scene of the package, or of a YAML file."""
        if name not in self._scenes:
            self._scenes[name] = load_scene(name)
        return self._scenes[name]

    def told(self, predictor: str, scene: Scene, motion: Motion, n_held: int) -> PredictedOccupancies:
        """Return what a predictor says of a motion that it has not learned from.

        `forecast` goes with the default classifier, `swept_volume` with P1's.
        """
        fold = self._fold(predictor, scene, group_of(self.library, motion, self.settings.hold_out))
        return PredictedOccupancies(fold.without(motion.name), motion, self.settings.threshold, n_held)

    def swept(self, scene: Scene, motion: Motion) -> Occupancy:
        """Return the voxels that the body really sweeps in a motion, stamped with its end."""
        mask = BodyVoxeliser(self.human, scene.grid, scene.T_world_human).mask(motion.q)
        return Occupancy(scene.grid, mask.astype(np.float32), motion.duration_s)

    @cached_property
    def library(self) -> MotionLibrary:
        """All motions."""
        return MotionLibrary(self._name, self._motions)

    @cached_property
    def human(self) -> HumanModel:
        """P1's 12-DoF human."""
        return HumanModel.kinect12()

    @cached_property
    def _scenes(self) -> dict[str, Scene]:
        return {}

    @cached_property
    def _folds(self) -> dict[tuple[str, int, object, bytes], LeaveOneOut]:
        return {}

    def _fold(self, predictor: str, scene: Scene, group: int) -> LeaveOneOut:
        """Return what makes a predictor for a scene; scenes of one grid and placement share what was learned."""
        key = (
            predictor,
            group if predictor_type(predictor).needs_model else 0,
            scene.grid,
            scene.T_world_human.tobytes(),
        )
        if key not in self._folds:
            self._folds[key] = leave_one_out(
                predictor,
                FoldSettings(
                    training_library(self.library, self.settings.hold_out, group),
                    self.human,
                    scene.grid,
                    scene.T_world_human,
                    classifier=DEFAULT_CLASSIFIER if predictor == DEFAULT_PREDICTOR else "gmm",
                    gmm=self.settings.gmm,
                ),
            )
        return self._folds[key]


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


def first_of_classes(library: MotionLibrary, count: int) -> Iterator[str]:
    """Yield the names of the first `count` motions of every class."""
    return itertools.chain.from_iterable(
        (motion.name for motion in library.of_class(label)[:count]) for label in library.labels
    )


def running_numbers(library: MotionLibrary) -> dict[str, int]:
    """Return the running number of each motion over the sorted classes, by name: the papers' global id."""
    ordered = sorted(library, key=lambda motion: (-1 if motion.label is None else motion.label, motion.index))
    return {motion.name: number for number, motion in enumerate(ordered)}
