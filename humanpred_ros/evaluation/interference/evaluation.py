"""How much does the arm interfere with the person? P1's Table I, and the same over many more motions.

Everything is simulated in one process and in the data's clock: the person makes a recorded motion and does not react,
every posture is given to the predictor, the arm replans every 5 % of the motion and executes meanwhile (P1 lets person
and arm move in turns). The last posture is held until the arm has arrived.

What a motion costs is what P1's code measures (facts section 4): the mean occupancy of the arm's body points, times 87,
integrated over configuration distance of the motion executed, and 0.002 of its length, under P1's prediction after the
last posture. That judge is the same for all methods, and is told of no margin that a planner keeps. Basic STOMP is the
same planner, told that nobody is there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.interference.measures import RunFigures
from humanpred_ros.evaluation.interference.reference import PublishedRow
from humanpred_ros.evaluation.interference.result import (
    BASIC,
    Comparison,
    ContactReport,
    InterferenceEvaluation,
    MethodFigures,
    TableRow,
    UnreachedReport,
)
from humanpred_ros.evaluation.interference.runs import (
    METHODS,
    PREDICTING,
    PersonOutcome,
    Runs,
    RunTask,
)
from humanpred_ros.evaluation.interference.targets import targets_of
from humanpred_ros.evaluation.interference.world import (
    RunSettings,
    first_of_classes,
    running_numbers,
    training_library,
)
from humanpred_ros.evaluation.outputs import library_facts, machine_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.class_mixtures import check_trainable
from humanpred_ros.robot.scene import load_scene

#: Columns of Table I: P1's two, and the default predictor.
TABLE_METHODS = ("ours_p1", "ours", BASIC)
#: P1's Table I: human trajectories 25 to 29 beside the robot.
TABLE_SCENE = "side_by_side"
TABLE_MOTIONS = ("25", "26", "27", "28", "29")
#: A person's way crosses the arm's if basic STOMP comes closer than this.
CROSSING_M = 0.10


@dataclass(frozen=True)
class InterferenceConfig:
    """What is run.

    Attributes:
        table_motions: of Table I, running numbers or names.
        table_runs: of each of them and each method, with seeds that no other of them has, so that basic STOMP, which
            does not see the human, is not run alike beside all; 0 leaves Table I out.
        methods: names of `METHODS` that are compared over many motions; basic is always among them.
        scenes: names, for the comparison.
        motions: so many first motions of every class, for the comparison; 0 leaves it out.
        seeds: runs of each of these, scene and method, with seeds 0, 1, ...
        runs: how each run is made.

    Raises:
        UsageError: names or numbers that cannot be.
    """

    table_motions: tuple[str, ...] = TABLE_MOTIONS
    table_runs: int = 10
    methods: tuple[str, ...] = tuple(METHODS)
    scenes: tuple[str, ...] = (TABLE_SCENE, "face_to_face")
    motions: int = 7
    seeds: int = 1
    runs: RunSettings = field(default_factory=RunSettings)

    def __post_init__(self) -> None:
        unknown = [name for name in self.methods if name not in METHODS]
        if unknown or not self.methods:
            raise UsageError(f"methods: wanted some of {', '.join(METHODS)}, got {', '.join(unknown) or 'none'}")
        object.__setattr__(self, "methods", tuple(name for name in METHODS if name in {*self.methods, BASIC}))
        if min(self.table_runs, self.motions, self.seeds) < 0 or self.runs.hold_out < 0:
            raise UsageError(
                "evaluation: wanted runs, motions, seeds and held-out motions of 0 or more, got "
                f"{self.table_runs}, {self.motions}, {self.seeds} and {self.runs.hold_out}"
            )
        for scene in self.scenes:
            load_scene(scene)  # an unknown one shows before any work is done


def evaluate_interference(
    library: MotionLibrary,
    config: InterferenceConfig | None = None,
    *,
    published: Mapping[int, PublishedRow] | None = None,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> InterferenceEvaluation:
    """Make all runs and return their figures.

    Same library, settings and seeds give the same figures, times apart, for any number of processes.

    Args:
        library: of P1's 12-DoF human.
        config: what.
        published: P1's Table I by global id.
        jobs: number of processes.
        progress: called with the number of tasks done, of `tasks_of`.

    Raises:
        LibraryFormatError: a library that nothing can be learned from.
        HumanPredError: other DoFs, an unknown scene or motion, or a scene that cannot be planned in.
    """
    config = InterferenceConfig() if config is None else config
    HumanModel.kinect12().check_dofs(library.dof_names)
    check_trainable(training_library(library, config.runs.hold_out))
    tasks = tasks_of(library, config)
    outcomes = map_processes(Runs(library, config.runs), tasks, jobs, progress)
    runs = tuple(run for outcome in outcomes for run in outcome.runs)
    table1 = _table1(library, config, runs, published or {})
    comparison = _comparison(library, config, tasks, outcomes)
    contacts = _contacts(tasks, outcomes)
    return InterferenceEvaluation(
        library=library_facts(library, held_out_together=config.runs.hold_out),
        settings=dataclasses.asdict(config)
        | {
            "jobs": jobs,
            "methods_are": {name: what for name, (_, what) in METHODS.items()},
            "compared_motions": tuple(first_of_classes(library, config.motions)),
        },
        machine=machine_facts(),
        table1=table1,
        comparison=comparison,
        contacts=contacts,
        unreached=_unreached(outcomes),
        targets=targets_of(table1, comparison, contacts),
        runs=runs,
    )


def tasks_of(library: MotionLibrary, config: InterferenceConfig) -> list[RunTask]:
    """Return what is to be run, one task for each scene and person, those with most runs first.

    Raises:
        UsageError: no such motion.
    """
    wanted: dict[tuple[str, str], dict[tuple[str, int], None]] = {}  # dictionaries keep the order, sets do not
    for motion, seeds in _table_seeds(library, config).items():
        runs = wanted.setdefault((TABLE_SCENE, motion), {})
        runs.update(dict.fromkeys((method, seed) for method in TABLE_METHODS for seed in seeds))
    for scene in config.scenes:
        for motion in first_of_classes(library, config.motions):
            runs = wanted.setdefault((scene, motion), {})
            runs.update(dict.fromkeys((method, seed) for method in config.methods for seed in range(config.seeds)))
    tasks = [RunTask(scene, motion, tuple(runs)) for (scene, motion), runs in wanted.items() if runs]
    return sorted(tasks, key=lambda task: -len(task.runs))


def _table_seeds(library: MotionLibrary, config: InterferenceConfig) -> dict[str, range]:
    """Return the seeds of each motion of Table I, by name."""
    names = [library.find(motion).name for motion in config.table_motions]
    n = config.table_runs
    return {name: range(k * n, (k + 1) * n) for k, name in enumerate(dict.fromkeys(names))} if n else {}


def _table1(
    library: MotionLibrary,
    config: InterferenceConfig,
    runs: tuple[RunFigures, ...],
    published: Mapping[int, PublishedRow],
) -> tuple[TableRow, ...]:
    numbers = running_numbers(library)
    rows = []
    for motion, seeds in _table_seeds(library, config).items():
        beside = [run for run in runs if (run.scene, run.motion) == (TABLE_SCENE, motion) and run.seed in seeds]
        figures = {method: MethodFigures.of(method, beside) for method in TABLE_METHODS}
        rows.append(TableRow(numbers[motion], motion, figures, published.get(numbers[motion])))
    return tuple(rows)


def _comparison(
    library: MotionLibrary, config: InterferenceConfig, tasks: Sequence[RunTask], outcomes: Sequence[PersonOutcome]
) -> tuple[Comparison, ...]:
    names = set(first_of_classes(library, config.motions))
    persons = [
        ([run for run in outcome.runs if run.seed < config.seeds and run.method in config.methods], outcome.bound_m)
        for task, outcome in zip(tasks, outcomes, strict=True)
        if task.scene in config.scenes and task.motion in names
    ]
    persons = [person for person in persons if person[0]]
    if not persons:
        return ()
    found = [Comparison.of("all scenes", config.methods, persons)]
    for scene in config.scenes:
        found.append(Comparison.of(f"scene {scene}", config.methods, [p for p in persons if p[0][0].scene == scene]))
    close = [
        (runs, bound)
        for runs, bound in persons
        if min(run.least_distance_m for run in runs if run.method == BASIC) < CROSSING_M
    ]
    if close:
        found.append(
            Comparison.of(f"where basic comes closer than {CROSSING_M:.2f} m in some run", config.methods, close)
        )
    return tuple(found)


def _contacts(tasks: list[RunTask], outcomes: list[PersonOutcome]) -> tuple[ContactReport, ...]:
    reports = [
        ContactReport(run.scene, run.motion, run.method, run.seed, run.contact, outcome.avoidance)
        for task, outcome in zip(tasks, outcomes, strict=True)
        for run in outcome.runs
        if run.contact is not None
    ]
    order = list(METHODS)
    return tuple(sorted(reports, key=lambda r: (order.index(r.method), r.scene, r.motion, r.seed)))


def _unreached(outcomes: list[PersonOutcome]) -> tuple[UnreachedReport, ...]:
    reports = [
        UnreachedReport(run.scene, run.motion, run.method, run.seed, outcome.goal_m, run.ended)
        for outcome in outcomes
        for run in outcome.runs
        if run.goal is None and run.method in PREDICTING
    ]
    return tuple(sorted(reports, key=lambda r: (r.method, r.scene, r.motion, r.seed)))
