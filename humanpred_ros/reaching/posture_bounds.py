"""How far each DoF of a predicted reach may go: as far as demonstrations did and a little farther (facts section 3).

P2 takes that as places in the room. People stand elsewhere from reach to reach, so such bounds say where they stood
rather than how far a reach moves them: P2's seven people stay within 0.01 m of the way from their first to their last
place and stood 0.2 m apart, and that room is where a planner lets the trunk drift to. Bounds relative to the ends of
the reach say how far it moves them, wherever they stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import GoalUnreachableError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording


@dataclass(frozen=True)
class BoundsConfig:
    """Margins beyond what demonstrations used (facts section 3).

    Attributes:
        translation_m: of all translations: pelvis, shoulder, lengths of the bones.
        pelvis_rad: of the pelvis' rotations.
        rotation_rad: of all other rotations; None leaves them free, as P2 does.
        out_of_reach: a goal that is so far beyond its bounds, in metres or radians, is one that nobody reaches from
            where demonstrations happened; people on both sides of P2's table differ by up to 0.9 m and 1.8 rad.
        relative: bound how far a reach leaves the way between its two ends instead of where it is (not in P2).

    Raises:
        UsageError: margins that are not positive.
    """

    translation_m: float = 0.02
    pelvis_rad: float = 0.05
    rotation_rad: float | None = None
    out_of_reach: float = 2.0
    relative: bool = False

    def __post_init__(self) -> None:
        margins = [self.translation_m, self.pelvis_rad, self.out_of_reach]
        margins += [] if self.rotation_rad is None else [self.rotation_rad]
        if not all(np.isfinite(margin) and margin > 0.0 for margin in margins):
            raise UsageError(f"posture bounds: wanted positive margins, got {', '.join(map(str, margins))}")


@dataclass(frozen=True, eq=False)
class PostureBounds:
    """Least and greatest value of each DoF.

    Attributes:
        lower, upper: (J,) metres and radians.
        free: (J,) rotations without bounds; theirs are half a turn to each side of the reach.
        dof_names: J names, for messages; none if left out.
        out_of_reach: how far beyond its bounds a goal is not believed, in metres or radians.
        beyond: (2, J) how far a reach may go below the lower and above the upper of its two ends, whatever `lower` and
            `upper` say, which then only tell whether a goal is to be believed; None to bound by them.

    Raises:
        MotionError: arrays that do not fit each other.
    """

    lower: FloatArray
    upper: FloatArray
    free: np.ndarray[tuple[int], np.dtype[np.bool_]]
    dof_names: tuple[str, ...] = ()
    out_of_reach: float = BoundsConfig.out_of_reach
    beyond: FloatArray | None = None

    def __post_init__(self) -> None:
        lower = checked("lower bounds", self.lower, ("J",), error=MotionError)
        upper = checked("upper bounds", self.upper, (len(lower),), error=MotionError)
        free = np.array(self.free, dtype=np.bool_)
        if free.shape != lower.shape or not (lower < upper).all():
            raise MotionError(f"posture bounds: wanted lower < upper and as many flags, got {lower}, {upper}, {free}")
        for name, value in (("lower", lower), ("upper", upper), ("free", free)):
            object.__setattr__(self, name, frozen(value))
        if self.beyond is not None:
            beyond = checked("bounds beyond a reach's ends", self.beyond, (2, len(lower)), error=MotionError)
            if not (beyond > 0.0).all():
                raise MotionError(f"posture bounds: wanted room beyond a reach's ends, got {beyond.min()}")
            object.__setattr__(self, "beyond", frozen(beyond))

    @classmethod
    def from_recordings(
        cls, recordings: Sequence[ReachRecording], model: HumanModel, config: BoundsConfig | None = None
    ) -> PostureBounds:
        """Return the bounds that the reaching people of recordings kept, with margins.

        Raises:
            MotionError: no recordings.
            HumanModelError: recordings of another human.
        """
        config = config or BoundsConfig()
        if not recordings:
            raise MotionError("posture bounds: wanted at least one recording, got none")
        for recording in recordings:
            model.check_dofs(recording.active.dof_names)
        q = np.concatenate([recording.active.q for recording in recordings])
        slides = np.abs(model.joints.linear).sum(axis=1) > 0.0
        pelvis = np.array([name.startswith("PelvisRot") for name in model.dof_names])
        free = ~(slides | pelvis) if config.rotation_rad is None else np.zeros(len(slides), dtype=np.bool_)
        margin = np.where(slides, config.translation_m, config.pelvis_rad)
        if config.rotation_rad is not None:
            margin = np.where(slides | pelvis, margin, config.rotation_rad)
        margin = np.where(free, np.pi, margin)
        beyond = _farthest_beyond(recordings) + margin if config.relative else None
        return cls(q.min(axis=0) - margin, q.max(axis=0) + margin, free, model.dof_names, config.out_of_reach, beyond)

    def around(self, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds (J,) of a reach: both ends are allowed, wherever they are.

        A reach may begin or end beyond what demonstrations did; bounds then give way.
        """
        low, high = np.minimum(start, goal), np.maximum(start, goal)
        if self.beyond is not None:
            below, above = np.where(self.free, np.pi, self.beyond)
            return low - below, high + above
        lower = np.where(self.free, low - np.pi, np.minimum(self.lower, low))
        upper = np.where(self.free, high + np.pi, np.maximum(self.upper, high))
        return lower, upper

    def check_goal(self, name: str, goal: FloatArray) -> tuple[str, ...]:
        """Return sentences on the DoFs of a goal (J,) that are beyond the bounds, each with the reach's name.

        `around` lets bounds give way to such a goal, so that what a person did can be predicted; who asks for the
        prediction should know.

        Raises:
            GoalUnreachableError: a goal much farther away than demonstrations went.
            MotionError: a goal of another shape.
        """
        q = checked(f"{name}: goal", goal, (len(self.lower),), error=MotionError)
        beyond = np.where(self.free, 0.0, np.maximum(self.lower - q, q - self.upper))
        said = []
        for d in np.flatnonzero(beyond > 0.0):
            dof = self.dof_names[d] if self.dof_names else f"DoF {d}"
            text = f"{name}: goal with {dof} {q[d]:.3f}, demonstrations stay within {self.lower[d]:.3f} to "
            text += f"{self.upper[d]:.3f}"
            if beyond[d] > self.out_of_reach:
                raise GoalUnreachableError(
                    f"{text}; wanted a goal within reach, check frame and units or learn from reaches to there"
                )
            said.append(f"{text}; bounds are widened for it")
        return tuple(said)


def _farthest_beyond(recordings: Sequence[ReachRecording]) -> FloatArray:
    """Return how far reaches went below and above their two ends at most, (2, J)."""
    found = []
    for recording in recordings:
        q = recording.active.q
        low, high = np.minimum(q[0], q[-1]), np.maximum(q[0], q[-1])
        found.append(np.stack([low - q.min(axis=0), q.max(axis=0) - high]))
    farthest: FloatArray = np.max(found, axis=0)
    return farthest
