"""Whether a movement is free between its waypoints too: knots that are free can have a cup between them.

The check is a proof, not a denser sampling. True distances are 1-Lipschitz: a sphere with clearances d0 and d1
at two moments, which travels at most w from one to the other, keeps at least (d0 + d1 - w) / 2 in between. The
way is bounded by what the joints turn in that time times the sphere's lever arms. Where that does not prove
the padding, the time in doubt is halved, down to ways of `resolution_m`.

Movements come as Bézier curves of degree 5: a piece is (6, D), control points of every joint's angle. A joint turns by
at most the sum of their steps.

What is proven is about the spheres, which cover the arm and stick out by 8 mm on average and 0.06 m at most,
and about the distance field's values: its interpolation error at single configurations carries over, no more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.chain import BodySpheres, KinematicChain, reach_m
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice_kernels import Lattice
from humanpred_ros.planning.motion_kernels import SphereArm, search
from humanpred_ros.planning.trajectory import TimedTrajectory

#: What a trouble is with: names of `Trouble.what`.
OBSTACLE, SELF = "obstacle", "self"
#: Ways shorter than this are not halved any more, m: clearances within half of it of the padding count as
#: trouble though they may be none.
DEFAULT_RESOLUTION_M = 0.002

SelfClearance = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Trouble:
    """Where a movement first cannot be shown to be free."""

    what: str  #: "obstacle", "self" or the name the checker was given for what it keeps away from
    #: seconds of the trajectory's clock; of a path, the waypoint's number, fractions between two. Up to there the
    #: clearance is the padding, less the resolution at most.
    at: float
    #: at that moment, of the part of the arm concerned. It may exceed `wanted_m` by up to half the resolution, where
    #: the time around is too short to tell.
    clearance_m: float
    wanted_m: float  #: the padding asked for
    link: str  #: joint whose link comes too close; empty for "self"
    q: FloatArray  #: (D,) configuration at that moment, rad

    def __str__(self) -> str:
        part = f"{self.link} " if self.link else "the arm "
        return f"{part}{self.clearance_m:.3f} m from {self.what} (wanted {self.wanted_m:.3f} m) at {self.at:.3f}"


@dataclass(frozen=True)
class Nearest:
    """How close a movement comes."""

    clearance_m: float  #: least clearance found, m
    at_least_m: float  #: no sphere comes closer at any time; at most the resolution below `clearance_m`
    at: float  #: when, as in `Trouble`
    link: str  #: joint whose link that is


@dataclass(frozen=True, eq=False)
class MotionChecker:
    """Checks movements of one arm against one distance field. Safe to use from several threads.

    Raises:
        PlanningError: for a padding or resolution that makes no sense, or no spheres.
    """

    chain: KinematicChain  #: the arm, and what covers it
    spheres: BodySpheres
    field: SignedDistanceField  #: signed distances, world frame
    padding_m: float = 0.0  #: clearance wanted between spheres and `field`, and of the arm from itself
    #: clearance (T,) of the arm from itself at configurations (T, D), or None; no part of the arm that moves may be
    #: missing from `spheres`, which bound how fast it changes
    self_clearance: SelfClearance | None = None
    what: str = OBSTACLE  #: how troubles call what is in `field`
    resolution_m: float = DEFAULT_RESOLUTION_M  #: see `DEFAULT_RESOLUTION_M`

    def __post_init__(self) -> None:
        if not np.isfinite(self.padding_m) or not (np.isfinite(self.resolution_m) and self.resolution_m > 0.0):
            raise PlanningError(
                f"motion check: wanted a finite padding and a resolution > 0 m, got {self.padding_m} and "
                f"{self.resolution_m}"
            )
        n = self.chain.n_joints
        if len(self.spheres) == 0 or self.spheres.link.max() >= n:
            raise PlanningError(f"motion check: wanted spheres on joints 0 to {n - 1}, got {self.spheres.link}")

    @cached_property
    def _arm(self) -> SphereArm:
        spheres, n = self.spheres, self.chain.n_joints
        order = np.argsort(spheres.link, kind="stable")
        return SphereArm(
            self.chain.joints,
            spheres=np.column_stack([spheres.local_m, spheres.radius_m])[order],
            first=np.searchsorted(spheres.link[order], np.arange(n + 1)).astype(np.int64),
            lever=lever_arms_m(self.chain, spheres)[:, order],
        )

    @cached_property
    def reach(self) -> tuple[FloatArray, float]:
        """Centre (3,) and radius of a ball that the spheres never leave, world frame, metres."""
        return reach_m(self.chain, self.spheres)

    def against(self, field: SignedDistanceField, **changes: Any) -> MotionChecker:
        """Return the same check against another field, with other attributes than `chain` and `spheres`; cheap."""
        other = replace(self, field=field, **changes)
        other.__dict__["_arm"] = self._arm  # the same one
        return other

    def first_trouble(
        self, movement: TimedTrajectory | ArrayLike, begin_s: float = -np.inf, end_s: float | None = None
    ) -> Trouble | None:
        """Return where a movement first lacks the padding, or None.

        Args:
            movement: a trajectory, or a path (N, D) of waypoints joined by straight lines.
            begin_s, end_s: the part of a trajectory that is looked at; all of it if not given.

        Raises:
            PlanningError: for a movement of other joints, an empty path, or times that are NaN.
        """
        pieces, times = self._pieces(movement, begin_s, end_s)
        piece, part, sphere, clearance, _ = self._search(pieces, self.padding_m, find_least=False)
        what, link = self.what, self._link(sphere)
        if piece >= 0:
            pieces = pieces[: piece + 1]  # what comes later does not matter any more
        if self.self_clearance is not None:
            found = _first_self(self.self_clearance, pieces, self._arm.lever, self.padding_m, self.resolution_m)
            if found is not None and (piece < 0 or _between(times, *found[:2]) < _between(times, piece, part)):
                what, link, (piece, part, clearance) = SELF, "", found
        if piece < 0:
            return None
        q = place_on(pieces[piece], part)
        return Trouble(what, _between(times, piece, part), float(clearance), self.padding_m, link, q)

    def nearest(
        self, movement: TimedTrajectory | ArrayLike, begin_s: float = -np.inf, end_s: float | None = None
    ) -> Nearest:
        """Return how close spheres come to what is in `field`; padding plays no part.

        Arguments and errors as in `first_trouble`.
        """
        pieces, times = self._pieces(movement, begin_s, end_s)
        piece, part, sphere, clearance, floor = self._search(pieces, np.inf, find_least=True)
        return Nearest(clearance, floor, _between(times, piece, part), self._link(sphere))

    def gaps_m(self, q: FloatArray) -> FloatArray:
        """Return the least clearance (K,) of any sphere at each of the configurations (K, D)."""
        gaps = self.field.distance(self.spheres.world_m(self.chain, q)) - self.spheres.radius_m
        least: FloatArray = gaps.min(axis=1)
        return least

    def _search(self, pieces: FloatArray, padding_m: float, find_least: bool) -> tuple[int, float, int, float, float]:
        lattice = Lattice(self.field.values, self.field.origin_m, 1.0 / self.field.resolution_m)
        return search(pieces, self._arm, lattice, padding_m, self.resolution_m, find_least)

    def _link(self, sphere: int) -> str:
        return self.chain.joint_names[int(np.searchsorted(self._arm.first, sphere, side="right")) - 1]

    def _pieces(
        self, movement: TimedTrajectory | ArrayLike, begin_s: float, end_s: float | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return a movement as curves (K, 6, D), and the times (K + 1,) between them."""
        n = self.chain.n_joints
        if not isinstance(movement, TimedTrajectory):
            points = checked("path", movement, ("N", n), error=PlanningError)
            if len(points) == 0:
                raise PlanningError("motion check: wanted a path of one or more waypoints, got none")
            points = np.repeat(points, 2, axis=0) if len(points) == 1 else points
            part = np.linspace(0.0, 1.0, 6)[None, :, None]
            return points[:-1, None] * (1.0 - part) + points[1:, None] * part, np.arange(len(points), dtype=np.float64)
        if movement.q.shape[1] != n:
            raise PlanningError(f"motion check: wanted trajectories of {n} joints, got {movement.q.shape[1]}")
        end = movement.end_s if end_s is None else end_s
        if np.isnan(begin_s) or np.isnan(end):
            raise PlanningError(f"motion check: wanted a time to begin and to end, got {begin_s} and {end}")
        begin = max(begin_s, movement.start_s)
        return curves(movement, begin, max(min(end, movement.end_s), begin))


def lever_arms_m(chain: KinematicChain, spheres: BodySpheres) -> FloatArray:
    """Return how far (J, S) each sphere's centre is from each joint's axis at most, in any configuration."""
    lengths = np.linalg.norm(chain.joint_origin_m, axis=1)
    # What lies across the axis of a joint, of the way to the next joint and to the spheres on its own link.
    across = np.zeros(chain.n_joints)
    for j in range(chain.n_joints - 1):
        across[j] = np.linalg.norm(np.cross(chain.joint_origin_m[j + 1], chain.joint_axis[j]))
    lever = np.zeros((chain.n_joints, len(spheres)))
    for k, (link, centre) in enumerate(zip(spheres.link, spheres.local_m, strict=True)):
        lever[link, k] = np.linalg.norm(np.cross(centre, chain.joint_axis[link]))
        beyond = float(np.linalg.norm(centre))
        for j in range(int(link) - 1, -1, -1):
            lever[j, k] = across[j] + beyond
            beyond += lengths[j + 1]
    return lever


def _between(times: FloatArray, piece: int, part: float) -> float:
    return float((1.0 - part) * times[piece] + part * times[piece + 1])


def _first_self(
    clearance: SelfClearance, pieces: FloatArray, lever: FloatArray, padding_m: float, resolution_m: float
) -> tuple[int, float, float] | None:
    """Return piece, part and clearance of the first moment at which the arm is too close to itself.

    All pieces in doubt are halved together, so that the callable is asked for many configurations at once.
    """
    knots = clearance(np.concatenate([pieces[:1, 0], pieces[:, 5]]))
    index = np.arange(len(pieces))
    begin, end = np.zeros(len(pieces)), np.ones(len(pieces))
    left, right = knots[:-1], knots[1:]
    first: tuple[int, float, float] | None = None
    while len(pieces):
        turns = np.abs(np.diff(pieces, axis=1)).sum(axis=1)
        # Two parts of the arm may approach each other, each by its own way.
        way = 2.0 * (turns @ lever).max(axis=1)
        doubtful = ~(0.5 * (left + right - way) >= padding_m)
        # Beyond a trouble that is certain nothing needs to be known; short stretches in doubt are one.
        certain = doubtful & (~(left >= padding_m) | (way <= resolution_m))
        if certain.any():
            k = int(np.argmax(certain))
            at_left = bool(left[k] <= right[k]) or not left[k] >= padding_m
            found = (int(index[k]), float(begin[k] if at_left else end[k]), float(left[k] if at_left else right[k]))
            if first is None or found[:2] < first[:2]:
                first = found
            doubtful[k:] = False
        keep = np.flatnonzero(doubtful)
        if len(keep) == 0:
            return first
        early, late = halves(pieces[keep])
        middle = 0.5 * (begin[keep] + end[keep])
        at_middle = clearance(np.ascontiguousarray(early[:, 5]))
        pieces = np.stack([early, late], axis=1).reshape(-1, 6, pieces.shape[2])
        index = np.repeat(index[keep], 2)
        begin, end = _woven(begin[keep], middle), _woven(middle, end[keep])
        left, right = _woven(left[keep], at_middle), _woven(at_middle, right[keep])
    return first


def _woven(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.stack([a, b], axis=1).ravel()


def curves(trajectory: TimedTrajectory, begin_s: float, end_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the control points (K, 6, D) of a stretch of a trajectory, and the times (K + 1,) between them."""
    t = trajectory.t_s
    inner = t[(t > begin_s) & (t < end_s)]
    times = np.concatenate([[begin_s], inner, [end_s]])
    q, v, a = trajectory.sample(times)
    # A part of a quintic is the quintic that agrees with it at both ends. The knots' own numbers are exact;
    # at the very end `sample` gives rest, which is the last knot.
    h = np.diff(times)[:, None]
    q0, v0, a0, q1, v1, a1 = q[:-1], v[:-1] * h, a[:-1] * h * h, q[1:], v[1:] * h, a[1:] * h * h
    controls = [
        q0, q0 + v0 / 5.0, q0 + 0.4 * v0 + a0 / 20.0,
        q1 - 0.4 * v1 + a1 / 20.0, q1 - v1 / 5.0, q1,
    ]  # fmt: skip
    return np.ascontiguousarray(np.stack(controls, axis=1)), times


def place_on(piece: FloatArray, part: float) -> FloatArray:
    """Return the configuration (D,) at a part of a piece (6, D)."""
    points = piece
    while len(points) > 1:
        points = (1.0 - part) * points[:-1] + part * points[1:]
    place: FloatArray = points[0]
    return place


def halves(pieces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both halves of pieces (K, 6, D), by de Casteljau."""
    early, late = np.empty_like(pieces), np.empty_like(pieces)
    points = pieces
    for i in range(6):
        early[:, i], late[:, 5 - i] = points[:, 0], points[:, -1]
        points = 0.5 * (points[:, :-1] + points[:, 1:])
    return early, late
