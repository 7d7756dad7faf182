"""What stays the same from step to step: the arm, its goals, what it must keep clear of, its limits and settings."""

from __future__ import annotations

import copy
import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros import plugins
from humanpred_ros.errors import GoalUnreachableError, PlanningError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.motion_check import MotionChecker, SelfClearance
from humanpred_ros.planning.path import reconnect, straight
from humanpred_ros.planning.person import Person, widened
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.stopping import brake_along, stop_trajectory
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory, at_rest
from humanpred_ros.robot.goals import Goal
from humanpred_ros.settings import Settings
from humanpred_ros.stomp.costs import CostTerm, CostTermRequest, HumanOccupancyCost, ObstacleCost
from humanpred_ros.stomp.planner import COMPILED_TERMS, StompPlanner

#: What a timed trajectory may lose of clearance against its path, m, and what it may exceed the joint limits by, rad:
#: corners are rounded off, and what is left of the old velocity leads off the path for a moment.
_SLACK_M, _SLACK_RAD = 0.005, 0.005
#: Limits are written with about ten digits, configurations with six, rad.
_LIMIT_TOLERANCE_RAD = 1e-6
#: Guards tell their factor in whole percents; at less the arm stands.
_LEAST_FACTOR = 0.01

_log = logging.getLogger(__name__)


class Arm(Protocol):
    """What planning needs of a robot's arm of D joints that stands somewhere, such as `robot.arm.Arm`.

    Attributes:
        chain: its kinematics.
    """

    chain: KinematicChain

    def body_points(self) -> BodyPoints:
        """Return points on its surface, which the human occupancy is summed over."""

    def spheres(self) -> BodySpheres:
        """Return spheres that cover what must keep clear."""

    def difference(self, q_from: ArrayLike, q_to: ArrayLike) -> FloatArray:
        """Return the shortest change (..., D) from one configuration to another."""

    def configuration_distance(self, a: ArrayLike, b: ArrayLike) -> FloatArray:
        """Return how far apart configurations are, (...), in the weighted distance of P1."""


class Problem:
    """An arm of D joints, its goals and its surroundings, without the person.

    Attributes:
        config: settings.
        arm, chain: the arm and its kinematics.
        goals: configurations (K, D) of each goal that the arm can rest at, by name; all of it where there is none.
        given: the goals as they were given, with their costs.
        disabled: names of goals that are not planned for.
        blocked: why the arm can rest at no configuration of a goal, by name.
        obstacles: cost of obstacles.
        checker: says what may be executed.
        weights: (D,) configuration distance of a one-radian change of each joint alone (docs/papers.md, 1.12).
        velocity_limit, acceleration_limit: (D,) rad/s, rad/s².
        pool: threads for several goals; None to plan in the caller's.
    """

    def __init__(
        self,
        arm: Arm,
        goals: Sequence[Goal],
        field: SignedDistanceField,
        config: ReplannerConfig,
        self_clearance: SelfClearance | None,
        spared: Collection[str] = (),
    ) -> None:
        """Take arm, goals, signed distance to obstacles and settings; `self_clearance` as in `MotionChecker`.

        Raises:
            PlanningError: for no goals, two of one name, or configurations of another arm.
            GoalUnreachableError: for a goal all of whose configurations are outside the joint limits or not free,
                unless its name is among those `spared`.
            UsageError: for a cost term whose name is unknown.
            SettingsError: for a setting that a cost term does not have.
        """
        self.disabled: frozenset[str] = frozenset()
        self.config, self.arm, self.chain = config, arm, arm.chain
        spheres, n = arm.spheres(), arm.chain.n_joints
        self.checker = MotionChecker(arm.chain, spheres, field, config.padding_m - _SLACK_M, self_clearance)
        self.weights = np.array([float(arm.configuration_distance(np.zeros(n), unit)) for unit in np.eye(n)])
        self.velocity_limit = config.velocity_scale * arm.chain.velocity_limit
        self.acceleration_limit = np.minimum(config.acceleration_limit, arm.chain.acceleration_limit)
        self.pool = ThreadPoolExecutor(config.threads) if config.threads > 1 else None
        self._request = CostTermRequest(
            arm.chain, arm.body_points(), spheres, field, config.padding_m, config.stomp, Settings()
        )
        self._classes = self._chosen_classes()
        self._surround(goals, field, spared)

    def changed(
        self,
        config: ReplannerConfig,
        task_costs: Mapping[str, float],
        disabled: Iterable[str],
        goals: Sequence[Goal] | None = None,
        field: SignedDistanceField | None = None,
    ) -> Problem:
        """Return the problem with other settings, with costs of some goals, and with these goals disabled.

        The threads are the same. Goals that are there already and that another field blocks are `blocked`.

        Args:
            config, task_costs, disabled: as said.
            goals: all goals there are to be; as before if absent.
            field: signed distance to obstacles; as before if absent.

        Raises:
            PlanningError: for a goal that there is none of, and as when it is made.
            SceneError: for a cost that is not a number of at least 0.
            GoalUnreachableError: a goal cannot be worked on with these settings, or one that is new or another now.
            SettingsError: for a setting that a cost term does not have.
        """
        known, disabled = {goal.name: goal for goal in self.given}, frozenset(disabled)
        goals, moved = self.given if goals is None else goals, field is not None
        unknown = (task_costs.keys() | disabled) - {goal.name for goal in goals}
        if unknown:
            names = ", ".join(goal.name for goal in goals)
            raise PlanningError(f"tasks: wanted some of {names}, got {', '.join(sorted(unknown))}")
        goals = [replace(goal, task_cost=task_costs.get(goal.name, goal.task_cost)) for goal in goals]
        old = {
            goal.name
            for goal in goals
            if goal.name in known and np.array_equal(goal.configurations, known[goal.name].configurations)
        }
        spared = old if moved else old & self.blocked.keys()
        field = self.checker.field if field is None else field
        if config != self.config:
            other = Problem(self.arm, goals, field, config, self.checker.self_clearance, spared)
        else:
            other = copy.copy(self)
            if moved or len(old) != max(len(goals), len(known)):
                other._surround(goals, field, spared)
            other.given = tuple(goals)
        other.disabled, other.pool = disabled, self.pool
        return other

    @property
    def task_costs(self) -> dict[str, float]:
        """Of each goal, by name."""
        return {goal.name: goal.task_cost for goal in self.given}

    def planner(self, occupancy: Occupancy) -> tuple[StompPlanner, HumanOccupancyCost]:
        """Return the planner for one predicted occupancy, and the cost of the person, which compares goals."""
        near = widened(occupancy, self.config.human_margin_m)
        request = replace(self._request, occupancy=near)
        human = HumanOccupancyCost.build(request)
        terms = [
            human if term is HumanOccupancyCost else self._built(term, request) if isinstance(term, type) else term
            for term in self._terms
        ]
        return StompPlanner(terms, self.chain.lower, self.chain.upper, self.config.stomp), human

    def person(self, occupancy: Occupancy) -> Person:
        """Return the person of one predicted occupancy."""
        return Person(occupancy, self.checker, self.config)

    def timed(self, path: FloatArray, v: FloatArray, a: FloatArray, start_s: float) -> TimedTrajectory:
        """Return a trajectory along a path (N, D) that begins at `start_s` with velocity and acceleration (D,)."""
        limits = self.velocity_limit, self.acceleration_limit
        return time_parameterise(path, *limits, v, a, self.config.sample_period_s, start_s)

    def stopped(self, trajectory: TimedTrajectory, t_s: float, factor: float = 1.0) -> TimedTrajectory:
        """Return a stop along a trajectory from `t_s` on, as short as the arm can make it at a speed factor > 0.

        All times are the controller's, which runs at the factor (`Pace`); accelerations count as the arm feels them.
        """
        factor = max(factor, _LEAST_FACTOR)
        rest = trajectory if factor == 1.0 else trajectory.since(t_s).at_pace(factor)
        return brake_along(rest, t_s, self.acceleration_limit, self.config.sample_period_s).at_pace(1.0 / factor)

    def stopped_from(self, q: ArrayLike, v: ArrayLike, t_s: float, factor: float = 1.0) -> TimedTrajectory:
        """Return a stop from a measured position and velocity (D,) at `t_s`, every joint for itself, as `stopped`.

        An arm faster than it is ever commanded to be was seen to jump: its velocity is not believed. One whose way to
        rest would leave the joint limits rests where it is.
        """
        v = np.clip(v, -self.velocity_limit, self.velocity_limit)
        factor = max(factor, _LEAST_FACTOR)
        limits = self.acceleration_limit, self.velocity_limit
        stop = stop_trajectory(q, v, np.zeros_like(v), *limits, self.config.sample_period_s, t_s)
        outside = (stop.q < self.chain.lower) | (stop.q > self.chain.upper)
        return at_rest(q, t_s) if outside.any() else stop.at_pace(1.0 / factor)

    def not_free(self, trajectory: TimedTrajectory, begin_s: float) -> str:
        """Return why a trajectory must not be executed from `begin_s` on, whoever is there; empty if it may."""
        q = trajectory.q[trajectory.t_s >= begin_s]
        if ((q < self.chain.lower - _SLACK_RAD) | (q > self.chain.upper + _SLACK_RAD)).any():
            return "its trajectory leaves the joint limits"
        trouble = self.checker.first_trouble(trajectory, begin_s)
        return "" if trouble is None else f"its trajectory is not free: {trouble}"

    def outside_limits(self, q: FloatArray) -> str:
        """Return which joint of a configuration (D,) is outside its limits; empty if none is."""
        chain = self.chain
        for joint, value, low, high in zip(chain.joint_names, q, chain.lower, chain.upper, strict=True):
            if not low - _LIMIT_TOLERANCE_RAD <= value <= high + _LIMIT_TOLERANCE_RAD:
                return f"wanted {joint} within {low:.4f} to {high:.4f} rad, got {value:.4f} rad"
        return ""

    def warm_up(self) -> None:
        """Use all that a step is made of once: what compiles at its first use must not cost a step its deadline."""
        q = next(iter(self.goals.values()))[0]
        x, y, z = (float(value) for value in self.checker.reach[0])
        corner = np.zeros((4, 4, 4), dtype=np.float32)
        corner[0, 0, 0] = 1.0
        occupancy = Occupancy(VoxelGrid((x, y, z), 0.05, corner.shape), corner)
        planner, human = self.planner(occupancy)
        path = straight(q, q + 0.1, self.config.stomp.waypoints)
        planner.plan(path, np.random.default_rng(0))
        reconnect(q, path, planner.terms, human, self.weights, self.config.reconnect_step, len(path))
        rest = np.zeros_like(q)
        trajectory = self.timed(path, rest, rest, 0.0)
        middle_s = 0.5 * trajectory.duration_s
        _, v, a = trajectory.sample(middle_s)
        self.timed(path, v, a, 0.0)
        self.stopped(trajectory, middle_s)
        self.not_free(trajectory, 0.0)
        person = self.person(occupancy)
        person.conflict(trajectory, 0.0)
        person.crossing(trajectory, 0.0)
        person.least_gap_m(trajectory, 0.0)
        person.rest_conflict(q)

    def _surround(self, goals: Sequence[Goal], field: SignedDistanceField, spared: Collection[str]) -> None:
        """Take goals and signed distance to obstacles; raises as when it is made."""
        names = [goal.name for goal in goals]
        if not names or len(set(names)) != len(names):
            raise PlanningError(f"replanner: wanted one or more goals of different names, got {names}")
        self.checker = self.checker.against(field)
        self._request = replace(self._request, field=field)
        self.given, self.goals, self.blocked = tuple(goals), dict[str, FloatArray](), dict[str, str]()
        for goal in goals:
            configurations = checked(
                f"goal {goal.name}", goal.configurations, ("K", self.chain.n_joints), error=PlanningError
            )
            reasons = [str(self.outside_limits(q) or self.checker.first_trouble(q[None]) or "") for q in configurations]
            usable = configurations[[not reason for reason in reasons]]
            if not len(usable):
                trouble = f"goal {goal.name}: {'; '.join(dict.fromkeys(reasons))}"
                if goal.name not in spared:
                    raise GoalUnreachableError(
                        f"{trouble}; choose a configuration within the limits and clear of obstacles"
                    )
                self.blocked[goal.name] = trouble
            self.goals[goal.name] = usable if len(usable) else configurations
        self.obstacles = ObstacleCost.build(self._request)
        self._terms: list[CostTerm | type[CostTerm]] = [
            term if term.per_occupancy else self.obstacles if term is ObstacleCost else self._built(term, self._request)
            for term in self._classes
        ]

    def _chosen_classes(self) -> list[type[CostTerm]]:
        """Return the classes of the chosen cost terms."""
        names = self.config.cost_terms
        classes = [plugins.load(plugins.COST_TERMS, name, CostTerm) for name in names]  # type: ignore[type-abstract]
        if set(classes) != COMPILED_TERMS:
            _log.warning(
                "cost terms %s are evaluated one by one, which is slower; only obstacle, human and smoothness without "
                "others run compiled",
                ", ".join(names),
            )
        self._own = {
            term: plugins.settings_of(name, term.settings_type, self.config.cost_term_settings)
            for name, term in zip(names, classes, strict=True)
        }
        return classes

    def _built(self, term: type[CostTerm], request: CostTermRequest) -> CostTerm:
        """Return a term of a class, made with the settings that were given for it."""
        return term.build(replace(request, settings=self._own[term]))
