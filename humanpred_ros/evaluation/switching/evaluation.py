"""How early does the arm choose the task that leaves the person alone? P1's Fig. 9, and the same over all motions.

Simulated as in `interference_evaluation`: every posture is given to the predictor, the arm replans every 5 % of the
person's motion and executes meanwhile. A step's costs are what the planner compares the goals by. Each motion is shown
to predictors that have learned neither from it nor from the four that are held out with it, of every class.

Words: the *right* goal is the one the same planner chooses in the first step if it is told all voxels that the body is
going to sweep; the *default* goal the one it chooses if nobody is there. Where the two are the same, everybody is right
from the first step and there is nothing to be decided earlier.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.interference.world import (
    RunSettings,
    first_of_classes,
    group_of,
    training_library,
)
from humanpred_ros.evaluation.outputs import library_facts, machine_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.switching.reference import PublishedCosts
from humanpred_ros.evaluation.switching.result import (
    CONTESTED,
    SwitchingEvaluation,
    SwitchSummary,
    VariantFigures,
    targets_of,
)
from humanpred_ros.evaluation.switching.runs import VARIANTS, Choosing, Person, SwitchTask
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.class_mixtures import check_trainable
from humanpred_ros.robot.scene import load_scene


@dataclass(frozen=True)
class SwitchingConfig:
    """What is run.

    Attributes:
        scene: with two goals or more.
        figure_motion: of Fig. 9, running number or name; "" leaves it out.
        figure_seeds: runs of it, with seeds 0, 1, ...
        motions: so many first motions of every class are shown, with seed 0; None: all; 0 leaves them out.
        runs: how each run is made.

    Raises:
        UsageError: numbers that cannot be, or a scene with a single goal.
    """

    scene: str = "face_to_face"
    figure_motion: str = "77"
    figure_seeds: int = 10
    motions: int | None = None
    runs: RunSettings = field(default_factory=RunSettings)

    def __post_init__(self) -> None:
        if self.figure_seeds < 1 or (self.motions is not None and self.motions < 0):
            raise UsageError(
                f"evaluation: wanted one seed or more and motions >= 0, got {self.figure_seeds} and {self.motions}"
            )
        goals = [goal.name for goal in load_scene(self.scene).goals]
        if len(goals) < 2:
            raise UsageError(
                f"scene {self.scene}: wanted two goals or more to choose between, got {', '.join(goals)}; take "
                "another, like face_to_face"
            )


def evaluate_switching(
    library: MotionLibrary,
    config: SwitchingConfig | None = None,
    *,
    published: PublishedCosts | None = None,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> SwitchingEvaluation:
    """Make all runs and return their figures.

    Same library, settings and seeds give the same figures for any number of processes.

    Args:
        library: of P1's 12-DoF human.
        config: what.
        published: P1's Fig. 9.
        jobs: number of processes.
        progress: called with the number of tasks done, of `tasks_of`.

    Raises:
        LibraryFormatError: a library that nothing can be learned from.
        HumanPredError: other DoFs, or an unknown motion.
    """
    config = SwitchingConfig() if config is None else config
    HumanModel.kinect12().check_dofs(library.dof_names)
    check_trainable(training_library(library, config.runs.hold_out))
    tasks = tasks_of(library, config)
    persons = map_processes(Choosing(library, config.runs), tasks, jobs, progress)
    figure = None
    if config.figure_motion:
        name = library.find(config.figure_motion).name
        figure = next(person for person in persons if person.motion == name)
    shown = _shown(library, config)
    summaries = _summaries(config, [person for person in persons if person.motion in set(shown)])
    return SwitchingEvaluation(
        library=library_facts(library, held_out_together=config.runs.hold_out),
        settings=dataclasses.asdict(config)
        | {
            "jobs": jobs,
            "variants_are": {name: what for name, (_, what) in VARIANTS.items()},
            "shown_motions": tuple(shown),
        },
        machine=machine_facts(),
        goals=tuple(goal.name for goal in load_scene(config.scene).goals),
        figure=figure,
        published=published,
        summaries=summaries,
        targets=targets_of(figure, published, summaries),
        persons=tuple(persons),
    )


def tasks_of(library: MotionLibrary, config: SwitchingConfig) -> list[SwitchTask]:
    """Return what is to be run, one task for each person, Fig. 9 first.

    Raises:
        UsageError: no such motion.
    """
    seeds: dict[str, tuple[int, ...]] = dict.fromkeys(_shown(library, config), (0,))
    if config.figure_motion:
        name = library.find(config.figure_motion).name
        seeds = {name: tuple(range(config.figure_seeds))} | {n: s for n, s in seeds.items() if n != name}
    return [SwitchTask(config.scene, name, its) for name, its in seeds.items()]


def _shown(library: MotionLibrary, config: SwitchingConfig) -> list[str]:
    count = len(library) if config.motions is None else config.motions
    # Those held out together follow each other, so that all processes learn without them at about the same time.
    group = {motion.name: group_of(library, motion, config.runs.hold_out) for motion in library}
    return sorted(first_of_classes(library, count), key=lambda name: group[name])


def _summaries(config: SwitchingConfig, persons: list[Person]) -> tuple[SwitchSummary, ...]:
    parts = {"all motions": persons, CONTESTED: [person for person in persons if person.conflict]}
    return tuple(
        SwitchSummary(
            title, len(some), tuple(VariantFigures.of(variant, some, config.runs.steps) for variant in VARIANTS)
        )
        for title, some in parts.items()
        if some
    )
