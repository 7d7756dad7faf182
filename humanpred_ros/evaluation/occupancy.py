"""How well is the space predicted that a body is going to sweep, for motions that were not learned from?

The truth is the set of voxels that the recorded body touches from the posture seen last to the end of the recording. A
library of reaches ends at the place reached for, one of reaches and returns ends where it began; P1's swept volumes
cover the whole recording, too. With `until` apex every test motion ends where the palm is farthest from its start.

Scores are means over the voxels that any motion of the library sweeps, and two voxels around, the same for all
predictors; predictions elsewhere count as errors in the sum. A ratio of two Brier scores does not depend on that
region, but their size does: the sum over voxels is given beside.

Place-based predictors are scored twice: with the place of the tested motion among the listed places, and without it, as
when somebody reaches for what no scene lists.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import (
    Advance,
    Begin,
    LibrarySettings,
    Report,
    chosen_names,
)
from humanpred_ros.evaluation.leave_one_out import (
    LEARNS_CLASSES,
    LEARNS_FROM_OTHERS,
    LeaveOneOut,
    Needs,
    UpdateLog,
    answers,
    check_needs,
)
from humanpred_ros.evaluation.occupancy_report import Moment, report_of
from humanpred_ros.evaluation.occupancy_scores import (
    LOG_CLIP,
    P1_RESOLUTION_M,
    Played,
    grid_around,
    predictor_figures,
    reliability,
    swept_region,
    voxel_scores,
)
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.recognition_scores import percent_indices
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.cleaning import DROP_REASONS, flag_library
from humanpred_ros.motion.motion import Motion, MotionLibrary, placed, start_pelvis_m, turn_and_shift
from humanpred_ros.occupancy.predictor import Predictor, predictor_type
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.classifier import check_trainable
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.recognition.training import REACHING_LINK
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.settings import setting, setting_of
from humanpred_ros.viewing.reliability import MISSED_BELOW

#: How much of the motion drawn was seen, or the nearest to it of the percents.
PICTURE_PERCENT = 40


class OccupancySettings(LibrarySettings):
    """Settings of `humanpred evaluate occupancy`."""

    predictor: tuple[str, ...] = setting(("all",), "predictors by name; all: those that are installed")
    classifier: str = setting("gmm", "classifier that recognises the class for predictors that need one")
    percents: tuple[int, ...] = setting(
        tuple(range(10, 100, 10)),
        "parts of each motion after which its predictions are scored",
        unit="%",
        low=1,
        high=100,
    )
    until: Literal["end", "apex"] = setting(
        "end", "where a motion ends: with the recording, or at the apex, where the palm is farthest from its start"
    )
    scene: str | None = setting(
        None, "scene that gives lattice and human placement; by default a lattice of P1's size around the library"
    )
    resolution: float = setting(P1_RESOLUTION_M, "edge of that lattice's voxels", unit="m", low=0.001)
    margin_voxels: int = setting(
        2, "voxels by which the region that counts is wider than what the library sweeps", low=0
    )
    by_time: bool = setting(
        False, "score when voxels will be occupied, in slices of 0.2 s, instead of whether they will be"
    )
    shift: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "move the tested people by DX,DY,YAW, in metres and in degrees about the library's start pelvis; what was "
        "learned stays where it was",
    )
    every: int = setting(1, "test only each of so many motions; all are learned from", low=1)
    clean_training: bool = setting(
        False, "learn nothing from motions that are plainly mistracked; they are tested all the same"
    )
    picture: str | None = setting(None, "motion to draw, class/index; by default the middle one")
    components: int = setting_of(GmmSettings, "n_components")
    evidence: Literal["sum", "mean"] = setting_of(GmmSettings, "evidence")

    def check(self) -> None:
        """Raise UsageError for unknown names."""
        _ = self.predictors
        plugins.check_name(plugins.CLASSIFIERS, self.classifier)

    @property
    def predictors(self) -> tuple[str, ...]:
        """Names of the predictors to evaluate."""
        return chosen_names(self.predictor, plugins.names(plugins.PREDICTORS), "predictor")

    @property
    def gmm(self) -> GmmSettings:
        """Settings of P1's mixtures."""
        return GmmSettings(n_components=self.components, evidence=self.evidence, seed=self.seed)


@dataclass(frozen=True, eq=False)
class LeftOutMotions:
    """Shows one motion at a time to predictors that have not learned from it; called with its name.

    Can be sent to other processes; what is learned from all motions is made there, once.
    """

    settings: OccupancySettings  #: how
    library: MotionLibrary  #: of which motions are tested
    learned_from: MotionLibrary  #: the motions that may be learned from
    human: HumanModel  #: whose body occupies
    grid: VoxelGrid  #: the lattice, world frame
    T_world_human: FloatArray  #: (4, 4) from the library's frame to the world
    T_shift: FloatArray  #: (4, 4) moves the people of the test motions, in the library's frame; training motions stay
    region: NDArray[np.bool_]  #: (V,) flat booleans, the voxels over which scores are means
    picture: tuple[str, int]  #: (motion, percent) of which a picture is wanted

    def __call__(self, name: str) -> list[tuple[Played, Played | None, float]]:
        """Run one motion. Raises what training raises.

        Returns:
            For each predictor what it made of the motion; the same without the motion's place on its list, None of
            predictors that are not given places, or if no place would be left; and the seconds it took to train.
        """
        motion = self.library.find(name)
        q, t_s = until_end(placed(motion, self.T_shift), self.human, self.settings.until)
        last_touch = self._voxeliser.last_touch(q).ravel()
        found = []
        for fold in self._folds:
            begun = time.perf_counter()
            predictor = fold.without(name)
            prepare_s = time.perf_counter() - begun
            listed = self._play(predictor, name, q, t_s, last_touch)
            unlisted = None
            if _forget_place(predictor, motion.label):
                unlisted = self._play(predictor, name, q, t_s, last_touch)
            found.append((listed, unlisted, prepare_s))
        return found

    def _play(
        self, predictor: Predictor, name: str, q: FloatArray, t_s: FloatArray, last_touch: NDArray[np.int32]
    ) -> Played:
        """Show a motion to a predictor and score what it said on the way; nothing, until it accepts a posture."""
        percents = self.settings.percents
        seen = percent_indices(len(q))[np.array(percents) - 1].tolist()
        n_shown, log, table, picture = max(seen) + 1, UpdateLog(), np.zeros(1), None
        scores: dict[int, dict[str, float]] = {}
        for k, said in enumerate(answers(predictor, q[:n_shown], t_s[:n_shown], log)):
            if k not in seen:
                continue
            predicted = np.zeros(self.grid.size) if said is None else said.occupancy.probability.ravel()
            # The posture seen last is part of what is still to be swept: the body is there now.
            swept = last_touch >= k
            scores[k] = voxel_scores(predicted, swept, self.region)
            table = table + seen.count(k) * reliability(predicted, swept, self.region)
            if self.picture[0] == name and k == seen[percents.index(self.picture[1])]:
                volumes = np.array([swept, predicted], dtype=np.float32)
                picture = volumes.reshape(2, *self.grid.shape).max(axis=3)
        return Played([scores[k] for k in seen], table, log, picture)

    @cached_property
    def _voxeliser(self) -> BodyVoxeliser:
        return BodyVoxeliser(self.human, self.grid, self.T_world_human)

    @cached_property
    def _folds(self) -> list[LeaveOneOut]:
        s = self.settings
        space = self.human, self.grid, self.T_world_human
        return [
            LeaveOneOut(name, self.learned_from, *space, s.classifier, s.gmm, self.T_shift) for name in s.predictors
        ]


def until_end(motion: Motion, human: HumanModel, until: str) -> tuple[FloatArray, FloatArray]:
    """Return postures (T, D) and stamps (T,) of a motion up to where it is taken to end: `end` or `apex`."""
    n = len(motion)
    if until == "apex":
        palm = human.forward(motion.q)[REACHING_LINK]
        n = int(np.argmax(np.linalg.norm(palm - palm[0], axis=1))) + 1
    return motion.q[:n], motion.t_s[:n]


def _forget_place(predictor: Predictor, label: str | None) -> bool:
    """Take one place away from a predictor that is given places; return whether it had that one and others."""
    if not isinstance(predictor, ReachingPredictor):
        return False
    places = predictor.places
    if label is None or label not in places or len(places) < 2:
        return False
    predictor.set_places({other: place for other, place in places.items() if other != label})
    return True


def evaluate_occupancy(
    library: MotionLibrary, settings: OccupancySettings, progress: Advance | None = None
) -> tuple[dict[str, Any], Moment | None]:
    """Leave out each tested motion in turn and score what the predictors say while it is shown to them.

    Args:
        library: of P1's 12-DoF human or of P2's 23-DoF one.
        settings: how; its library is not read.
        progress: is called with the number of motions done, of `tested_motions`.

    Returns:
        The figures, as in the JSON file, and a moment of one motion to draw. Of each of the `predictors` there are
        `average` (over motions and percents) and `at_percent` (over motions) of the scores of `voxel_scores`,
        `without_mistracked` (the average without test motions that the tracker plainly got wrong; None if there are
        none), `unlisted` and `unlisted_at_percent` (of a predictor that is given places, without the tested motion's),
        `motions` (two scores of each), `calibration` of all predictions, `timing` and `refused_postures`.

    Raises:
        LibraryFormatError: a library that a predictor cannot learn from.
        HumanPredError: other DoFs, people outside the lattice, an unknown scene or motion.
    """
    human = human_with(library.dof_names)
    tested = tested_motions(library, settings.every)
    flags = [flag for flag in flag_library(library, model=human) if flag.reason in DROP_REASONS]
    wrong = {flag.motion for flag in flags}
    mistracked = tuple(name for name in tested if name in wrong)
    learned_from = library.select(lambda m: m.name not in wrong) if settings.clean_training else library
    needs = {name: _needs_of(name) for name in settings.predictors}
    check_needs(learned_from, needs, "--predictor")
    if any(need is not None for need in needs.values()):
        check_trainable(learned_from)
    grid, T_world_human = space_of(library, settings, human, {flag.motion for flag in flags if flag.reason == "wild"})
    dx, dy, turn_deg = settings.shift
    T_shift = turn_and_shift(math.radians(turn_deg), (dx, dy, 0.0), start_pelvis_m(library))
    moved = MotionLibrary(library.name, tuple(placed(motion, T_shift) for motion in library))
    region = swept_region(moved, BodyVoxeliser(human, grid, T_world_human), settings.margin_voxels)
    drawn = _picture(library, tested, mistracked, settings)
    runs = LeftOutMotions(settings, library, learned_from, human, grid, T_world_human, T_shift, region.ravel(), drawn)
    outcomes = map_processes(runs, tested, settings.jobs, progress, settings.scheduler)
    results, above = [], {}
    for k, name in enumerate(settings.predictors):
        found = {motion: outcome[k] for motion, outcome in zip(tested, outcomes, strict=True)}
        results.append(predictor_figures(name, found, mistracked))
        picture = found[drawn[0]][0].picture
        if picture is not None:
            above[name] = picture
    figures = {
        "library": library_facts(library, by_class=True),
        "lattice": grid,
        "T_world_human": T_world_human,
        "T_shift": T_shift,
        "log_clip": LOG_CLIP,
        "missed_below": MISSED_BELOW,
        "picture": drawn[0],
        "percents": settings.percents,
        "tested": tested,
        "mistracked": mistracked,
        "region_voxels": int(region.sum()),
        "predictors": results,
        "unseen_beside_seen": _unseen_beside_seen(results),
    }
    title = f"motion {drawn[0]}, {drawn[1]} % seen, from above:"
    return figures, Moment(title, above, grid) if above else None


def _unseen_beside_seen(results: Sequence[dict[str, Any]]) -> float | None:
    """Return the Brier score of `reaching`, which has not seen the class, over that of `swept_volume`, which has."""
    brier = {result["name"]: result["average"]["brier"] for result in results}
    both = "reaching" in brier and brier.get("swept_volume")
    return brier["reaching"] / brier["swept_volume"] if both else None


def tested_motions(library: MotionLibrary, every: int) -> tuple[str, ...]:
    """Return the names of the motions that are tested: each of `every`, by class and index."""
    ordered = library.by_class
    return tuple(motion.name for motion in ordered[::every])


def _needs_of(predictor: str) -> Needs | None:
    """Return what a library must have for a predictor to be tested on motions left out of it; None of baselines."""
    found = predictor_type(predictor)
    if not found.needs_model:
        return None
    return LEARNS_FROM_OTHERS if found.classifiers == () else LEARNS_CLASSES


def space_of(
    library: MotionLibrary, settings: OccupancySettings, human: HumanModel, wild: Collection[str]
) -> tuple[VoxelGrid, FloatArray]:
    """Return lattice and human placement; motions in `wild` have left the room and do not say where people are."""
    if settings.scene is not None:
        scene = load_scene(settings.scene)
        return scene.grid, scene.T_world_human
    indoors = library.select(lambda motion: motion.name not in wild)
    return grid_around(indoors, human, settings.resolution), np.eye(4)


def _picture(
    library: MotionLibrary, tested: Sequence[str], mistracked: Sequence[str], settings: OccupancySettings
) -> tuple[str, int]:
    """Return the tested motion and the percent to draw; raises UsageError for a motion that is not tested."""
    percent = min(settings.percents, key=lambda p: abs(p - PICTURE_PERCENT))
    if settings.picture is None:
        good = [name for name in tested if name not in mistracked] or list(tested)
        return good[len(good) // 2], percent
    name = library.find(settings.picture).name
    if name not in tested:
        raise UsageError(f"picture: wanted one of the tested motions {', '.join(tested)}, got {name}")
    return name, percent


def measure(settings: OccupancySettings, begin: Begin) -> Report:
    """Evaluate the predictors on the library.

    Raises:
        HumanPredError: an unusable library, scene or motion, or what a predictor cannot learn.
    """
    library = settings.read_library()
    advance = begin("motions", len(tested_motions(library, settings.every)))
    if settings.by_time:
        from humanpred_ros.evaluation.occupancy_in_time import evaluate_in_time

        return evaluate_in_time(library, settings, advance)
    return report_of(*evaluate_occupancy(library, settings, advance))
