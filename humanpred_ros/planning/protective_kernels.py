"""The compiled search of `protective_distance`: of all solids of a body and all spheres of an arm, which pair decides.

Everything is in the frame of the postures. Speeds are differences of distances over `STEP_S`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.chain_kernels import joint_frames
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.geometry.joints import Joints

#: Speeds are differences of distances over this time, s.
STEP_S = 1e-3
#: Halvings of the factor's interval.
_HALVINGS = 12
#: Newton's method for an ellipse stops when its steps are so small, as a share; after so many in any case.
_CLOSE, _NEWTON_STEPS = 1e-12, 10
#: The nearest point of a solid follows from the slope of its distance over so much, m.
_SLOPE_M = 1e-5
#: Kinds of solids, and what their sizes are: radius; half lengths; radius, half length; semi-axes, half length.
SPHERE, BOX, CAPSULE, ELLIPTIC_CYLINDER = 0, 1, 2, 3


class Solids(NamedTuple):
    """B solids fixed to the joints of a body."""

    kind: NDArray[np.int64]  #: (B,) as above
    size_m: FloatArray  #: (B, 3) as above
    joint: NDArray[np.int64]  #: (B,) number of the joint each is fixed to
    T_joint_solid: FloatArray  #: (B, 4, 4)


class Spheres(NamedTuple):
    """P spheres fixed to the joints of an arm."""

    joint: NDArray[np.int64]  #: (P,) number of the joint each is fixed to
    local_m: FloatArray  #: (P, 3) centres in the joints' frames
    radius_m: FloatArray  #: (P,)


class Terms(NamedTuple):
    """What is the same for all pairs; metres, seconds."""

    reaction_s: float  #: T_r
    factor: float  #: of the arm's speed at present
    full_stopping_s: float  #: T_s at factor 1
    full_speed_m_s: float  #: of every sphere towards the person at factor 1; NaN: as measured, by the present factor
    fixed_m: float  #: C + Z_d + Z_r
    person_speed_m_s: float  #: v_h where the speed is not known, and at least after speeding up
    person_acceleration_m_s2: float  #: with which it speeds up


class Found(NamedTuple):
    """The pair that decides, and its terms."""

    body: int  #: number of the body
    solid: int  #: number of its solid
    sphere: int  #: number of the sphere
    factor: float  #: largest factor of the arm's speed
    distance_m: float  #: of the pair
    protective_m: float  #: S_p at the present factor
    person_m: float  #: S_h at the present factor
    person_speed_m_s: float  #: towards the arm
    arm_speed_m_s: float  #: towards the person, at present; negative away from it
    least_m: float  #: least distance of all pairs
    body_point_m: tuple[float, float, float]  #: where the solid is nearest to the centre of the sphere
    arm_point_m: tuple[float, float, float]  #: centre of the sphere


@exact_part
def travel_m(speed: float, for_s: float, terms: Terms) -> float:
    """Return S_h: how far a person comes in a time who now moves towards the arm at `speed`.

    They become faster at once, up to `person_speed_m_s`. One who moves away is taken to stand.
    """
    now = max(speed, 0.0)
    most = max(now, terms.person_speed_m_s)
    faster_s = min((most - now) / terms.person_acceleration_m_s2, for_s)
    reached = now + terms.person_acceleration_m_s2 * faster_s
    return 0.5 * (now + reached) * faster_s + reached * (for_s - faster_s)


@exact_part
def _protective_m(factor: float, person_speed: float, full_speed: float, terms: Terms) -> float:
    """Return S_p of a pair at a factor of the arm's speed."""
    stopping_s = factor * terms.full_stopping_s
    travel = travel_m(person_speed, terms.reaction_s + stopping_s, terms)
    return travel + factor * full_speed * (terms.reaction_s + 0.5 * stopping_s) + terms.fixed_m


@exact_part
def _beyond_ellipse(x: float, y: float, a: float, b: float) -> float:
    """Return the signed distance of a point to an ellipse, as `solids._distance_to_ellipse`."""
    u, v = max(abs(x), 1e-9), max(abs(y), 1e-9)
    inside = (x / a) ** 2 + (y / b) ** 2 < 1.0
    t = max(a * u - a * a, b * v - b * b)
    for _ in range(_NEWTON_STEPS):
        c, d = t + a * a, t + b * b
        p, q = (a * u / c) ** 2, (b * v / d) ** 2
        step = (p + q - 1.0) / (2.0 * (p / c + q / d))
        t += step
        if abs(step) <= _CLOSE * (abs(t) + a * b):
            break
    distance = math.hypot(u * t / (t + a * a), v * t / (t + b * b))
    return -distance if inside else distance


@exact_part
def _solid_distance(kind: int, a: float, b: float, c: float, x: float, y: float, z: float) -> float:
    """Return the signed distance of a point of a solid's frame to the solid, as `Shape.distance_m`."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z) - a
    if kind == CAPSULE:
        beyond = max(abs(z) - b, 0.0)
        return math.sqrt(x * x + y * y + beyond * beyond) - a
    if kind == BOX:
        u, v, w = abs(x) - a, abs(y) - b, abs(z) - c
        outside = math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2 + max(w, 0.0) ** 2)
        return outside + min(max(u, v, w), 0.0)
    u = math.sqrt(x * x + y * y) - a if a == b else _beyond_ellipse(x, y, a, b)
    w = abs(z) - c
    return math.sqrt(max(u, 0.0) ** 2 + max(w, 0.0) ** 2) + min(max(u, w), 0.0)


@exact_part
def _distance(solids: Solids, k: int, T: FloatArray, x: float, y: float, z: float) -> float:
    """Return the distance of a point to solid k at the pose T (3, 4)."""
    x, y, z = x - T[0, 3], y - T[1, 3], z - T[2, 3]
    return _solid_distance(
        solids.kind[k],
        solids.size_m[k, 0],
        solids.size_m[k, 1],
        solids.size_m[k, 2],
        T[0, 0] * x + T[1, 0] * y + T[2, 0] * z,
        T[0, 1] * x + T[1, 1] * y + T[2, 1] * z,
        T[0, 2] * x + T[1, 2] * y + T[2, 2] * z,
    )


@exact_part
def _place(T: FloatArray, A: FloatArray, local: FloatArray, out: FloatArray) -> None:
    """Write where a point of the frame A (3, 4) is (3,), seen through the pose T (4, 4)."""
    x = A[0, 0] * local[0] + A[0, 1] * local[1] + A[0, 2] * local[2] + A[0, 3]
    y = A[1, 0] * local[0] + A[1, 1] * local[1] + A[1, 2] * local[2] + A[1, 3]
    z = A[2, 0] * local[0] + A[2, 1] * local[1] + A[2, 2] * local[2] + A[2, 3]
    for a in range(3):
        out[a] = T[a, 0] * x + T[a, 1] * y + T[a, 2] * z + T[a, 3]


@exact_part
def _largest_factor(now: float, best: float, person_speed: float, full_speed: float, terms: Terms) -> float:
    """Return the largest factor at which a pair at a distance keeps S_p; if that is more than `best`, 1."""
    if _protective_m(1.0, person_speed, full_speed, terms) <= now:
        return 1.0
    if _protective_m(0.0, person_speed, full_speed, terms) > now:
        return 0.0
    least, most = 0.0, 1.0
    if best < 1.0:
        if _protective_m(best, person_speed, full_speed, terms) <= now:
            return 1.0
        most = best
    for _ in range(_HALVINGS):
        middle = 0.5 * (least + most)
        if _protective_m(middle, person_speed, full_speed, terms) <= now:
            least = middle
        else:
            most = middle
    return least


@exact
def decisive_pair(
    postures: FloatArray,
    known: NDArray[np.bool_],
    human: Joints,
    solids: Solids,
    T_human_world: FloatArray,
    configurations: FloatArray,
    arm: Joints,
    spheres: Spheres,
    terms: Terms,
) -> Found:
    """Return the pair that allows the least factor, and of several such the one that lacks most.

    Args:
        postures: (K, 2, D) of each body: now, and `STEP_S` later.
        known: (K,) whether the speed of each body is known.
        human, solids: of every body.
        T_human_world: (4, 4) pose of the world in the postures' frame.
        configurations: (2, J) of the arm: now, and `STEP_S` later.
        arm, spheres: of the arm.
        terms: of all pairs.
    """
    n_spheres, n_solids = len(spheres.radius_m), len(solids.kind)
    centres = np.empty((2, n_spheres, 3))
    arm_frames = np.empty((len(arm.table) + 1, 3, 4))
    for t in range(2):
        joint_frames(configurations[t], arm, arm_frames)
        for p in range(n_spheres):
            _place(T_human_world, arm_frames[spheres.joint[p]], spheres.local_m[p], centres[t, p])
    frames = np.empty((2, len(human.table) + 1, 3, 4))
    poses = np.empty((2, 3, 4))
    near = np.empty(3)
    at = (-1, -1, -1)
    best, margin, least = 2.0, np.inf, np.inf
    distance = protective = travel = speed_person = speed_arm = 0.0
    for k in range(len(postures)):
        for t in range(2):
            joint_frames(postures[k, t], human, frames[t])
        for s in range(n_solids):
            T = solids.T_joint_solid[s]
            for t in range(2):
                A = frames[t, solids.joint[s]]
                for a in range(3):
                    for b in range(4):
                        poses[t, a, b] = A[a, 0] * T[0, b] + A[a, 1] * T[1, b] + A[a, 2] * T[2, b]
                    poses[t, a, 3] += A[a, 3]
            for p in range(n_spheres):
                x, y, z = centres[0, p, 0], centres[0, p, 1], centres[0, p, 2]
                here = _distance(solids, s, poses[0], x, y, z)
                later = _distance(solids, s, poses[0], centres[1, p, 0], centres[1, p, 1], centres[1, p, 2])
                arm_speed = (here - later) / STEP_S
                person_speed = terms.person_speed_m_s
                if known[k]:
                    person_speed = (here - _distance(solids, s, poses[1], x, y, z)) / STEP_S
                now = here - spheres.radius_m[p]
                least = min(least, now)
                full_speed = terms.full_speed_m_s
                if np.isnan(full_speed):
                    full_speed = max(arm_speed, 0.0) / terms.factor
                factor = _largest_factor(now, best, person_speed, full_speed, terms)
                present = _protective_m(terms.factor, person_speed, full_speed, terms)
                if factor < best or (factor == best and now - present < margin):
                    best, margin, at = factor, now - present, (k, s, p)
                    distance, protective, speed_person, speed_arm = now, present, person_speed, arm_speed
                    travel = travel_m(person_speed, terms.reaction_s + terms.factor * terms.full_stopping_s, terms)
                    near[0] = x - here * (_distance(solids, s, poses[0], x + _SLOPE_M, y, z) - here) / _SLOPE_M
                    near[1] = y - here * (_distance(solids, s, poses[0], x, y + _SLOPE_M, z) - here) / _SLOPE_M
                    near[2] = z - here * (_distance(solids, s, poses[0], x, y, z + _SLOPE_M) - here) / _SLOPE_M
    p = at[2]
    return Found(
        at[0],
        at[1],
        p,
        best,
        distance,
        protective,
        travel,
        speed_person,
        speed_arm,
        least,
        (near[0], near[1], near[2]),
        (centres[0, p, 0], centres[0, p, 1], centres[0, p, 2]),
    )
