"""The arm beside one person, by every method and seed: the runs that P1's Table I and its extension are made of.

The recorded person does not react. Whether any motion of the arm could have avoided a contact is found by trying.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.run_figures import ExecutedMotion, RunEvaluator, RunFigures
from humanpred_ros.evaluation.simulation import (
    METHODS,
    PredictedOccupancies,
    RunSettings,
    World,
    drive,
    drive_guarded,
    held_postures,
    nobody,
    read_published,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import at_rest
from humanpred_ros.robot.scene import Scene

BASIC = "basic"
#: Table I: P1's two methods and the default predictor, beside human trajectories 25 to 29.
TABLE_METHODS = ("ours_p1", "ours", BASIC)
#: Methods that predict: every contact of their runs is looked into.
PREDICTING = ("ours", "ours_p1")
#: Methods with a separation guard.
GUARDED = ("guard", "ours_guard")
#: Whose prediction after the last posture every run is measured with, as in P1's Table I.
_MEASURE = "swept_volume"
#: Where the papers' data folder keeps Table I, relative to the folder that a library lies in, and its name of ours.
TABLE1_BESIDE_LIBRARY = Path("reference") / "table1_runs.csv"
_PUBLISHED_OURS = "least_penetration"
#: Waypoints of a straight line that is tried.
_WAYPOINTS = 40
#: Configurations to leave for that are tried, and how far each joint may turn, rad.
_PLACES = 200
_SPREAD_RAD = 1.2
#: Departures tried, in replanning steps after the first posture.
_DEPARTURES = (0, 1, 2, 4, 6, 8, 10, 12, 15, 20)


@dataclass(frozen=True)
class RunTask:
    """What is to be run with one person in one scene: (method, seed) of each run."""

    scene: str
    motion: str
    runs: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Avoidance:
    """The best that was found by trying simple policies with everything known beforehand.

    A policy is: stay at the start; go to a goal on a straight line, departing at some replanning step; go on a straight
    line to one of 200 places around the start and stay there. All within the planner's velocity and acceleration
    limits and clear of table and objects.
    """

    policy: str  #: the first that stays clear of the human, "" if none does: then the contact counts as unavoidable
    latest_departure_s: float  #: until when the arm could still depart by that policy; infinite if it need not move
    best_m: float  #: largest least distance of all policies tried
    tried: int  #: how many were


@dataclass(frozen=True)
class PersonOutcome:
    """What came of a task."""

    runs: tuple[RunFigures, ...]  #: one for each of the task's
    #: distance that the person, in the last posture, leaves an arm at a goal; at the goal where it is largest
    goal_m: float
    #: no run that ends at a goal can keep a larger least distance: the arm is at its start when the person is in the
    #: first posture, and at a goal when the person is in the last
    bound_m: float
    avoidance: Avoidance | None  #: whether a contact could have been avoided; None if no predicting method had one


class Runs:
    """Carries a library to where runs are made.

    Called with a task it returns the outcome. Same library, settings and task give the same figures, times apart.
    """

    def __init__(self, library: MotionLibrary, settings: RunSettings) -> None:
        self.world, self.settings = World(library, settings), settings

    def __call__(self, task: RunTask) -> PersonOutcome:
        """Make the runs of one task. Raises what training, prediction and planning raise."""
        scene, motion = self.world.scene(task.scene), self.world.library.find(task.motion)
        n_held = held_postures(motion, self.settings.hold_s)
        predictors = {METHODS[method][0] for method, _ in task.runs} | {_MEASURE}
        seen = {name: self.world.predictions(name, scene, motion, n_held) for name in sorted(filter(None, predictors))}
        final, swept = seen[_MEASURE].after(len(motion) - 1), self.world.swept(scene, motion)
        evaluator = RunEvaluator(scene, self.world.human, motion, final, swept, n_held)
        figures: dict[tuple[str, int], RunFigures] = {}
        for seed in dict.fromkeys(seed for _, seed in task.runs):
            with closing(Replanner.for_scene(scene, self.settings.replanner_config(motion, seed))) as replanner:
                for method in (method for method, its_seed in task.runs if its_seed == seed):
                    executed, decisions = _run(replanner, scene, motion, method, seen, n_held)
                    figures[method, seed] = evaluator.figures(method, seed, executed, decisions)
        touched = any(run.contact is not None and run.method in PREDICTING for run in figures.values())
        goal_m = max(evaluator.distance_m(q, -1) for goal in scene.goals for q in goal.configurations)
        return PersonOutcome(
            tuple(figures[run] for run in task.runs),
            goal_m,
            min(evaluator.distance_m(scene.start, 0), goal_m),
            find_avoidance(evaluator, self.settings.replanner_config(motion, 0)) if touched else None,
        )


def _run(
    replanner: Replanner,
    scene: Scene,
    motion: Motion,
    method: str,
    seen: Mapping[str, PredictedOccupancies],
    n_held: int,
) -> tuple[ExecutedMotion, list[Decision]]:
    predictor, _ = METHODS[method]
    begin_s, n_least, first = 0.0, len(motion), 0
    if method == "wait":
        # It plans at the very moment the motion is over.
        begin_s, n_least, first = motion.duration_s - replanner.config.period_s, 1, len(motion) - 1
    occupancies: Iterable[Occupancy] = nobody(scene.grid, motion, n_held)
    if predictor is not None:
        occupancies = seen[predictor].since(first)
    if method in GUARDED:
        decisions, pace = drive_guarded(replanner, scene, HumanModel.kinect12(), motion, occupancies, n_held)
        return ExecutedMotion.of(scene.start, decisions, begin_s, pace), decisions
    decisions = drive(replanner, scene.start, occupancies, n_least, begin_s)
    return ExecutedMotion.of(scene.start, decisions, begin_s), decisions


def method_figures(method: str, runs: Sequence[RunFigures]) -> dict[str, Any]:
    """Return what came of a method's runs among `runs`, which hold those of basic, too.

    Least, mean and median values are over the runs. `ratio` is the mean cost of basic through this method's, on the
    same persons and seeds, `ratio_swept` the same under the voxels really swept, and `ratio_reached` the same over the
    runs that reached a goal and whose counterpart of basic did: who stops on the way costs little. A run that reaches
    no goal counts as infinitely late.
    """
    mine, basic = ([run for run in runs if run.method == name] for name in (method, BASIC))
    cost, swept = np.array([run.cost for run in mine]), np.array([run.cost_swept for run in mine])
    distance, step_ms = (np.array([getattr(run, of) for run in mine]) for of in ("least_distance_m", "step_ms"))
    timed = step_ms[np.isfinite(step_ms)]
    theirs = {(run.scene, run.motion, run.seed): run.cost for run in basic if run.goal is not None}
    pairs = [
        (theirs[run.scene, run.motion, run.seed], run.cost)
        for run in mine
        if run.goal is not None and (run.scene, run.motion, run.seed) in theirs
    ]
    return {
        "method": method,
        "runs": len(mine),
        "reached": sum(run.goal is not None for run in mine),
        "contacts": sum(run.contact is not None for run in mine),
        "cost_mean": float(cost.mean()),
        "cost_sd": float(cost.std(ddof=1)) if len(cost) > 1 else 0.0,
        "cost_median": float(np.median(cost)),
        "cost_swept_mean": float(swept.mean()),
        "ratio": _ratio(np.mean([run.cost for run in basic]) if basic else np.nan, cost.mean()),
        "ratio_swept": _ratio(np.mean([run.cost_swept for run in basic]) if basic else np.nan, swept.mean()),
        "ratio_reached": _ratio(sum(b for b, _ in pairs), sum(m for _, m in pairs)),
        "least_distance_m": float(distance.min()),
        "median_distance_m": float(np.median(distance)),
        "clearance_m": min(run.clearance_m for run in mine),
        "time_to_goal_s": float(np.median([run.time_to_goal_s for run in mine])),
        "execution_s": float(np.median([run.execution_s for run in mine])),
        "slowed": float(np.mean([run.slowed for run in mine])),
        "stopped": float(np.mean([run.stopped for run in mine])),
        "step_ms": float(np.median(timed)) if len(timed) else np.nan,
    }


def _ratio(basic: float | np.floating[Any], mine: float | np.floating[Any]) -> float:
    return float(basic / mine) if mine > 0.0 else np.nan


def read_table1(folder: Path) -> dict[int, dict[str, float]]:
    """Return P1's Table I by global id: mean and sd of both planners and their ratio; empty if it is not in a folder.

    Raises:
        UsageError: a file without the columns human_traj_id, planner and cost, or with the runs of one planner only.
        LibraryFormatError: a file that cannot be read, or is empty.
    """
    path = folder / TABLE1_BESIDE_LIBRARY
    costs: dict[int, dict[str, list[float]]] = {}
    for number, planner, cost in read_published(path, human_traj_id=int, planner=str, cost=float):
        of_motion = costs.setdefault(number, {"ours": [], "basic": []})
        of_motion["ours" if planner == _PUBLISHED_OURS else "basic"].append(cost)
    if not all(len(values) for of_motion in costs.values() for values in of_motion.values()):
        raise UsageError(f"{path}: wanted runs of both planners of every trajectory; complete it")
    rows = {}
    for number, of_motion in costs.items():
        rows[number] = {f"{name}_mean": float(np.mean(values)) for name, values in of_motion.items()}
        for name, values in of_motion.items():
            rows[number][f"{name}_sd"] = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
        rows[number]["ratio"] = rows[number]["basic_mean"] / rows[number]["ours_mean"]
    return rows


def find_avoidance(evaluator: RunEvaluator, config: ReplannerConfig, seed: int = 0) -> Avoidance:
    """Try policies in turn until one stays clear of the human, table and objects.

    Args:
        evaluator: scene and person.
        config: limits and period of the planner.
        seed: of the places tried.
    """
    best, tried = -np.inf, 0
    for policy, target in _policies(evaluator.scene, seed):
        clear_at = -np.inf
        for departure_s in (k * config.period_s for k in (_DEPARTURES if target is not None else (0,))):
            least = _least_distance(evaluator, config, target, departure_s)
            tried += 1
            best = max(best, least)
            if least > 0.0:
                clear_at = departure_s
            elif np.isfinite(clear_at) or not policy.startswith("go to"):
                break  # the arm that leaves for a place too late at first is later still
        if clear_at > -np.inf:
            return Avoidance(policy, np.inf if target is None else clear_at, best, tried)
    return Avoidance("", -np.inf, best, tried)


def _policies(scene: Scene, seed: int) -> Iterator[tuple[str, FloatArray | None]]:
    """Yield name and target (None: stay) of each policy."""
    yield "stay at the start", None
    for goal in scene.goals:
        for q in goal.configurations:
            yield f"go to {goal.name} on a straight line", scene.start + scene.arm.difference(scene.start, q)
    rng = np.random.default_rng(seed)
    lower, upper = scene.arm.chain.lower, scene.arm.chain.upper
    for _ in range(_PLACES):
        place = np.clip(scene.start + rng.uniform(-_SPREAD_RAD, _SPREAD_RAD, len(lower)), lower, upper)
        yield "leave for " + " ".join(f"{angle:.2f}" for angle in place), place


def _least_distance(
    evaluator: RunEvaluator, config: ReplannerConfig, target: FloatArray | None, departure_s: float
) -> float:
    """Return the least distance to the human; minus infinity where table or an object is in the way."""
    scene = evaluator.scene
    trajectory = at_rest(scene.start, departure_s)
    if target is not None:
        limit = config.velocity_scale * scene.arm.chain.velocity_limit
        acceleration = np.minimum(config.acceleration_limit, scene.arm.chain.acceleration_limit)
        path, rest = straight(scene.start, target, _WAYPOINTS), np.zeros(len(target))
        trajectory = time_parameterise(path, limit, acceleration, rest, rest, config.sample_period_s, departure_s)
        spheres = scene.arm.spheres()
        centres = spheres.world_m(scene.arm.chain, trajectory.q)
        for obstacle in (*scene.obstacles, *scene.arm.fixed_obstacles):
            if (obstacle.distance_m(centres) - spheres.radius_m).min() < 0.0:
                return -np.inf
    return evaluator.meter.measure(trajectory.sample(evaluator.t_s)[0]).least_m
