"""How well is the space predicted that a body is going to sweep, for motions that were not learned from?

What is true: the voxels that the recorded body touches at any time from the posture seen last to the end of the
recording. A library of reaches ends at the goal, one of reaches and returns ends where it began; P1's swept volumes
cover the whole recording, too. `until="apex"` ends every test motion where the palm is farthest from its start.

Where scores are taken: the voxels that any motion of the library sweeps, and two voxels around, the same for all
predictors; what somebody predicts elsewhere counts, too, as an error in the sum. So a ratio of two Brier scores does
not depend on the region, while their size does: the sum over voxels is given beside.

Who is told places is shown every motion twice: told its place among the others, and told only the others, as when
somebody beside a robot reaches for what no scene lists.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.evaluation_grid import grid_around, swept_region
from humanpred_ros.evaluation.needs import LEARNS_CLASSES, LEARNS_FROM_OTHERS, Needs, check_needs
from humanpred_ros.evaluation.occupancy.result import OccupancyEvaluation, PredictorResult
from humanpred_ros.evaluation.occupancy.runs import ENDS, LeftOutMotions, OccupancySetup
from humanpred_ros.evaluation.occupancy.scores import LOG_CLIP, MISSED_BELOW
from humanpred_ros.evaluation.outputs import library_facts, machine_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.cleaning import DROP_REASONS, flag_library
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.motion.placement import placed, start_pelvis_m, turn_and_shift
from humanpred_ros.occupancy.predictor import predictor_type
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.classifier import check_trainable
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.robot.scene import load_scene

#: How much of the motion drawn was seen, if that is one of the percents.
PICTURE_PERCENT = 40


@dataclass(frozen=True)
class OccupancyEvaluationConfig:
    """How to evaluate predictors of occupancy.

    Attributes:
        predictors: their names, side by side.
        classifier: recognises the class for those that need it.
        gmm: settings of P1's mixtures.
        percents: shares of a motion after which its predictions are scored.
        until: "end" of the recording, or "apex", where the palm is farthest from its start.
        scene: takes grid and human placement from this scene; None puts a grid of P1's size around the library.
        resolution_m: of that grid.
        margin_voxels: how far the region that counts is wider than what the library sweeps.
        every: test only every so manieth motion of the sorted library; training motions are all the others.
        shift_m, turn_rad: move the tested people, and what they really sweep, by (dx, dy) and a turn about the
            vertical through the library's median start pelvis. What was learned stays where it was.
        clean_training: learn nothing from motions that are plainly mistracked or mislabelled; they are tested all
            the same.
        picture: motion to draw; None takes the middle one of those tested that are well tracked.

    Raises:
        UsageError: names or numbers that cannot be.
    """

    predictors: tuple[str, ...] = ("current", "constant_velocity", "swept_volume")
    classifier: str = "gmm"
    gmm: GmmSettings = field(default_factory=GmmSettings)
    percents: tuple[int, ...] = tuple(range(10, 100, 10))
    until: str = "end"
    scene: str | None = None
    resolution_m: float = 0.05
    margin_voxels: int = 2
    every: int = 1
    shift_m: tuple[float, float] = (0.0, 0.0)
    turn_rad: float = 0.0
    clean_training: bool = False
    picture: str | None = None

    def __post_init__(self) -> None:
        for name in self.predictors or ("",):
            plugins.check_name(plugins.PREDICTORS, name)
        plugins.check_name(plugins.CLASSIFIERS, self.classifier)
        if self.until not in ENDS:
            raise UsageError(f"until: wanted {' or '.join(ENDS)}, got {self.until!r}")
        if not self.percents or not all(1 <= percent <= 100 for percent in self.percents):
            raise UsageError(f"percents: wanted whole numbers from 1 to 100, got {self.percents}")
        if self.every < 1 or self.margin_voxels < 0:
            raise UsageError(
                f"evaluation: wanted every >= 1 and margin_voxels >= 0, got {self.every} and {self.margin_voxels}"
            )
        if not np.isfinite([*self.shift_m, self.turn_rad]).all():
            raise UsageError(f"shift: wanted finite numbers, got {self.shift_m} m and {self.turn_rad} rad")


def evaluate_occupancy(
    library: MotionLibrary,
    config: OccupancyEvaluationConfig | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> OccupancyEvaluation:
    """Leave out each tested motion in turn and score what the predictors say while it is shown to them.

    Same library, settings and seed give the same figures, times apart, for any number of processes.

    Args:
        library: of P1's 12-DoF human or of P2's 23-DoF one.
        config: how.
        jobs: number of processes.
        progress: called with the number of motions done, of `tested_motions`.

    Raises:
        LibraryFormatError: a library that a predictor cannot learn from.
        HumanPredError: other DoFs, people outside the grid, an unknown scene, classifier or motion.
    """
    config = OccupancyEvaluationConfig() if config is None else config
    human = human_with(library.dof_names)
    tested = tested_motions(library, config)
    flags = [flag for flag in flag_library(library, model=human) if flag.reason in DROP_REASONS]
    wrong = frozenset(flag.motion for flag in flags)
    mistracked = tuple(name for name in tested if name in wrong)
    taught = library.select(lambda m: m.name not in wrong) if config.clean_training else library
    _check_leave_one_out(taught, config.predictors)
    grid, T_world_human = _space(library, config, human, {flag.motion for flag in flags if flag.reason == "wild"})
    T_shift = turn_and_shift(config.turn_rad, (*config.shift_m, 0.0), start_pelvis_m(library))
    moved = MotionLibrary(library.name, tuple(placed(motion, T_shift) for motion in library))
    region = swept_region(moved, BodyVoxeliser(human, grid, T_world_human), config.margin_voxels)
    picture = _picture(library, tested, mistracked, config)
    setup = OccupancySetup(
        human,
        grid,
        T_world_human,
        region.ravel(),
        config.percents,
        config.until,
        T_shift,
        config.classifier,
        config.gmm,
        wrong if config.clean_training else frozenset(),
        picture,
    )
    outcomes = map_processes(LeftOutMotions(config.predictors, library, setup), tested, jobs, progress)
    settings = dataclasses.asdict(config) | {
        "jobs": jobs,
        "seed": config.gmm.seed,
        "grid": grid,
        "T_world_human": T_world_human,
        "T_shift": T_shift,
        "log_clip": LOG_CLIP,
        "missed_below": MISSED_BELOW,
        "picture": picture[0],
    }
    facts = library_facts(library, by_class=True)
    results = tuple(
        PredictorResult.of(
            name, plugins.describe(plugins.PREDICTORS, name), [motion[k] for motion in outcomes], frozenset(mistracked)
        )
        for k, name in enumerate(config.predictors)
    )
    return OccupancyEvaluation(
        facts, settings, machine_facts(), config.percents, tested, mistracked, int(region.sum()), results
    )


def tested_motions(library: MotionLibrary, config: OccupancyEvaluationConfig) -> tuple[str, ...]:
    """Return the names of the motions that are tested: every so manieth, by class and index."""
    ordered = sorted(library, key=lambda motion: (-1 if motion.label is None else motion.label, motion.index))
    return tuple(motion.name for motion in ordered[:: config.every])


def _check_leave_one_out(library: MotionLibrary, predictors: Sequence[str]) -> None:
    """Raise LibraryFormatError unless each of the predictors can learn without any one motion."""
    needs = {name: _needs_of(name) for name in predictors}
    check_needs(library, needs, "--predictor")
    if any(need is not None for need in needs.values()):
        check_trainable(library)


def _needs_of(predictor: str) -> Needs | None:
    """Return what a library must have for a predictor to be tested on motions left out of it; None of baselines."""
    found = predictor_type(predictor)
    if not found.needs_model:
        return None
    return LEARNS_FROM_OTHERS if found.classifiers == () else LEARNS_CLASSES


def _space(
    library: MotionLibrary, config: OccupancyEvaluationConfig, human: HumanModel, wild: Collection[str]
) -> tuple[VoxelGrid, FloatArray]:
    """Return grid and human placement; motions in `wild` have left the room and say nothing about where people are."""
    if config.scene is not None:
        scene = load_scene(config.scene)
        return scene.grid, scene.T_world_human
    indoors = library.select(lambda motion: motion.name not in wild)
    return grid_around(indoors, human, config.resolution_m), np.eye(4)


def _picture(
    library: MotionLibrary, tested: Sequence[str], mistracked: Sequence[str], config: OccupancyEvaluationConfig
) -> tuple[str, int]:
    """Return the tested motion and the percent to draw; raises UsageError for a motion that is not tested."""
    percent = min(config.percents, key=lambda p: abs(p - PICTURE_PERCENT))
    if config.picture is None:
        good = [name for name in tested if name not in mistracked] or list(tested)
        return good[len(good) // 2], percent
    name = library.find(config.picture).name
    if name not in tested:
        raise UsageError(f"picture: wanted one of the tested motions {', '.join(tested)}, got {name}")
    return name, percent
