"""The way between the two ends of a reach: how far each DoF may go, how much people vary it, and what to begin with.

P2 bounds each DoF by what the demonstrations did, with margins (docs/papers.md, "P2 prediction"). For the pelvis these
are bounds in the room. People stand elsewhere from reach to reach, so such bounds say where they stood rather than how
far a reach moves them: P2's seven people stay within 0.01 m of the way from their first to their last place and stood
0.2 m apart, and a planner lets the trunk drift through that room. Bounds relative to the ends of the reach say how far
a reach moves people, wherever they stand.

STOMP stays near its first guess, so a good one matters more than good weights. P2 begins with the straight line in
posture space, at constant speed. The angles of a shoulder are no coordinates to go straight in, though: far from small
angles they change a lot where the arm moves little, and the elbow swings out. Turning the shoulder's rotation about one
axis, with minimum-jerk timing, is nearer to what people do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from humanpred_ros.errors import GoalUnreachableError, HumanModelError, MotionError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording

#: A goal that is so far beyond its bounds, in metres or radians, is one that nobody reaches from where the
#: demonstrations happened; people on both sides of P2's table differ by up to 0.9 m and 1.8 rad.
OUT_OF_REACH = 2.0
#: Margins beyond what demonstrations did: of all translations (pelvis, shoulder, lengths of bones), and of rotations
#: of the pelvis.
_TRANSLATION_M, _PELVIS_RAD = 0.02, 0.05
#: Makes a reach (n, J) from start (J,) to goal (J,) at phases (n,) from 0 to 1.
FirstGuess = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
#: The three rotations of the right shoulder, by the names of the 23-DoF and of the 12-DoF human.
SHOULDERS = (("rShoulderY1", "rShoulderX", "rShoulderY2"), ("rShoulderX", "rShoulderZ", "rShoulderY"))
_SAME = 1e-6
#: Closer than this to a rotation where the angles are not unique they change too fast to be followed, rad.
_LOCKED_RAD = 0.05


@dataclass(frozen=True, eq=False)
class PostureBounds:
    """Least and greatest value of each DoF.

    Raises:
        MotionError: arrays that do not fit each other.
    """

    lower: FloatArray  #: (J,) metres and radians
    upper: FloatArray
    #: (J,) rotations without bounds; they may go half a turn beyond both ends of the reach
    free: np.ndarray[tuple[int], np.dtype[np.bool_]]
    dof_names: tuple[str, ...] = ()  #: J names, for messages; none if left out
    #: (2, J) how far a reach may go below the lower and above the upper of its two ends; `lower` and `upper` then only
    #: tell whether a goal is plausible. None to bound by `lower` and `upper`.
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
        cls, recordings: Sequence[ReachRecording], model: HumanModel, *, relative: bool = False
    ) -> PostureBounds:
        """Return the bounds that the reaching people of recordings kept, with margins.

        With `relative` they bound how far a reach leaves the way between its two ends, instead of where it is (not in
        P2).

        Raises:
            MotionError: no recordings.
            HumanModelError: recordings of another human.
        """
        if not recordings:
            raise MotionError("posture bounds: wanted at least one recording, got none")
        for recording in recordings:
            model.check_dofs(recording.active.dof_names)
        q = np.concatenate([recording.active.q for recording in recordings])
        slides = model.joints.slides
        free = ~(slides | np.array([name.startswith("PelvisRot") for name in model.dof_names]))
        margin = np.where(free, np.pi, np.where(slides, _TRANSLATION_M, _PELVIS_RAD))
        beyond = _farthest_beyond(recordings) + margin if relative else None
        return cls(q.min(axis=0) - margin, q.max(axis=0) + margin, free, model.dof_names, beyond)

    def around(self, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds (J,) of a reach; they are widened where an end of the reach is beyond them."""
        low, high = np.minimum(start, goal), np.maximum(start, goal)
        if self.beyond is not None:
            below, above = np.where(self.free, np.pi, self.beyond)
            return low - below, high + above
        lower = np.where(self.free, low - np.pi, np.minimum(self.lower, low))
        upper = np.where(self.free, high + np.pi, np.maximum(self.upper, high))
        return lower, upper

    def check_goal(self, name: str, goal: FloatArray) -> tuple[str, ...]:
        """Return sentences on the DoFs of a goal (J,) that are beyond the bounds, each with the reach's name.

        `around` widens the bounds for such a goal, so that what a person did can be predicted.

        Raises:
            GoalUnreachableError: a goal farther away than `OUT_OF_REACH`.
            MotionError: a goal of another shape.
        """
        q = checked(f"{name}: goal", goal, (len(self.lower),), error=MotionError)
        beyond = np.where(self.free, 0.0, np.maximum(self.lower - q, q - self.upper))
        notes = []
        for d in np.flatnonzero(beyond > 0.0):
            dof = self.dof_names[d] if self.dof_names else f"DoF {d}"
            text = f"{name}: goal with {dof} {q[d]:.3f}, demonstrations stay within {self.lower[d]:.3f} to "
            text += f"{self.upper[d]:.3f}"
            if beyond[d] > OUT_OF_REACH:
                raise GoalUnreachableError(
                    f"{text}; wanted a goal within reach, check frame and units or learn from reaches to there"
                )
            notes.append(f"{text}; bounds are widened for it")
        return tuple(notes)


def _farthest_beyond(recordings: Sequence[ReachRecording]) -> FloatArray:
    """Return how far reaches went below and above their two ends at most, (2, J)."""
    found = []
    for recording in recordings:
        q = recording.active.q
        low, high = np.minimum(q[0], q[-1]), np.maximum(q[0], q[-1])
        found.append(np.stack([low - q.min(axis=0), q.max(axis=0) - high]))
    farthest: FloatArray = np.max(found, axis=0)
    return farthest


def posture_variation(recordings: Sequence[ReachRecording]) -> FloatArray:
    """Return how far each DoF (J,) is from a minimum-jerk line between its ends: root mean square, m and rad.

    The median over recordings, so that a lost marker in one of them does not count.

    Raises:
        MotionError: no recordings.
    """
    if not recordings:
        raise MotionError("variation: wanted at least one recording, got none")
    found = []
    for recording in recordings:
        active = recording.active
        done = minimum_jerk((active.t_s - active.t_s[0]) / active.duration_s)
        away = active.q - straight_line(active.q[0], active.q[-1], done)
        found.append(np.sqrt((away**2).mean(axis=0)))
    variation: FloatArray = np.median(found, axis=0)
    return variation


def straight_line(start: FloatArray, goal: FloatArray, phase: FloatArray) -> FloatArray:
    """Return the straight line in posture space at constant speed (P2)."""
    done = phase[:, None]
    line: FloatArray = (1.0 - done) * start + done * goal
    return line


def minimum_jerk(phase: FloatArray) -> FloatArray:
    """Return the share of the way (n,) at phases (n,) with the least integral of squared jerk, at rest at both ends."""
    profile: FloatArray = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    return profile


class ShortShoulder:
    """The straight line with minimum-jerk timing, except for the shoulder, which turns about one fixed axis.

    The shoulder's angles go straight, too, where that turn would end with angles a whole turn off the goal's, or would
    pass close to where two of the angles turn about the same axis.

    Args:
        model: the human.
        joint: its three DoFs, one after the other; the right shoulder if None.

    Raises:
        HumanModelError: a human without such a joint.
    """

    def __init__(self, model: HumanModel, joint: Sequence[str] | None = None) -> None:
        known = [names for names in ((tuple(joint),) if joint else SHOULDERS) if set(names) <= set(model.dof_names)]
        columns = [model.dof_index[name] for name in known[0]] if known else []
        if len(columns) != 3 or columns != list(range(columns[0], columns[0] + 3)):
            raise HumanModelError(
                f"first guess for {model.name}: wanted a joint of three DoFs one after the other, got "
                f"{joint or known}; it has {', '.join(model.dof_names)}"
            )
        axes = model.joints.axis[columns]
        number = np.abs(axes).argmax(axis=1)
        self._columns = np.array(columns)
        self._sign: FloatArray = np.sign(axes[np.arange(3), number])
        self._sequence = "".join("XYZ"[k] for k in number)
        self._proper = bool(number[0] == number[2])
        self._row, self._column = int(number[0]), int(number[2])

    def __call__(self, start: FloatArray, goal: FloatArray, phase: FloatArray) -> FloatArray:
        """Return the reach (n, J) from start (J,) to goal (J,) at phases (n,)."""
        # By rounding the profile may exceed 1 just before the end, which interpolation refuses.
        done = np.clip(minimum_jerk(phase), 0.0, 1.0)
        reach = straight_line(start, goal, done)
        first, last = start[self._columns], goal[self._columns]
        ends = Rotation.from_euler(self._sequence, np.stack([first, last]) * self._sign)
        turned = Slerp([0.0, 1.0], ends)(done)
        # The cosine of the middle angle, or its sine: this element is 1 or -1 where the outer axes coincide.
        if np.abs(turned.as_matrix()[:, self._row, self._column]).max() <= np.cos(_LOCKED_RAD):
            angles = self._continued(turned.as_euler(self._sequence) * self._sign, first)
            if np.abs(angles[-1] - last).max() < _SAME:
                reach[:, self._columns] = angles
        reach[0], reach[-1] = start, goal
        return reach

    def _continued(self, angles: FloatArray, first: FloatArray) -> FloatArray:
        """Return the same rotations (n, 3) by angles that follow from one to the next, beginning near `first`."""
        # Every rotation has two triples of angles, and whole turns.
        middle = -angles[:, 1] if self._proper else np.pi * self._sign[1] - angles[:, 1]
        other = np.stack([angles[:, 0] + np.pi, middle, angles[:, 2] + np.pi], axis=1)
        found = np.empty_like(angles)
        before = first
        for k, pair in enumerate(zip(angles, other, strict=True)):
            near = [triple + 2.0 * np.pi * np.round((before - triple) / (2.0 * np.pi)) for triple in pair]
            apart = [float(np.abs(triple - before).sum()) for triple in near]
            before = found[k] = near[int(np.argmin(apart))]
        return found
