"""What was recorded of each part of a run, as arrays on one time axis, so that no plot decodes messages itself.

Times `t_s` are data time (header stamps) in seconds after the run's origin, the stamp of the first posture.
Every series may be empty: a run that was interrupted at once still has all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid

#: Probabilities travel as float32; what their sum lacks of 1 by rounding is far less than this.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class PostureTrack:
    """The human's postures.

    Attributes:
        t_s: (T,) strictly increasing.
        q: (T, D) metres and radians, in the order of `dof_names`.
        dof_names: D names.
        frame_id: frame of the tracker.
    """

    t_s: FloatArray
    q: FloatArray
    dof_names: tuple[str, ...] = ()
    frame_id: str = ""

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def motion_end_s(self) -> float:
        """Time of the last posture that differs from the one before: trackers may repeat the last posture."""
        moved = np.flatnonzero(np.any(np.diff(self.q, axis=0) != 0.0, axis=1)) if len(self) > 1 else np.zeros(0)
        return float(self.t_s[int(moved[-1]) + 1]) if len(moved) else 0.0


@dataclass(frozen=True)
class PosteriorTrack:
    """The class posterior after each posture.

    Attributes:
        t_s: (T,) strictly increasing.
        labels: C labels of all classes there were, ascending.
        probability: (T, C); each row sums to 1 less the probability that the motion is of no class; 0 of a class while
            it was not among those told.
        goals_m: (C, 3) goal place of each class, world frame; the last one told.
    """

    t_s: FloatArray
    labels: tuple[int, ...]
    probability: FloatArray
    goals_m: FloatArray

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def unknown(self) -> FloatArray:
        """(T,) probability of no class; 0 where the classifier took it for granted that the motion is of one."""
        rest = 1.0 - self.probability.sum(axis=1)
        return np.where(rest > _ROUNDING, np.minimum(rest, 1.0), 0.0)

    @property
    def telling(self) -> NDArray[np.bool_]:
        """(T,) whether it tells classes apart; of a person at rest a posterior is a prior that knows all as equal."""
        if len(self.labels) < 2:
            return np.ones(len(self), dtype=np.bool_)
        told: NDArray[np.bool_] = np.ptp(self.probability, axis=1) > _ROUNDING
        return told

    def movements(self, until_s: float = np.inf) -> tuple[slice, ...]:
        """Return the stretches of posteriors up to `until_s` that tell classes apart without interruption."""
        told = self.telling & (self.t_s <= until_s)
        edges = np.flatnonzero(np.diff(told, prepend=False, append=False)).tolist()
        return tuple(slice(first, end) for first, end in zip(edges[::2], edges[1::2], strict=True))

    def at(self, t_s: float) -> tuple[int, float] | None:
        """Return the most probable class and its probability by the last posterior up to `t_s`, None if none is."""
        k = int(np.searchsorted(self.t_s, t_s + 1e-9, side="right")) - 1
        if k < 0 or not self.telling[k]:
            return None
        best = int(np.argmax(self.probability[k]))
        return self.labels[best], float(self.probability[k, best])


@dataclass(frozen=True)
class OccupancySnapshot:
    """One occupancy as it was published: voxel centres (N, 3) in the world frame and their probabilities (N,)."""

    t_s: float
    centres_m: FloatArray
    probability: FloatArray


@dataclass(frozen=True)
class OccupancyTrack:
    """The predicted occupancies.

    Attributes:
        t_s: (T,) strictly increasing.
        n_voxels: (T,) voxels published.
        expected_voxels: (T,) sum of their probabilities: the expected number of occupied voxels.
        grid: the voxel lattice, None if it was not recorded.
        snapshots: the occupancies that replanning steps were computed on, by time.
        samples: some spread evenly over the human's motion, and some over the time after it, by time.
    """

    t_s: FloatArray
    n_voxels: NDArray[np.int64]
    expected_voxels: FloatArray
    grid: VoxelGrid | None = None
    snapshots: tuple[OccupancySnapshot, ...] = ()
    samples: tuple[OccupancySnapshot, ...] = ()

    def __len__(self) -> int:
        return len(self.t_s)


@dataclass(frozen=True)
class GoalPlan:
    """What a replanning step found for one goal.

    Attributes:
        name: the goal.
        valid: whether the plan can be executed.
        message: "chosen", "candidate", or why it could not be chosen.
        selection_cost: what goals are compared by; NaN if there is none.
        iterations: STOMP iterations done.
        terms: STOMP's cost terms by name.
        human: human occupancy integrated over the path; NaN if not told.
        length: of the path, in configuration distance; NaN if not told.
        warm_start: where the first path came from; empty if not told.
        rest: human occupancy where the arm would stay; NaN if not told.
        task_cost: of the goal itself; NaN if not told.
        alternative: which of the goal's configurations the plan leads to, from 0.
        set_aside: why the goal was not considered whatever its plan costs; empty if it was.
        revived: it was set aside in the step before.
    """

    name: str
    valid: bool
    message: str
    selection_cost: float
    iterations: int
    terms: Mapping[str, float] = field(default_factory=dict)
    human: float = float("nan")
    length: float = float("nan")
    warm_start: str = ""
    rest: float = float("nan")
    task_cost: float = float("nan")
    alternative: int = 0
    set_aside: str = ""
    revived: bool = False

    @property
    def eligible(self) -> bool:
        """Whether the goal could have been chosen."""
        return self.valid and not self.set_aside


@dataclass(frozen=True)
class RecordedDecision:
    """What was recorded of the planner's answer to one occupancy (`planning.decision.Decision` without its paths).

    Attributes:
        t_s: stamp of the occupancy.
        action: replan, keep, hold, evade, missed or arrived.
        step: the planner's number of the replanning step, from 1; -1 where none was computed.
        chosen, previous: goal names, empty if none.
        switched: the chosen goal differs from the previous one.
        reason: the planner's explanation.
        t_switch_s: when the trajectory takes over, NaN if none.
        compute_s: wall time from receiving the occupancy to deciding, NaN if not told.
        goals: what was found for each goal, where a replanning step was computed.
        margin: by how much the chosen goal was cheaper than the next one; NaN if there was none, or it was not told.
    """

    t_s: float
    action: str
    step: int
    chosen: str
    previous: str
    switched: bool
    reason: str
    t_switch_s: float
    compute_s: float
    goals: tuple[GoalPlan, ...] = ()
    margin: float = float("nan")

    @property
    def is_step(self) -> bool:
        """Whether goals were planned to and compared, whatever came of it; at rest at its goal the arm has no step."""
        return bool(self.goals) and self.action != "arrived"

    @property
    def begins_s(self) -> float:
        """When the decision takes effect: at its switch time, or at once."""
        return self.t_s if np.isnan(self.t_switch_s) else self.t_switch_s

    @property
    def plan_of_chosen(self) -> GoalPlan | None:
        """The plan for the chosen goal, None if the decision carries none."""
        return next((goal for goal in self.goals if goal.name == self.chosen), None)


@dataclass(frozen=True)
class RobotTrack:
    """The arm's measured configurations.

    Attributes:
        t_s: (T,) strictly increasing.
        q: (T, J) rad; joints that turn without end may have jumped by full turns, here they have not.
        v: (T, J) rad/s, as reported or, where not, by differences.
        joint_names: J names.
    """

    t_s: FloatArray
    q: FloatArray
    v: FloatArray
    joint_names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.t_s)

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return (N, J) configurations at times (N,), linear between samples; NaN outside the recorded time."""
        q = [np.interp(t_s, self.t_s, column, left=np.nan, right=np.nan) for column in self.q.T]
        return np.stack(q, axis=1) if len(self) else np.full((len(t_s), self.q.shape[1]), np.nan)


@dataclass(frozen=True)
class SentTrajectory:
    """A trajectory sent to the arm's controller: knots (N,) in run time, positions and velocities (N, J)."""

    t_s: FloatArray
    q: FloatArray
    v: FloatArray
    joint_names: tuple[str, ...]


@dataclass(frozen=True)
class Latency:
    """Wall-clock delays between two messages that belong together.

    Attributes:
        name: from what to what.
        t_s: (N,) data time of the posture each began with.
        delay_s: (N,) difference of the times of sending.
    """

    name: str
    t_s: FloatArray
    delay_s: FloatArray

    def __len__(self) -> int:
        return len(self.t_s)
