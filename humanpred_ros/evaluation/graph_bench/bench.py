"""How long a posture takes through the whole graph over DDS, in real time, and what the nodes cost meanwhile.

The arm stops replanning once it has arrived, so every number of goals is measured in several short runs, each from the
scene's start. The first run of each also measures how long the planner's node takes to get ready.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.demo import training_part
from humanpred_ros.evaluation.graph_bench.input import RATE_HZ, write_motion, write_scene
from humanpred_ros.evaluation.graph_bench.latency import Answers, Delays, answers_of
from humanpred_ros.evaluation.graph_bench.run import GraphRun, GraphSetup, run_graph
from humanpred_ros.evaluation.graph_bench.usage import NodeUsage
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.occupancy.predictor import check_predictor, needed_classifiers, predictor_type
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR
from humanpred_ros.recognition.model_file import save_model
from humanpred_ros.recognition.training import train_model
from humanpred_ros.resources import locate

#: What is aimed at: 99th percentile of posture to trajectory by number of goals, ms; and readiness, s.
TARGET_MS = {2: 60.0, 8: 150.0}
TARGET_READY_S = 3.0
_LIBRARY, _TRAJECTORY = "synthetic_reaches", "3/2"


@dataclass(frozen=True)
class GraphCase:
    """What is measured.

    Attributes:
        goals: numbers of goals.
        waypoints, iterations, rollouts, threads: of the planner.
        period_s: of a replanning step.
        seconds: of postures in every run.
        runs: with each number of goals.
        predictor: of the occupancy.
    """

    goals: tuple[int, ...] = (2, 4, 8)
    waypoints: int = 100
    iterations: int = 50
    rollouts: int = 10
    threads: int = 2
    period_s: float = 0.1
    seconds: float = 4.0
    runs: int = 4
    predictor: str = DEFAULT_PREDICTOR

    def __post_init__(self) -> None:
        if not self.goals or min(self.goals) < 1:
            raise UsageError(f"--goals: wanted one or more numbers of at least 1, got {list(self.goals)}")
        if self.runs < 1:
            raise UsageError(f"--runs: wanted at least 1, got {self.runs}")
        if not self.seconds >= 2.0 * self.period_s:
            raise UsageError(f"--seconds: wanted at least two replanning steps, got {self.seconds} s")

    @property
    def rate_hz(self) -> float:
        return RATE_HZ


@dataclass(frozen=True)
class GoalsResult:
    """All runs with one number of goals.

    Attributes:
        goals: how many.
        occupancy, step, trajectory: posture to occupancy, to decision and to trajectory.
        compute: what the planner itself says its steps took.
        iterations: median over steps of the fewest iterations of a goal that was not set aside.
        steps, late, skipped: replanning steps taken, whose plan came too late, and due but not taken.
        unanswered: postures without an occupancy.
        usage: of each node, mean over runs.
        ready_s, ready_cpu_s: of the planner's node when nothing else was starting; by the clock, and its own
            processor time, which says more on a machine that has other things to do.
    """

    goals: int
    occupancy: Delays
    step: Delays
    trajectory: Delays
    compute: Delays
    iterations: float
    steps: int
    late: int
    skipped: int
    unanswered: int
    usage: tuple[NodeUsage, ...]
    ready_s: float
    ready_cpu_s: float

    @property
    def missed(self) -> int:
        return self.late + self.skipped


@dataclass(frozen=True)
class GraphBench:
    """All that `humanpred bench graph` measures."""

    case: GraphCase
    results: tuple[GoalsResult, ...]

    @property
    def ready_s(self) -> float:
        """Median time to readiness over the numbers of goals."""
        return float(np.median([result.ready_s for result in self.results]))

    @property
    def ready_cpu_s(self) -> float:
        """Median processor time to readiness over the numbers of goals."""
        return float(np.median([result.ready_cpu_s for result in self.results]))


def bench_graph(case: GraphCase, folder: Path, report: Callable[[str], None] = lambda _: None) -> GraphBench:
    """Run the graph with every number of goals.

    Args:
        case: what to measure.
        folder: existing folder for scenes, model, bags and logs.
        report: told what is measured next.

    Raises:
        HumanPredError: impossible settings, or a node that failed.
    """
    check_predictor(case.predictor, DEFAULT_CLASSIFIER)
    library = load_library(locate(_LIBRARY, "bags"))
    motion = library.find(_TRAJECTORY)
    model = (folder / "model.npz").resolve()
    if predictor_type(case.predictor).needs_model:
        report("training the predictor")
        needed = dict.fromkeys(needed_classifiers(case.predictor))
        save_model(train_model(training_part(library, motion, 0), HumanModel.kinect12(), needed), model)
    replayed = write_motion(folder / "back_and_forth", library, motion, case.seconds)
    results = []
    for goals in case.goals:
        scene = write_scene(folder / f"{goals}_goals.yaml", goals)
        setup = GraphSetup(
            scene=scene.resolve(),
            motion=replayed.resolve(),
            predictor={"predictor": case.predictor, "model": str(model)},
            planner={
                "waypoints": case.waypoints,
                "iterations": case.iterations,
                "rollouts": case.rollouts,
                "threads": case.threads,
                "period_s": case.period_s,
                # Every path that is not dearer is sent, so that nearly every step yields a latency.
                "min_improvement": 0.0,
            },
        )
        runs = []
        for k in range(case.runs):
            report(f"{goals} goals, run {k + 1} of {case.runs}")
            runs.append(run_graph(setup, folder / f"{goals}_goals_{k}", alone=k == 0))
        found = [answers_of(run.bag, case.period_s, run.planner_started_ns) for run in runs]
        results.append(summarised(goals, runs, found))
    return GraphBench(case, tuple(results))


def summarised(goals: int, runs: Sequence[GraphRun], found: Sequence[Answers]) -> GoalsResult:
    """Return the figures of all runs with one number of goals together."""

    def together(name: str) -> list[float]:
        return [value for answers in found for value in getattr(answers, name)]

    first, answered = runs[0], found[0]
    iterations = together("iterations")
    return GoalsResult(
        goals=goals,
        occupancy=Delays.of(together("occupancy_s")),
        step=Delays.of(together("step_s")),
        trajectory=Delays.of(together("trajectory_s")),
        compute=Delays.of(together("compute_s")),
        iterations=float(np.median(iterations)) if iterations else float("nan"),
        steps=len(together("step_s")),
        late=sum(answers.late for answers in found),
        skipped=sum(answers.skipped for answers in found),
        unanswered=sum(answers.unanswered for answers in found),
        usage=_mean_usage([run.usage for run in runs]),
        ready_s=answered.ready_s if first.ready_cpu_s is not None else float("nan"),
        ready_cpu_s=first.ready_cpu_s if first.ready_cpu_s is not None else float("nan"),
    )


def _mean_usage(runs: Sequence[tuple[NodeUsage, ...]]) -> tuple[NodeUsage, ...]:
    names = dict.fromkeys(usage.node for run in runs for usage in run)
    mean = []
    for name in names:
        of_node = [usage for run in runs for usage in run if usage.node == name]
        cpu = float(np.mean([usage.cpu_percent for usage in of_node]))
        mean.append(NodeUsage(name, cpu, max(usage.memory_mb for usage in of_node)))
    return tuple(mean)
