"""How long a posture takes through the whole graph over DDS, in real time, and what the nodes cost meanwhile.

The arm stops replanning once it has arrived, so every number of goals is measured in several short runs, each from the
scene's start. The first run of each also measures how long the planner's node takes to get ready.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros import topics
from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.evaluation.bench_nodes import (
    RATE_HZ,
    Answers,
    NodeUsage,
    answers_of,
    guard_delays_ms,
    replay,
    wait_until_resting,
    write_motion,
    write_scene,
)
from humanpred_ros.evaluation.demo import training_part
from humanpred_ros.evaluation.framework import Begin, Column, OutputSettings, Report, Table
from humanpred_ros.evaluation.processes import ONE_PROCESS, NodeGroup, ParameterValue, free_domain_id, in_one_process
from humanpred_ros.evaluation.timing import MachineLoad, Spread, growth_plot
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.occupancy.predictor import check_predictor, needed_classifiers, predictor_type
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR
from humanpred_ros.recognition.training import save_model, train_model
from humanpred_ros.resources import locate
from humanpred_ros.settings import setting, setting_of
from humanpred_ros.stomp.config import StompConfig

_LIBRARY, _TRAJECTORY = "synthetic_reaches", "3/2"
_UNHEARD = {topic: f"unheard/{topic}" for topic in (topics.SPEED_FACTOR, topics.GUARD_STOP)}
_DELAYS = {
    "occupancy_ms": "posture to occupancy",
    "step_ms": "posture to decision",
    "trajectory_ms": "posture to trajectory",
    "compute_ms": "  planner's own part",
}


class GraphBenchSettings(OutputSettings):
    """Settings of `humanpred bench graph`."""

    goals: tuple[int, ...] = setting((2, 4, 8), "numbers of goals", low=1)
    waypoints: int = setting_of(StompConfig, "waypoints", default=100)
    iterations: int = setting_of(StompConfig, "iterations", low=1)
    rollouts: int = setting_of(StompConfig, "rollouts", description="rollouts per iteration", low=2)
    threads: int = setting_of(ReplannerConfig, "threads")
    period: float = setting_of(ReplannerConfig, "period_s", default=0.1)
    seconds: float = setting(4.0, "length of the postures in every run", unit="s", low=0.1, high=600.0)
    runs: int = setting(4, "runs with each number of goals", low=1)
    predictor: str = setting(DEFAULT_PREDICTOR, "predictor of the occupancy")
    one_process: bool = setting(False, "measure predictor and planner in one process as well")
    keep: Path | None = setting(None, "new folder to keep bags and logs in")

    def check(self) -> None:
        """Refuse an empty list of goals, and runs without a replanning step."""
        if not self.goals:
            raise SettingsError(f"{type(self).__name__} goals: wanted one or more numbers, got none")
        if not self.seconds >= 2.0 * self.period:
            raise SettingsError(
                f"{type(self).__name__} seconds: wanted at least two replanning steps of {self.period:g} s, "
                f"got {self.seconds:g} s"
            )


def measure(settings: GraphBenchSettings, begin: Begin) -> Report:
    """Run the graph with every number of goals.

    Raises:
        UsageError: an unknown predictor, a folder to keep that exists, or a node that failed.
    """
    check_predictor(settings.predictor, DEFAULT_CLASSIFIER)
    if settings.keep is not None and settings.keep.exists():
        raise UsageError(f"--keep: wanted a folder that does not exist yet, {settings.keep} does; choose another")
    load = MachineLoad()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (settings.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        results = list(_results(settings, folder, begin))
        alone = _guard_alone(folder / "guard_alone", folder / "back_and_forth", results[0]["scene"])
    ready = {
        name: float(np.median([result[name] for result in results if not result["one_process"]]))
        for name in ("ready_s", "ready_cpu_s")
    }
    return Report(
        f"{RATE_HZ:.0f} postures a second, {settings.waypoints} waypoints, {settings.iterations} iterations x "
        f"{settings.rollouts} rollouts, replanning every {1e3 * settings.period:.0f} ms; {settings.runs} runs of "
        f"{settings.seconds:g} s",
        (*_tables(results), _guard_table(results, alone)),
        {"guard_alone": alone, "rate_hz": RATE_HZ, "results": results, **ready, "other_cores": load.other_cores()},
        (
            f"Planner's node ready {ready['ready_s']:.1f} s after its start, {ready['ready_cpu_s']:.1f} s of them at "
            "work.",
            *load.notes(),
        ),
        lambda: growth_plot(_points(results), "ms, median"),
    )


def _results(settings: GraphBenchSettings, folder: Path, begin: Begin) -> Iterator[dict[str, Any]]:
    """Give the figures of each number of goals."""
    library = load_library(locate(_LIBRARY, "bags"))
    motion = library.find(_TRAJECTORY)
    predictor: dict[str, ParameterValue] = {"predictor": settings.predictor, "model": str(folder / "model.npz")}
    if predictor_type(settings.predictor).needs_model:
        needed = dict.fromkeys(needed_classifiers(settings.predictor))
        model = train_model(training_part(library, motion, 0), HumanModel.kinect12(), needed)
        save_model(model, folder / "model.npz")
    replayed = write_motion(folder / "back_and_forth", library, motion, settings.seconds)
    planner: dict[str, ParameterValue] = {
        "waypoints": settings.waypoints,
        "iterations": settings.iterations,
        "rollouts": settings.rollouts,
        "threads": settings.threads,
        "period_s": settings.period,
        # Every path that is not dearer is sent, so that nearly every step yields a latency.
        "min_improvement": 0.0,
    }
    for goals, one_process in product(settings.goals, (False, True) if settings.one_process else (False,)):
        scene = {"scene": str(write_scene(folder / f"{goals}_goals.yaml", goals))}
        runs, guard = [], []
        advance = begin(f"runs with {goals} goals", settings.runs)
        name = f"{goals}_goals{'_in_one_process' if one_process else ''}"
        for k in range(settings.runs):
            started_ns, cpu_s, usage = _run_graph(
                folder / f"{name}_{k}",
                replayed,
                {**scene, **predictor},
                {**scene, **planner},
                alone=k == 0,
                one_process=one_process,
            )
            bag = folder / f"{name}_{k}" / "bag"
            runs.append((answers_of(bag, settings.period, started_ns), cpu_s, usage))
            guard.append(guard_delays_ms(bag))
            advance(k + 1)
        yield {**together(goals, runs), "one_process": one_process, "guard": guard, "scene": scene["scene"]}


def _run_graph(
    folder: Path,
    motion: Path,
    predictor: Mapping[str, ParameterValue],
    planner: Mapping[str, ParameterValue],
    *,
    alone: bool,
    one_process: bool,
) -> tuple[int, float, tuple[NodeUsage, ...]]:
    """Start the nodes, replay the motion once, end the nodes.

    Args:
        folder: new folder for bag and logs.
        motion: bag with the one motion replayed.
        predictor, planner: parameters of occupancy_predictor and stomp_planner.
        one_process: predictor and planner are one process, which is then what is said of the planner's.
        alone: start the planner when the others rest, and the tracker when the planner rests; else all at once.

    Returns:
        Wall time at which the planner's process was started, ns; the processor time it used until it was ready, s
        (NaN unless it started alone, as nothing else tells what is its own); and what each node used.

    Raises:
        UsageError: a node that failed, or did not get ready.
    """
    folder.mkdir(parents=True)
    ready_cpu_s = float("nan")
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        group.start(
            "run_recorder", {"output": str(folder / "bag"), "stay": False, "run_info": json.dumps({"bench": "graph"})}
        )
        group.start("simulated_arm", {"scene": planner["scene"]})
        # Beside the graph, which does not hear it: an arm that it stops gives no figures.
        group.start("separation_guard", {"scene": planner["scene"]}, _UNHEARD)
        predictor = {"listener": "stomp_planner", **predictor}
        planner = {"controller": "simulated_arm", **planner}
        if not one_process:
            group.start("occupancy_predictor", predictor)
        if alone:
            wait_until_resting(group)
        started_ns = time.time_ns()
        if one_process:
            node = group.start(ONE_PROCESS, in_one_process(planner, predictor))
        else:
            node = group.start("stomp_planner", planner)
        if alone:
            wait_until_resting(group)
            used = node.usage()
            ready_cpu_s = used.cpu_s if used is not None else ready_cpu_s
        usage = replay(group, motion)
    return started_ns, ready_cpu_s, usage


def _guard_alone(folder: Path, motion: Path, scene: str) -> list[dict[str, float]]:
    """Return how soon a separation guard answers that has the machine to itself and the tracker, recorder and arm."""
    folder.mkdir(parents=True)
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        needed = topics.JOINT_STATES
        group.start("run_recorder", {"output": str(folder / "bag"), "stay": False, "wait_for": needed})
        group.start("simulated_arm", {"scene": scene})
        group.start("separation_guard", {"scene": scene}, _UNHEARD)
        replay(group, motion, listener="separation_guard")
    return [guard_delays_ms(folder / "bag")]


def _guard_table(results: Sequence[dict[str, Any]], alone: Sequence[dict[str, float]]) -> Table:
    """Return the guard's figures: of several runs the median of the medians, and the largest of the others."""
    rows = [("no planner", alone), *((f"{result['goals']} goals", result["guard"]) for result in results)]
    return Table(
        "Separation guard: milliseconds from a posture's publication to that of the speed factor",
        [(name, [run for run in runs if run]) for name, runs in rows],
        (
            Column("", lambda row: row[0]),
            Column("median", lambda row: float(np.median([run["median"] for run in row[1]])), ".2f"),
            Column("99 %", lambda row: max((run["p99"] for run in row[1]), default=math.nan), ".2f"),
            Column("most", lambda row: max((run["most"] for run in row[1]), default=math.nan), ".2f"),
            Column("n", lambda row: sum(int(run["n"]) for run in row[1])),
        ),
    )


def together(goals: int, runs: Sequence[tuple[Answers, float, Sequence[NodeUsage]]]) -> dict[str, Any]:
    """Return the figures of all runs with one number of goals.

    Args:
        goals: how many.
        runs: of each the answers, the processor time of the planner until it was ready, and what each node used; the
            planner of the first has started alone.
    """
    answers = [answer for answer, _, _ in runs]
    iterations = [n for answer in answers for n in answer.iterations]
    usage: dict[str, list[NodeUsage]] = {}
    for _, _, nodes in runs:
        for node in nodes:
            usage.setdefault(node.node, []).append(node)
    return {
        "goals": goals,
        **{key: Spread.of([delay for answer in answers for delay in answer.delays_ms[key]]) for key in _DELAYS},
        "iterations": float(np.median(iterations)) if iterations else float("nan"),
        **{key: sum(answer.counts[key] for answer in answers) for key in answers[0].counts},
        "usage": [
            {
                "node": name,
                "cpu_percent": float(np.mean([node.cpu_percent for node in nodes])),
                "memory_mb": max(node.memory_mb for node in nodes),
            }
            for name, nodes in usage.items()
        ],
        "ready_s": answers[0].ready_s,
        "ready_cpu_s": runs[0][1],
    }


def _tables(results: Sequence[dict[str, Any]]) -> Iterator[Table]:
    delays = [(f"{what}, {_label(result)}", result[key]) for result in results for key, what in _DELAYS.items()]
    yield Table(
        "Milliseconds from a posture's publication to the receipt of its answer by the recorder",
        delays,
        (
            Column("", lambda row: row[0]),
            Column("median", lambda row: row[1].median, ".1f"),
            Column("99 %", lambda row: row[1].p99, ".1f"),
            Column("most", lambda row: row[1].most, ".1f"),
            Column("n", lambda row: row[1].n),
        ),
    )
    yield Table(
        "Replanning steps",
        results,
        (
            Column("", _label),
            Column("taken", lambda row: row["steps"]),
            Column("too late", lambda row: row["late"]),
            Column("skipped", lambda row: row["skipped"]),
            Column("iterations, median", lambda row: row["iterations"], ".0f"),
            Column("postures unanswered", lambda row: row["unanswered"]),
        ),
    )
    yield Table(
        "Nodes",
        [(f"{node['node']}, {_label(result)}", node) for result in results for node in result["usage"]],
        (
            Column("node", lambda row: row[0]),
            Column("processor, % of a core", lambda row: row[1]["cpu_percent"], ".0f"),
            Column("memory", lambda row: row[1]["memory_mb"], ".0f", "MB"),
        ),
    )


def _points(results: Sequence[dict[str, Any]]) -> Iterator[tuple[str, int, str, float]]:
    for result in results:
        for key, what in _DELAYS.items():
            one = ", one process" if result["one_process"] else ""
            yield "goals", result["goals"], f"{what.strip()}{one}", result[key].median


def _label(result: Mapping[str, Any]) -> str:
    return f"{result['goals']} goals{', one process' if result['one_process'] else ''}"
