"""The figures of one run of the arm beside a person: what it cost, how close it came, and when it arrived."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.planning.decision import EVADE, HOLD, MISSED, REPLAN, Decision
from humanpred_ros.planning.pace import Pace
from humanpred_ros.planning.path import path_integral, path_parameter
from humanpred_ros.planning.trajectory import Schedule, TimedTrajectory
from humanpred_ros.robot.clearance import Separation, SeparationMeter
from humanpred_ros.robot.scene import Scene
from humanpred_ros.stomp.costs import HumanOccupancyCost, as_batch

#: What a unit of configuration distance costs beside the human (docs/papers.md 1.12).
LENGTH_WEIGHT = 0.002
#: Times between the configurations at which costs and clearances are read, s: the arm moves about 1 cm.
SAMPLE_PERIOD_S = 0.01
#: Largest joint error at which a goal counts as reached, rad.
GOAL_TOLERANCE_RAD = 0.02
#: Over this long before a contact it is asked who came closer, s.
_CLOSING_S = 0.1


@dataclass(frozen=True)
class Contact:
    """The first moment at which the arm's spheres touch the human's body in a run."""

    t_s: float  #: data time
    deepest_m: float  #: least distance of the spheres in the whole run, negative
    #: the same for points on the arm's surface. If it is positive, only the spheres, which contain the arm and stick
    #: out by up to 0.06 m, touched, and perhaps not the arm.
    surface_m: float
    robot_link: str  #: parts that touch first
    human_body: str
    closed_by_human_m: float  #: by how much each came closer in the last 0.1 s before
    closed_by_arm_m: float
    moved: str  #: "human", "arm" or "both": who came closer by more than a quarter of the sum


@dataclass(frozen=True)
class RunFigures:
    """One run."""

    scene: str  #: which
    motion: str
    method: str
    seed: int
    #: human occupancy integrated over the executed motion, under P1's final prediction, with 0.002 per unit of its
    #: length (Table I)
    cost: float
    cost_swept: float  #: the same under the voxels that the body really swept
    length: float  #: of the executed motion, configuration distance
    goal: str | None  #: reached at the end, None if none
    time_to_goal_s: float  #: from the human's first posture to rest at the goal; infinite if none is reached
    execution_s: float  #: from the arm's departure to rest; 0 if it never departs
    clearance_m: float  #: least distance of the arm's spheres to table and objects, and which
    clearance_to: str
    least_distance_m: float  #: of the arm's spheres to the human's body at any posture, negative in contact
    least_distance_s: float  #: when
    contact: Contact | None  #: the first, None if there is none
    #: replanning steps; of all decisions, those that sent the arm on, changed its goal, stopped it, and took it out of
    #: the person's way
    steps: int
    replans: int
    switches: int
    holds: int
    evasions: int
    ended: str  #: last decision, with its reason
    step_ms: float  #: median time a replanning step took; machine-dependent
    #: shares of the time from the person's first posture until the arm has reached a goal, or until the last posture,
    #: in which a guard let it move more slowly, and not at all
    slowed: float = 0.0
    stopped: float = 0.0


class RunEvaluator:
    """Gives the figures of runs of the arm beside one person in one scene."""

    def __init__(
        self, scene: Scene, human: HumanModel, motion: Motion, final: Occupancy, swept: Occupancy, n_held: int
    ) -> None:
        """Take what is the same for all runs.

        Args:
            scene, human, motion: who and where.
            final: P1's prediction after the motion's last posture.
            swept: the voxels the body really swept in the motion.
            n_held: how often the last posture is repeated at the end.
        """
        self.scene, self.human, self.motion = scene, human, motion
        arm = scene.arm
        offsets_ns, postures = motion.timeline(n_held)
        self.t_s: FloatArray = np.array(offsets_ns) * 1e-9
        #: Distances to the postures at `t_s`.
        self.meter = SeparationMeter(arm, human, scene.T_world_human, postures)
        n = arm.chain.n_joints
        self.weights = np.array([float(arm.configuration_distance(np.zeros(n), unit)) for unit in np.eye(n)])
        self._final = HumanOccupancyCost(arm.chain, arm.body_points(), final)
        self._swept = HumanOccupancyCost(arm.chain, arm.body_points(), swept)

    def figures(self, method: str, seed: int, executed: ExecutedMotion, decisions: Sequence[Decision]) -> RunFigures:
        """Return the figures of one run."""
        _, path = executed.samples(SAMPLE_PERIOD_S)
        rest_s = executed.rests_since()
        # Nobody saw what happened after the person's last posture.
        goal = goal_reached(self.scene, executed.q_end) if rest_s <= self.t_s[-1] else None
        until_s = float(self.t_s[-1]) if goal is None else rest_s  # an arm that a guard stopped for good rests, too
        clearance = self.clearance_m(path)
        nearest = min(clearance, key=lambda name: clearance[name])
        # Once both rest, nothing comes closer; the end of the motion counts even if the arm arrives before.
        until = int(np.searchsorted(self.t_s, max(rest_s, self.motion.duration_s))) + 1
        q_arm = executed.at(self.t_s)
        apart = self.meter.measure(q_arm)
        apart = Separation(apart.distance_m[:until], apart.part[:until], apart.body[:until])
        steps = [decision for decision in decisions if decision.goals]
        compute = [decision.compute_s for decision in steps if decision.compute_s > 0.0]
        replans, holds, evasions = (
            sum(decision.action == action and decision.trajectory is not None for decision in decisions)
            for action in (REPLAN, HOLD, EVADE)
        )
        return RunFigures(
            scene=self.scene.name,
            motion=self.motion.name,
            method=method,
            seed=seed,
            cost=executed_cost(self._final, path, self.weights),
            cost_swept=executed_cost(self._swept, path, self.weights),
            length=float(path_parameter(path, self.weights)[-1]),
            goal=goal,
            time_to_goal_s=rest_s if goal is not None else np.inf,
            execution_s=max(0.0, rest_s - executed.departure_s),
            clearance_m=clearance[nearest],
            clearance_to=nearest,
            least_distance_m=apart.least_m,
            least_distance_s=float(self.t_s[np.argmin(apart.distance_m)]),
            contact=self._contact(apart, q_arm),
            steps=len(steps),
            replans=replans,
            switches=sum(decision.switched for decision in decisions),
            holds=holds,
            evasions=evasions,
            ended=f"{decisions[-1].action}: {decisions[-1].reason}" if decisions else "",
            slowed=executed.share(until_s, lambda factor: 0.0 < factor < 1.0),
            stopped=executed.share(until_s, lambda factor: factor == 0.0),
            step_ms=1e3 * float(np.median(compute)) if compute else np.nan,
        )

    def distance_m(self, q: FloatArray, posture: int) -> float:
        """Return the distance of an arm at rest at `q` (D,) to the person in one posture, counted from 0."""
        return float(self.meter.measure(np.repeat(q[None], len(self.t_s), axis=0)).distance_m[posture])

    def clearance_m(self, path: FloatArray) -> dict[str, float]:
        """Return the least distance of the arm's spheres to each of table and objects over a path (N, D), by name."""
        spheres = self.scene.arm.spheres()
        centres = spheres.world_m(self.scene.arm.chain, path)
        return {
            obstacle.name: float((obstacle.distance_m(centres) - spheres.radius_m).min())
            for obstacle in self.scene.obstacles
        }

    def _contact(self, apart: Separation, q_arm: FloatArray) -> Contact | None:
        touching = np.flatnonzero(apart.distance_m <= 0.0)
        if not len(touching):
            return None
        k = int(touching[0])
        # The human moves from one posture to the next while the arm stays, then the arm follows.
        moves = np.arange(int(np.searchsorted(self.t_s, self.t_s[k] - _CLOSING_S)) + 1, k + 1)
        before = self.meter.measure(q_arm).distance_m
        between = self.meter.measure(np.concatenate([q_arm[:1], q_arm[:-1]])).distance_m
        by_human = float((before[moves - 1] - between[moves]).sum())
        by_arm = float((between[moves] - before[moves]).sum())
        total = max(by_human, 0.0) + max(by_arm, 0.0)
        movers = [name for name, by in (("human", by_human), ("arm", by_arm)) if total > 0.0 and by > 0.25 * total]
        surface = self.meter.measure_surface(q_arm).distance_m[: len(apart.distance_m)]
        return Contact(
            t_s=float(self.t_s[k]),
            deepest_m=apart.least_m,
            surface_m=float(surface.min()),
            robot_link=self.scene.arm.link_names[int(self.scene.arm.spheres().link[apart.part[k]])],
            human_body=self.human.bodies[int(apart.body[k])].name,
            closed_by_human_m=by_human,
            closed_by_arm_m=by_arm,
            moved="both" if len(movers) != 1 else movers[0],
        )


def executed_cost(term: HumanOccupancyCost, path: FloatArray, weights: FloatArray) -> float:
    """Return a path's human cost, unweighted, integrated over configuration distance, and 0.002 of its length.

    Args:
        term: the occupancy that counts, as it is, without the margin a planner keeps.
        path: (N, D) densely sampled.
        weights: (D,) of the configuration distance.
    """
    values = term.evaluate(as_batch(path[None]))[0][0].astype(np.float64)
    length = float(path_parameter(path, weights)[-1])
    return float(path_integral(values, path, weights)) + LENGTH_WEIGHT * length


class ExecutedMotion:
    """All that an arm executed, from the trajectories of a run's decisions."""

    def __init__(self, q_start: ArrayLike, begin_s: float = 0.0, pace: Pace | None = None) -> None:
        """Begin with an arm at rest at `q_start` (D,) from `begin_s` on, whose trajectories' time has this pace."""
        self._begin_s, self._pace = float(begin_s), pace or Pace()
        self._schedule = Schedule(q_start, begin_s, forgets=False)

    @classmethod
    def of(
        cls, q_start: ArrayLike, decisions: Iterable[Decision], begin_s: float = 0.0, pace: Pace | None = None
    ) -> ExecutedMotion:
        """Return what was executed of a run's decisions; those that came too late were not."""
        motion = cls(q_start, begin_s, pace)
        for decision in decisions:
            if decision.trajectory is not None and decision.action != MISSED:
                motion.take_over(decision.t_switch_s, decision.trajectory)
        return motion

    def take_over(self, from_s: float, trajectory: TimedTrajectory) -> None:
        """Let a trajectory be executed from `from_s` on, both in the controller's time."""
        self._schedule.add(from_s, trajectory)

    @property
    def departure_s(self) -> float:
        """When the first trajectory that moves takes over; infinite if none does."""
        moving = (
            from_s for from_s, way in self._schedule.entries if way.end_s > from_s and np.ptp(way.q, axis=0).any()
        )
        return next(map(self._pace.reached_s, moving), np.inf)

    @property
    def end_s(self) -> float:
        """Since when the arm rests for good."""
        from_s, last = self._schedule.entries[-1]
        return max(self._begin_s, self._pace.reached_s(max(from_s, last.end_s)))

    @property
    def q_end(self) -> FloatArray:
        """(D,) where it rests then."""
        last: FloatArray = self._schedule.entries[-1][1].q[-1]
        return last

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return the configurations (T, D) at increasing times (T,)."""
        return self._schedule.positions(self._pace.progress(t_s))

    def samples(self, period_s: float) -> tuple[FloatArray, FloatArray]:
        """Return times (T,) at most `period_s` apart from begin to end, all takeovers among them, and q (T, D)."""
        n = max(1, int(np.ceil((self.end_s - self._begin_s) / period_s - 1e-9)))
        even = np.linspace(self._begin_s, self.end_s, n + 1)
        t = np.unique(np.concatenate([even, [self._pace.reached_s(from_s) for from_s, _ in self._schedule.entries]]))
        return t, self.at(t)

    def share(self, until_s: float, which: Callable[[float], bool]) -> float:
        """Return the share of the time up to `until_s` in which the speed factor is such."""
        begins = [min(max(change[0], self._begin_s), until_s) for change in self._pace.changes] + [until_s]
        lasts = np.diff(begins) * [which(factor) for _, _, factor in self._pace.changes]
        return float(lasts.sum() / (until_s - self._begin_s)) if until_s > self._begin_s else 0.0

    def rests_since(self) -> float:
        """Return since when the configuration has been the last one: earlier than `end_s` if the end was repeated."""
        t, q = self.samples(SAMPLE_PERIOD_S)
        moved = np.flatnonzero((np.abs(q - self.q_end) > 1e-9).any(axis=1))
        return float(t[min(moved[-1] + 1, len(t) - 1)]) if len(moved) else self._begin_s


def goal_reached(scene: Scene, q: ArrayLike) -> str | None:
    """Return the goal one of whose configurations the arm is at, None if at none."""
    for goal in scene.goals:
        if (np.abs(scene.arm.difference(q, goal.configurations)).max(axis=-1) <= GOAL_TOLERANCE_RAD).any():
            return goal.name
    return None
