"""The recorded person does not react: whether any motion of the arm could have avoided a contact is found by trying."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from humanpred_ros.evaluation.run_figures import RunEvaluator
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory, at_rest

#: Waypoints of a straight line that is tried.
_WAYPOINTS = 40
#: Configurations to leave for that are tried, and how far each joint may turn, rad.
_PLACES = 200
_SPREAD_RAD = 1.2
#: Departures tried, in replanning steps after the first posture.
_DEPARTURES = (0, 1, 2, 4, 6, 8, 10, 12, 15, 20)


@dataclass(frozen=True)
class Avoidance:
    """The best that was found by trying simple policies with everything known beforehand.

    A policy is: stay at the start; go to a goal on a straight line, departing at some replanning step; go on a straight
    line to one of 200 places around the start and stay there. All within the planner's velocity and acceleration
    limits and clear of table and objects.

    Attributes:
        policy: the first that stays clear of the human, "" if none does: then the contact counts as unavoidable.
        latest_departure_s: until when the arm could still depart by that policy; infinite if it need not move.
        best_m: largest least distance of all policies tried.
        tried: how many were.
    """

    policy: str
    latest_departure_s: float
    best_m: float
    tried: int

    @property
    def avoidable(self) -> bool:
        """Whether some policy stays clear."""
        return bool(self.policy)


def find_avoidance(evaluator: RunEvaluator, config: ReplannerConfig, seed: int = 0) -> Avoidance:
    """Try policies in turn until one stays clear of the human, table and objects.

    Args:
        evaluator: scene and person.
        config: limits and period of the planner.
        seed: of the places tried.
    """
    best, tried = -np.inf, 0
    for policy, target, departures in _policies(evaluator, config, seed):
        clear_at = -np.inf
        for departure_s in departures:
            least = _least_distance(evaluator, config, target, departure_s)
            tried += 1
            best = max(best, least)
            if least > 0.0:
                clear_at = departure_s
            elif np.isfinite(clear_at) or not policy.startswith("go to"):
                break  # for places to leave for, who is too late at first is later still
        if clear_at > -np.inf:
            return Avoidance(policy, np.inf if target is None else clear_at, best, tried)
    return Avoidance("", -np.inf, best, tried)


def _policies(
    evaluator: RunEvaluator, config: ReplannerConfig, seed: int
) -> Iterator[tuple[str, FloatArray | None, tuple[float, ...]]]:
    """Yield name, target (None: stay) and departures of each policy."""
    scene = evaluator.scene
    departures = tuple(k * config.period_s for k in _DEPARTURES)
    yield "stay at the start", None, (0.0,)
    for goal in scene.goals:
        for q in goal.configurations:
            yield (
                f"go to {goal.name} on a straight line",
                scene.start + scene.arm.difference(scene.start, q),
                departures,
            )
    rng = np.random.default_rng(seed)
    lower, upper = scene.arm.chain.lower, scene.arm.chain.upper
    for _ in range(_PLACES):
        place = np.clip(scene.start + rng.uniform(-_SPREAD_RAD, _SPREAD_RAD, len(lower)), lower, upper)
        yield "leave for " + " ".join(f"{angle:.2f}" for angle in place), place, departures


def _least_distance(
    evaluator: RunEvaluator, config: ReplannerConfig, target: FloatArray | None, departure_s: float
) -> float:
    """Return the least distance to the human; minus infinity where table or an object is in the way."""
    scene = evaluator.scene
    trajectory = at_rest(scene.start, departure_s)
    if target is not None:
        trajectory = _timed(scene.start, target, evaluator, config, departure_s)
        spheres = scene.arm.spheres()
        centres = spheres.world_m(scene.arm.chain, trajectory.q)
        for obstacle in (*scene.obstacles, *scene.arm.fixed_obstacles):
            if (obstacle.shape.distance(centres) - spheres.radius_m).min() < 0.0:
                return -np.inf
    return evaluator.meter.measure(trajectory.sample(evaluator.t_s)[0]).least_m


def _timed(
    start: FloatArray, target: FloatArray, evaluator: RunEvaluator, config: ReplannerConfig, departure_s: float
) -> TimedTrajectory:
    limit = config.velocity_scale * evaluator.scene.arm.chain.velocity_limit
    acceleration = np.broadcast_to(np.asarray(config.acceleration_limit, dtype=np.float64), limit.shape)
    rest = np.zeros(len(start))
    path = straight(start, target, _WAYPOINTS)
    return time_parameterise(path, limit, acceleration, rest, rest, config.sample_period_s, departure_s)
