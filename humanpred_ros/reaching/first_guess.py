"""Reaches to begin planning with. STOMP stays near its first guess, so a good one matters more than good weights.

P2 begins with the straight line in posture space, at constant speed. The angles of a shoulder are no coordinates to go
straight in, though: far from small angles they change a lot where the arm moves little, and the elbow swings out.
Turning the shoulder's rotation about one axis, with minimum-jerk timing, is nearer to what people do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel

#: Makes a reach (n, J) from start (J,) to goal (J,) at phases (n,) from 0 to 1.
FirstGuess = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
#: The three rotations of the right shoulder, by the names of the 23-DoF and of the 12-DoF human.
SHOULDERS = (("rShoulderY1", "rShoulderX", "rShoulderY2"), ("rShoulderX", "rShoulderZ", "rShoulderY"))
_SAME = 1e-6
#: Closer than this to a rotation where the angles are not unique they change too fast to be followed, rad.
_LOCKED_RAD = 0.05


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
