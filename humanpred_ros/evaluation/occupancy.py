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
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from rich.console import Console

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import (
    Advance,
    Begin,
    Column,
    LibrarySettings,
    Report,
    Table,
    chosen_names,
    present,
)
from humanpred_ros.evaluation.leave_one_out import (
    LEARNS_CLASSES,
    LEARNS_FROM_OTHERS,
    Needs,
    check_needs,
    learned_from_class,
)
from humanpred_ros.evaluation.occupancy_runs import (
    P1_RESOLUTION_M,
    LeftOutMotions,
    OccupancySetup,
    grid_around,
    swept_region,
)
from humanpred_ros.evaluation.occupancy_scores import LOG_CLIP, MISSED_BELOW, PredictorResult, VoxelFigures
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.plots import Moment, occupancy_plot
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.cleaning import DROP_REASONS, flag_library
from humanpred_ros.motion.motion import MotionLibrary, placed, start_pelvis_m, turn_and_shift
from humanpred_ros.occupancy.predictor import predictor_type
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.classifier import check_trainable
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.settings import setting, setting_of

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
class OccupancyEvaluation:
    """What was found on one library.

    Attributes:
        library: facts about it.
        setup: how predictions were made and scored.
        percents: of a motion after which predictions were scored.
        tested, mistracked: names of the motions tested, and of those among them that are plainly mistracked.
        predictors: side by side.
    """

    library: Mapping[str, Any]
    setup: OccupancySetup
    percents: tuple[int, ...]
    tested: tuple[str, ...]
    mistracked: tuple[str, ...]
    predictors: tuple[PredictorResult, ...]

    @property
    def region_voxels(self) -> int:
        """Size of the region over which scores are means."""
        return int(self.setup.region.sum())

    @property
    def unseen_beside_seen(self) -> float | None:
        """Brier score of `reaching`, which has not seen the class, over that of `swept_volume`, which has learned it.

        None unless both are there.
        """
        brier = {result.name: float(result.average.brier) for result in self.predictors}
        unseen, seen = brier.get("reaching"), brier.get("swept_volume")
        return unseen / seen if unseen is not None and seen else None

    def figures(self) -> dict[str, Any]:
        """Return everything but the pictures, for the JSON file."""
        return {
            "library": self.library,
            "lattice": self.setup.grid,
            "T_world_human": self.setup.T_world_human,
            "T_shift": self.setup.T_shift,
            "log_clip": LOG_CLIP,
            "missed_below": MISSED_BELOW,
            "picture": self.setup.picture[0],
            "percents": self.percents,
            "tested": self.tested,
            "mistracked": self.mistracked,
            "region_voxels": self.region_voxels,
            "predictors": [result.figures() for result in self.predictors],
            "unseen_beside_seen": self.unseen_beside_seen,
        }


def evaluate_occupancy(
    library: MotionLibrary, settings: OccupancySettings, progress: Advance | None = None
) -> OccupancyEvaluation:
    """Leave out each tested motion in turn and score what the predictors say while it is shown to them.

    Args:
        library: of P1's 12-DoF human or of P2's 23-DoF one.
        settings: how; its library is not read.
        progress: is called with the number of motions done, of `tested_motions`.

    Raises:
        LibraryFormatError: a library that a predictor cannot learn from.
        HumanPredError: other DoFs, people outside the lattice, an unknown scene or motion.
    """
    human = human_with(library.dof_names)
    tested = tested_motions(library, settings.every)
    flags = [flag for flag in flag_library(library, model=human) if flag.reason in DROP_REASONS]
    wrong = frozenset(flag.motion for flag in flags)
    mistracked = tuple(name for name in tested if name in wrong)
    learned_from = library.select(lambda m: m.name not in wrong) if settings.clean_training else library
    _check_leave_one_out(learned_from, settings.predictors)
    grid, T_world_human = _space(library, settings, human, {flag.motion for flag in flags if flag.reason == "wild"})
    dx, dy, turn_deg = settings.shift
    T_shift = turn_and_shift(math.radians(turn_deg), (dx, dy, 0.0), start_pelvis_m(library))
    moved = MotionLibrary(library.name, tuple(placed(motion, T_shift) for motion in library))
    region = swept_region(moved, BodyVoxeliser(human, grid, T_world_human), settings.margin_voxels)
    setup = OccupancySetup(
        human,
        grid,
        T_world_human,
        region.ravel(),
        settings.percents,
        settings.until,
        T_shift,
        settings.classifier,
        settings.gmm,
        wrong if settings.clean_training else frozenset(),
        _picture(library, tested, mistracked, settings),
    )
    runs = LeftOutMotions(settings.predictors, library, setup)
    outcomes = map_processes(runs, tested, settings.jobs, progress, settings.scheduler)
    results = tuple(
        PredictorResult.of(
            name,
            plugins.describe(plugins.PREDICTORS, name),
            learned_from_class(name),
            [motion[k] for motion in outcomes],
            frozenset(mistracked),
        )
        for k, name in enumerate(settings.predictors)
    )
    return OccupancyEvaluation(
        library_facts(library, by_class=True), setup, settings.percents, tested, mistracked, results
    )


def tested_motions(library: MotionLibrary, every: int) -> tuple[str, ...]:
    """Return the names of the motions that are tested: each of `every`, by class and index."""
    ordered = sorted(library, key=lambda motion: (-1 if motion.label is None else motion.label, motion.index))
    return tuple(motion.name for motion in ordered[::every])


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
    return report_of(evaluate_occupancy(library, settings, advance))


def run(settings: OccupancySettings, console: Console) -> int:
    """Evaluate, print, write; return the exit status."""
    return present(settings, console, measure)


def report_of(evaluation: OccupancyEvaluation) -> Report:
    """Return averages of every predictor, and errors along the motion."""
    setup, results = evaluation.setup, evaluation.predictors
    picture = results[0].picture
    moment = None
    if picture is not None:
        title = f"motion {setup.picture[0]}, {picture.percent} % seen, from above:"
        moment = Moment(title, picture.swept, setup.grid.origin_m, setup.grid.resolution_m)
    return Report(
        f"{evaluation.library['name']}: {len(evaluation.tested)} of {evaluation.library['n_motions']} motions left out "
        f"in turn; averages over {len(evaluation.percents)} parts seen, means over {evaluation.region_voxels} voxels",
        (
            Table("", results, tuple(_columns()), _note(evaluation)),
            _by_percent(evaluation, "Brier score x 1000 by % seen", ".2f", lambda f: 1e3 * f.brier),
            _by_percent(evaluation, "swept voxels given < 1 %, by % seen", ".1%", lambda f: f.missed),
        ),
        evaluation.figures(),
        draw=lambda: occupancy_plot(evaluation.percents, results, moment),
    )


def _columns() -> list[Column]:
    def of(name: str, factor: float = 1.0, among: str = "average") -> Callable[[PredictorResult], float | None]:
        """Return what gives one of a predictor's average figures, times a factor."""

        def figure(result: PredictorResult) -> float | None:
            figures: VoxelFigures | None = getattr(result, among)
            return None if figures is None else factor * float(getattr(figures, name))

        return figure

    return [
        Column("predictor", lambda r: r.name),
        Column("learned from the tested class", lambda r: r.learned_from_class),
        Column("Brier score x 1000", of("brier", 1e3), ".2f"),
        Column("  as a sum over voxels", of("squared_error"), ".0f"),
        Column("  without mistracked motions x 1000", of("brier", 1e3, "without_mistracked"), ".2f"),
        Column("  its place not listed x 1000", of("brier", 1e3, "unlisted"), ".2f"),
        Column("log score x 1000", of("log_loss", 1e3), ".1f"),
        Column("area under precision-recall", of("average_precision"), ".3f"),
        Column("swept voxels given < 1 %", of("missed"), ".1%"),
        Column("  without mistracked motions", of("missed", 1.0, "without_mistracked"), ".1%"),
        Column("  its place not listed", of("missed", 1.0, "unlisted"), ".1%"),
        Column("calibration error, voxels given >= 1 %", lambda r: r.calibration.error_predicted, ".3f"),
        Column("voxels expected", of("n_predicted"), ".0f"),
        Column("voxels swept", of("n_swept"), ".0f"),
        Column("one update", lambda r: r.timing.median_ms, ".2f", "ms"),
        Column("  99 % below", lambda r: r.timing.p99_ms, ".2f", "ms"),
        Column("training without one motion", lambda r: r.timing.prepare_s, ".2f", "s"),
        Column("postures refused", lambda r: r.refused_postures),
    ]


def _note(evaluation: OccupancyEvaluation) -> str:
    """Return how to read predictors that have not seen the class beside others that have learned it."""
    if all(result.name != "reaching" for result in evaluation.predictors):
        return ""
    text = (
        "reaching (P2) has learned from no motion of the tested motion's class; it knows the places of all classes, "
        "that of the tested one from the class's other motions. Its place not listed: it knows all places but that "
        "one, so that the reach goes to none of them."
    )
    if evaluation.unseen_beside_seen is not None:
        text += (
            f" Its Brier score is {evaluation.unseen_beside_seen:.2f} times that of swept_volume (P1), which was "
            "trained with the class."
        )
    return text


def _by_percent(
    evaluation: OccupancyEvaluation, title: str, spec: str, values: Callable[[VoxelFigures], FloatArray]
) -> Table:
    rows: list[tuple[Any, ...]] = []
    for result in evaluation.predictors:
        rows.append((result.name, *values(result.at_percent).tolist()))
        if result.unlisted_at_percent is not None:
            rows.append((f"{result.name}, place not listed", *values(result.unlisted_at_percent).tolist()))
    return Table.of_rows(title, ("predictor", *((str(percent), spec) for percent in evaluation.percents)), rows)
