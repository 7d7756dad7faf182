"""Can this posture be a person's? Asked of every posture before anything is predicted from it.

A tracker that fails does not fall silent: it sends millimetres, degrees, another person, the same posture for ever, or
a body that jumps through the room. Predicted from, such postures become "nobody is there". So they are refused here,
with a reason, and whoever waits for predictions gets none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.joints import KIND
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.settings import Settings, setting

#: Links whose speed is looked at: all human models of this package have them.
_PELVIS, _PALM = "pelvis", "right_palm"
_MM_PER_M = 1000.0
#: No length or angle of a person at a table is as large, in m or rad.
_LARGE = 7.0
#: Kinds of joints that slide (`Joints`).
_SLIDES = (3, 4, 5, 7)


class PlausibilitySettings(Settings):
    """What a person at a table cannot do.

    A quick reach moves the hand at 3 m/s. Recordings of depth cameras show single frames at up to 11 m/s, which are
    0.19 m at 60 Hz: that is what `jump_m` leaves to noise.
    """

    max_hand_speed_m_s: float = setting(6.0, "faster hands are jumps of the tracker", unit="m/s", low=0.1)
    max_pelvis_speed_m_s: float = setting(3.0, "a pelvis faster than this is a jump", unit="m/s", low=0.1)
    jump_m: float = setting(0.25, "shorter steps are never jumps, however short the time", unit="m", low=0.0)
    limit_slack_rad: float = setting(0.3, "angles may exceed the human model's limits by this", unit="rad", low=0.0)
    limit_slack_m: float = setting(0.1, "lengths may exceed the human model's limits by this", unit="m", low=0.0)
    frozen_s: float = setting(
        0.5, "a posture that stays the same for so long is a tracker that has stopped", unit="s", low=0.05
    )
    frozen_change: float = setting(1e-6, "smaller changes of every DoF are none", low=0.0)
    settle_s: float = setting(0.3, "after a jump, so long without one is believed again", unit="s", low=0.0)


@dataclass(frozen=True)
class Refusal:
    """Why a posture is not believed."""

    kind: str  #: a word or two, to count by: "units", "joint limit", "outside the lattice", "jump", "frozen"
    detail: str  #: what was wanted and what came

    def __str__(self) -> str:
        return f"{self.kind}: {self.detail}"


class PlausibilityCheck:
    """Judges one stream of postures, one after the other.

    Every posture is compared with the one before it, believed or not: two people on one topic are a jump each time, and
    are never believed, while a person who was lost and found somewhere else is believed after `settle_s`.
    """

    def __init__(
        self,
        human: HumanModel,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        settings: PlausibilitySettings | None = None,
    ) -> None:
        """Take whose postures come, the lattice (world frame) and where the tracker stands (4, 4)."""
        self.human, self.settings = human, settings or PlausibilitySettings()
        self._T = np.asarray(T_world_human, dtype=np.float64)
        self._low = np.asarray(grid.origin_m)
        self._high = self._low + grid.resolution_m * np.asarray(grid.shape)
        self._slide = np.isin(human.joints.table[:, KIND], _SLIDES)
        slack = np.where(self._slide, self.settings.limit_slack_m, self.settings.limit_slack_rad)
        self._lower, self._upper = human.lower - slack, human.upper + slack
        self.start()

    def start(self) -> None:
        """Forget what was seen."""
        self._last: tuple[float, FloatArray, FloatArray, FloatArray] | None = None
        self._changed_s = self._settled_s = -np.inf

    def refusal(self, q: FloatArray, t_s: float, held: bool = False) -> Refusal | None:
        """Return why a posture is not to be believed, or None.

        Args:
            q: (D,) posture, finite.
            t_s: its stamp, later than the last one's.
            held: whether its source says that it repeats the last posture on purpose.
        """
        found = self._beyond_limits(q)
        if found is not None:
            self._last = None
            self._settled_s = t_s + self.settings.settle_s
            return found
        links = self.human.forward(q)
        pelvis, palm = links[_PELVIS], links[_PALM]
        outside = self._outside(pelvis)
        jump = self._jump(t_s, pelvis, palm)
        if self._last is None or held or np.abs(q - self._last[1]).max() > self.settings.frozen_change:
            self._changed_s = t_s
        self._last = (t_s, q, pelvis, palm)
        if jump is not None:
            self._settled_s = t_s + self.settings.settle_s
        if outside or jump:
            return outside or jump
        if t_s < self._settled_s:
            return Refusal("jump", f"believed again after {self.settings.settle_s:g} s without one")
        if t_s - self._changed_s >= self.settings.frozen_s:
            return Refusal("frozen", f"wanted postures that change, got the same one for {t_s - self._changed_s:.1f} s")
        return None

    def _beyond_limits(self, q: FloatArray) -> Refusal | None:
        """Return the joint that is farthest beyond its limits; angles count up to whole turns."""
        turned = np.where(self._slide, q, _into(q, self.human.lower, self.human.upper))
        beyond = np.maximum(self._lower - turned, turned - self._upper)
        if not (beyond > 0.0).any():
            wild = np.flatnonzero(~self._slide & (np.abs(q) > 4.0 * np.pi))
            if not len(wild):
                return None
            return self._units(q, int(wild[0]))
        worst = int(np.argmax(beyond))
        return self._units(q, worst)

    def _units(self, q: FloatArray, worst: int) -> Refusal:
        name, low, high = self.human.dof_names[worst], self.human.lower[worst], self.human.upper[worst]
        unit = "m" if self._slide[worst] else "rad"
        text = f"wanted {name} within {low:.4g} to {high:.4g} {unit}, got {q[worst]:.4g}"
        smaller = q / _MM_PER_M if self._slide[worst] else np.radians(q)
        alike = self._slide == self._slide[worst]
        if np.abs(q[alike]).max() > _LARGE and ((smaller >= self._lower) & (smaller <= self._upper))[alike].all():
            return Refusal("units", f"{text}; in {'millimetres' if self._slide[worst] else 'degrees'}, perhaps")
        return Refusal("joint limit", text)

    def _outside(self, pelvis_m: FloatArray) -> Refusal | None:
        p = self._T[:3, :3] @ pelvis_m + self._T[:3, 3]
        if ((p >= self._low) & (p <= self._high)).all():
            return None
        return Refusal(
            "outside the lattice",
            f"wanted the pelvis within {_corner(self._low)} to {_corner(self._high)} m, world frame, got {_corner(p)}",
        )

    def _jump(self, t_s: float, pelvis: FloatArray, palm: FloatArray) -> Refusal | None:
        if self._last is None:
            return None
        before_s, _, pelvis_before, palm_before = self._last
        limits = (self.settings.max_pelvis_speed_m_s, self.settings.max_hand_speed_m_s)
        steps = (float(np.linalg.norm(pelvis - pelvis_before)), float(np.linalg.norm(palm - palm_before)))
        for name, step_m, limit in zip(("pelvis", "hand"), steps, limits, strict=True):
            allowed_m = max(self.settings.jump_m, limit * (t_s - before_s))
            if step_m > allowed_m:
                return Refusal(
                    "jump",
                    f"wanted a {name} that moves at most {allowed_m:.2g} m in {t_s - before_s:.3g} s, got "
                    f"{step_m:.3g} m; two people on one topic, or a tracker that lost the person",
                )
        return None


def _into(q: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return angles moved by the whole turns that bring them nearest to the middle of their limits."""
    middle = 0.5 * (lower + upper)
    turned: FloatArray = q - 2.0 * np.pi * np.round((q - middle) / (2.0 * np.pi))
    return turned


def _corner(p: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in p) + ")"
