"""Can this posture be a person's? Asked of every posture before anything is predicted from it.

A tracker that fails does not fall silent: it sends millimetres, degrees, another person, the same posture for ever, or
a body that jumps through the room. Predicted from, such postures become "nobody is there". So they are refused here,
with a reason, and whoever waits for predictions gets none.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.chain_kernels import link_poses
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.joints import KIND
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.settings import Settings, setting

#: A link whose speed has a limit of its own: all human models of this package have it.
_PELVIS = "pelvis"
#: Units that trackers give lengths in, by how many make a metre; the smallest factor that fits is named.
_UNITS = {100.0: "centimetres", 1000.0: "millimetres"}
#: No length or angle of a person at a table is as large, in m or rad.
_LARGE = 7.0
#: Kinds of joints that slide (`Joints`).
_SLIDES = (3, 4, 5, 7)
#: Postures that are remembered: those of the last while, and the last ones that were new.
_RECENT, _KNOWN = 32, 16
#: Body parts that wander to and fro so long, and so many postures, belong to several people.
_SHAKE_S, _SHAKE_POSTURES = 0.35, 8
#: A way so many times longer than what it gets through is one to and fro.
_TO_AND_FRO = 3.0
#: So many DoFs that used to change in most postures, and stand still together, are a part that the tracker has lost.
_LOST_DOFS, _USED_TO = 3, 15


class PlausibilitySettings(Settings):
    """What a person at a table cannot do.

    A quick reach moves the hand at 3 m/s. Recordings of depth cameras show single frames at up to 11 m/s, which are
    0.19 m at 60 Hz: that is what `jump_m` leaves to noise.
    """

    max_hand_speed_m_s: float = setting(6.0, "faster hands are jumps of the tracker", unit="m/s", low=0.1)
    max_pelvis_speed_m_s: float = setting(3.0, "a pelvis faster than this is a jump", unit="m/s", low=0.1)
    shake_m: float = setting(
        0.04, "parts that go to and fro by more than this per posture belong to two people", unit="m", low=0.0
    )
    jump_m: float = setting(0.25, "shorter steps are never jumps, however short the time", unit="m", low=0.0)
    limit_slack_rad: float = setting(0.3, "angles may exceed the human model's limits by this", unit="rad", low=0.0)
    limit_slack_m: float = setting(0.1, "lengths may exceed the human model's limits by this", unit="m", low=0.0)
    frozen_s: float = setting(
        0.5, "a posture that stays the same for so long is a tracker that has stopped", unit="s", low=0.05
    )
    frozen_change: float = setting(1e-6, "smaller changes of every DoF are none", low=0.0)
    settle_s: float = setting(0.3, "after a refusal, so long without one is believed again", unit="s", low=0.0)


@dataclass(frozen=True)
class Refusal:
    """Why a posture is not believed."""

    #: a word or two, to count by: "units", "joint limit", "outside the lattice", "jump", "two people", "frozen"
    kind: str
    detail: str  #: what was wanted and what came

    def __str__(self) -> str:
        return f"{self.kind}: {self.detail}"


class PlausibilityCheck:
    """Judges one stream of postures, one after the other.

    Every posture is compared with those before it, believed or not: two people on one topic are a jump each time, and
    are never believed, while a person who was lost and found somewhere else is believed after `settle_s`. So is what
    follows a posture that was refused for another reason.
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
        # Links at one place, such as those between the axes of a shoulder, are one.
        zero = np.clip(np.zeros(len(human.dof_names)), human.lower, human.upper)
        _, self._links = np.unique(human.link_poses(zero)[:, :3, 3].round(9), axis=0, return_index=True)
        pelvis = human.link_names.index(_PELVIS)
        self._links = np.array([pelvis, *(k for k in self._links if k != pelvis)])
        self._joint, self._T_joint = human.link_joint[self._links], human.T_joint_link[self._links]
        self._most_m_s = np.full(len(self._links), self.settings.max_hand_speed_m_s)
        self._most_m_s[0] = self.settings.max_pelvis_speed_m_s
        self.start()

    def start(self) -> None:
        """Forget what was seen."""
        #: Stamps and places of the links (L, 3), the pelvis first.
        self._recent: deque[tuple[float, FloatArray]] = deque(maxlen=_RECENT)
        self._settled_s, self._doubt = -np.inf, ""
        self._forget_change()

    def _forget_change(self) -> None:
        n = len(self.human.dof_names)
        self._known, self._next = np.full((_KNOWN, n), np.nan), 0
        self._new_s = -np.inf
        self._q: FloatArray | None = None
        self._changed_s, self._changes = np.full(n, -np.inf), np.zeros(n, dtype=np.int64)

    def unread(self, t_s: float, kind: str) -> None:
        """Take note of a posture that could not be read, or is in no known frame."""
        self._settled_s, self._doubt = t_s + self.settings.settle_s, kind

    def refusal(self, q: FloatArray, t_s: float, held: bool = False) -> Refusal | None:
        """Return why a posture is not to be believed, or None.

        Args:
            q: (D,) posture, finite.
            t_s: its stamp, later than the last one's.
            held: whether its source says that it repeats the last posture on purpose.
        """
        found = self._beyond_limits(q)
        if found is None:
            places = self._places(q)
            found = self._outside(places[0]) or self._jump(t_s, places)
            self._recent.append((t_s, places))
            frozen = self._frozen(q, t_s, held)
            found = found or frozen
        else:
            self._recent.clear()
        if found is not None:
            self.unread(t_s, found.kind)
            return found
        if t_s < self._settled_s:
            return Refusal(self._doubt, f"believed again after {self.settings.settle_s:g} s without one")
        return None

    def _places(self, q: FloatArray) -> FloatArray:
        """Return where the links are (L, 3), the pelvis first, tracker's frame."""
        poses = link_poses(np.array(q[None]), self.human.joints, self._joint, self._T_joint)
        places: FloatArray = poses[0, :, :3, 3]
        return places

    def _beyond_limits(self, q: FloatArray) -> Refusal | None:
        """Return the joint that is farthest beyond its limits; angles count up to whole turns."""
        if ((q >= self._lower) & (q <= self._upper)).all():
            return None
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
        alike = self._slide == self._slide[worst]
        if np.abs(q[alike]).max() > _LARGE:
            units = _UNITS if self._slide[worst] else {180.0 / np.pi: "degrees"}
            for factor, unit in units.items():
                smaller = np.where(alike, q / factor, np.clip(q, self._lower, self._upper))
                if ((smaller >= self._lower) & (smaller <= self._upper)).all() and not (
                    self._slide[worst] and self._outside(self._places(smaller)[0])
                ):
                    return Refusal("units", f"{text}; in {unit}, perhaps")
        return Refusal("joint limit", text)

    def _outside(self, pelvis_m: FloatArray) -> Refusal | None:
        p = self._T[:3, :3] @ pelvis_m + self._T[:3, 3]
        if ((p >= self._low) & (p <= self._high)).all():
            return None
        return Refusal(
            "outside the lattice",
            f"wanted the pelvis within {_corner(self._low)} to {_corner(self._high)} m, world frame, got {_corner(p)}",
        )

    def _jump(self, t_s: float, places: FloatArray) -> Refusal | None:
        if not self._recent:
            return None
        before_s, before = self._recent[-1]
        step_m = np.sqrt(np.square(places - before).sum(axis=1))
        if step_m.max() <= min(self.settings.shake_m, self.settings.jump_m):
            return None
        allowed_m = np.maximum(self.settings.jump_m, self._most_m_s * (t_s - before_s))
        if not (step_m > allowed_m).any():
            return self._shaking(t_s, places)
        worst = int(np.argmax(step_m - allowed_m))
        return Refusal(
            "jump",
            f"wanted a {self._name(worst)} that moves at most {allowed_m[worst]:.2g} m in {t_s - before_s:.3g} s, got "
            f"{step_m[worst]:.3g} m; two people on one topic, or a tracker that lost the person",
        )

    def _shaking(self, t_s: float, places: FloatArray) -> Refusal | None:
        """Return that some part goes to and fro faster than any body does: people who stand close, in turns."""
        lately = [where for when, where in self._recent if t_s - when <= _SHAKE_S]
        if len(lately) + 1 < _SHAKE_POSTURES:
            return None
        ways = np.array([*lately, places])
        step_m = np.linalg.norm(np.diff(ways, axis=0), axis=2)
        through_m = np.linalg.norm(ways.max(axis=0) - ways.min(axis=0), axis=1)
        shaking = (step_m.mean(axis=0) > self.settings.shake_m) & (step_m.sum(axis=0) > _TO_AND_FRO * through_m)
        if not shaking.any():
            return None
        worst = int(np.argmax(np.where(shaking, step_m.sum(axis=0), 0.0)))
        return Refusal(
            "two people",
            f"wanted a {self._name(worst)} that moves as one body does, got one that goes to and fro by "
            f"{step_m.mean(axis=0)[worst]:.2g} m at each posture",
        )

    def _frozen(self, q: FloatArray, t_s: float, held: bool) -> Refusal | None:
        """Return that postures repeat, or that a part of the body stands still as no part of a body does."""
        s = self.settings
        if held:
            self._forget_change()
        if self._q is None:
            self._changed_s[:] = t_s
        else:
            changed = np.abs(q - self._q) > s.frozen_change
            self._changed_s[changed] = t_s
            self._changes[changed] += 1
        self._q = q
        # A posture that was there before is not new, even if others came between.
        alike = np.flatnonzero(np.abs(self._known[:, 0] - q[0]) <= s.frozen_change)
        if not (len(alike) and (np.abs(self._known[alike] - q) <= s.frozen_change).all(axis=1).any()):
            self._known[self._next % _KNOWN], self._next, self._new_s = q, self._next + 1, t_s
        if t_s - self._new_s >= s.frozen_s:
            return Refusal("frozen", f"wanted postures that change, got the same ones for {t_s - self._new_s:.1f} s")
        # Joints stand still at their limits; those that a tracker does not see never changed.
        lost = (self._changed_s <= t_s - s.frozen_s) & (self._changes >= _USED_TO)
        if not lost.any():
            return None
        lost &= (q > self.human.lower + s.frozen_change) & (q < self.human.upper - s.frozen_change)
        if lost.sum() < _LOST_DOFS:
            return None
        names = ", ".join(name for name, gone in zip(self.human.dof_names, lost, strict=True) if gone)
        return Refusal("frozen", f"wanted joints that change, got the same {names} for {s.frozen_s:g} s and more")

    def _name(self, k: int) -> str:
        return str(self.human.link_names[self._links[k]]).replace("_", " ")


def _into(q: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return angles moved by the whole turns that bring them nearest to the middle of their limits."""
    middle = 0.5 * (lower + upper)
    turned: FloatArray = q - 2.0 * np.pi * np.round((q - middle) / (2.0 * np.pi))
    return turned


def _corner(p: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in p) + ")"
