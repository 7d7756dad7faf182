"""What a tool pose's tolerances allow, and Levenberg-Marquardt steps towards it, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.chain_kernels import joint_frames
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.geometry.joints import AXIS, KIND, Joints

_DAMPING, _LEAST_DAMPING = 1e-2, 1e-12
_LARGEST_STEP = 0.6  # rad or m
_PULL = 0.3


@exact_part
def _times(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@exact_part
def _vector(R: FloatArray, out: FloatArray) -> None:
    """Write the rotation vector of a rotation, by the largest part of its quaternion (Shepperd 1978)."""
    trace, a = R[0, 0] + R[1, 1] + R[2, 2], 0
    for k in range(1, 3):
        if R[k, k] > R[a, a]:
            a = k
    if trace >= R[a, a]:
        w = 1.0 + trace
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            out[k] = R[j, i] - R[i, j]
    else:
        b, c = (a + 1) % 3, (a + 2) % 3
        w = R[c, b] - R[b, c]
        out[a] = 1.0 + R[a, a] - R[b, b] - R[c, c]
        out[b], out[c] = R[b, a] + R[a, b], R[c, a] + R[a, c]
    if w < 0.0:
        w = -w
        for k in range(3):
            out[k] = -out[k]
    length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    factor = 2.0 * np.arctan2(length, w) / length if length > 0.0 else 2.0 / w
    for k in range(3):
        out[k] *= factor


@exact_part
def _rotation(r: FloatArray, sign: float, out: FloatArray) -> None:
    """Write the rotation by `sign` times a rotation vector (Rodrigues)."""
    angle = np.sqrt(r[0] ** 2 + r[1] ** 2 + r[2] ** 2)
    s = sign * np.sin(angle) / angle if angle > 0.0 else sign
    d = 2.0 * (np.sin(angle / 2.0) / angle) ** 2 if angle > 0.0 else 0.5
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[k, k] = 1.0 - d * (r[i] ** 2 + r[j] ** 2)
        out[i, j] = d * r[i] * r[j] - s * r[k]
        out[j, i] = d * r[i] * r[j] + s * r[k]


@exact_part
def _nearest(T: FloatArray, wanted: FloatArray, tolerance: FloatArray, out: FloatArray, work: FloatArray) -> None:
    """Write the allowed pose that is nearest to T, part by part; `work` (4, 3, 3) is overwritten."""
    turned, A, B, vectors = work[0], work[1], work[2], work[3]
    twist, tilt, shift = vectors[0], vectors[1], vectors[2]
    for i in range(3):
        shift[i] = 0.0
        for j in range(3):
            shift[i] += (T[j, 3] - wanted[j, 3]) * wanted[j, i]
        shift[i] = min(max(shift[i], -tolerance[i]), tolerance[i])
    for i in range(3):
        out[i, 3] = wanted[i, 3] + wanted[i, 0] * shift[0] + wanted[i, 1] * shift[1] + wanted[i, 2] * shift[2]
    _times(wanted[:3, :3].T, T[:3, :3], turned)
    a = 0
    for k in range(1, 3):
        if tolerance[3 + k] > tolerance[3 + a]:
            a = k
    b, c = (a + 1) % 3, (a + 2) % 3
    twist[:] = 0.0
    # With the quaternion's real part w and its part x along a: 4 w x over 2 (w^2 - x^2), the tangent of the twist.
    twist[a] = np.arctan2(turned[c, b] - turned[b, c], turned[b, b] + turned[c, c])
    _rotation(twist, -1.0, A)
    _times(turned, A, B)
    _vector(B, tilt)
    for k in range(3):
        limit = tolerance[3 + k]
        twist[k], tilt[k] = min(max(twist[k], -limit), limit), min(max(tilt[k], -limit), limit)
    _rotation(tilt, 1.0, A)
    _times(wanted[:3, :3], A, B)
    _rotation(twist, 1.0, A)
    _times(B, A, turned)
    out[:3, :3] = turned


@exact_part
def _error(T: FloatArray, nearest: FloatArray, work: FloatArray, out: FloatArray) -> None:
    """Write translation (m) and rotation vector (rad) from T to its nearest allowed pose, world axes."""
    for i in range(3):
        out[i] = nearest[i, 3] - T[i, 3]
    _times(nearest[:3, :3], T[:3, :3].T, work[0])
    _vector(work[0], out[3:])


@exact
def nearest_poses(T: FloatArray, wanted: FloatArray, tolerance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the allowed poses (N, 4, 4) nearest to poses (N, 4, 4), and what is missing to them (N, 6).

    Args:
        T: poses.
        wanted: (4, 4) pose whose axes the tolerances are along.
        tolerance: (6,) m, then rad.
    """
    nearest, missing, work = np.zeros((len(T), 4, 4)), np.empty((len(T), 6)), np.empty((4, 3, 3))
    for t in range(len(T)):
        nearest[t, 3, 3] = 1.0
        _nearest(T[t], wanted, tolerance, nearest[t], work)
        _error(T[t], nearest[t], work, missing[t])
    return nearest, missing


@exact_part
def _step(J: FloatArray, free: FloatArray, error: FloatArray, damping: float, L: FloatArray, step: FloatArray) -> None:
    """Write the damped least-squares step (J,) of the joints that are free, by Cholesky's decomposition."""
    n = J.shape[1]
    y = np.empty(6)
    for i in range(6):
        for k in range(i + 1):
            total = damping if i == k else 0.0
            for j in range(n):
                total += J[i, j] * free[j] * J[k, j]
            for m in range(k):
                total -= L[i, m] * L[k, m]
            L[i, k] = np.sqrt(total) if i == k else total / L[k, k]
    for i in range(6):
        y[i] = error[i]
        for m in range(i):
            y[i] -= L[i, m] * y[m]
        y[i] /= L[i, i]
    for i in range(5, -1, -1):
        for m in range(i + 1, 6):
            y[i] -= L[m, i] * y[m]
        y[i] /= L[i, i]
    for j in range(n):
        step[j] = 0.0
        for i in range(6):
            step[j] += free[j] * J[i, j] * y[i]


@exact
def converge(
    q: FloatArray,
    drawn: NDArray[np.bool_],
    joints: Joints,
    T_last_tool: FloatArray,
    wanted: FloatArray,
    tolerance: FloatArray,
    start: FloatArray,
    endless: NDArray[np.bool_],
    lower: FloatArray,
    upper: FloatArray,
    iterations: int,
    converged: float,
) -> FloatArray:
    """Bring configurations towards a tool pose in place; return the errors left (N, 6), m and rad.

    Args:
        q: (N, J) seeds within the limits, overwritten.
        drawn: (N,) seeds that are pulled towards `start` for half of the iterations.
        joints: of a chain, whose last one carries the tool.
        T_last_tool: (4, 4).
        wanted, tolerance: as in `nearest_poses`.
        start: (J,) what drawn seeds are pulled to.
        endless: (J,) joints that have no limits.
        lower, upper: (J,) limits.
        iterations: most of each seed.
        converged: a seed is left alone once both parts of its error are so small.
    """
    count, n = q.shape
    left, frames = np.empty((count, 6)), np.empty((n + 1, 3, 4))
    tool, nearest, work = np.empty((3, 4)), np.empty((3, 4)), np.empty((4, 3, 3))
    J, L, error, rest = np.empty((6, n)), np.empty((6, 6)), np.empty(6), np.empty(6)
    step, stop, free, axis = np.empty(n), np.empty(n), np.empty(n), np.empty(3)
    table, pulling = joints.table, iterations // 2
    for s in range(count):
        x = q[s]
        for iteration in range(iterations + 1):
            pulled = drawn[s] and iteration < pulling
            if pulled:
                # A drawn seed gives way to the pull, then returns to the tolerances: it slides along the solutions.
                for j in range(n):
                    change = start[j] - x[j]
                    if endless[j]:
                        change = (change + np.pi) % (2.0 * np.pi) - np.pi
                    x[j] += _PULL * (1.0 - iteration / pulling) * change
            joint_frames(x, joints, frames)
            A = frames[n]
            for i in range(3):
                for k in range(4):
                    tool[i, k] = A[i, 0] * T_last_tool[0, k] + A[i, 1] * T_last_tool[1, k] + A[i, 2] * T_last_tool[2, k]
                tool[i, 3] += A[i, 3]
            _nearest(tool, wanted, tolerance, nearest, work)
            _error(tool, nearest, work, error)
            missing_m = error[0] ** 2 + error[1] ** 2 + error[2] ** 2
            missing_rad = error[3] ** 2 + error[4] ** 2 + error[5] ** 2
            if (max(missing_m, missing_rad) <= converged**2 and not pulled) or iteration == iterations:
                break
            for j in range(n):
                A = frames[j + 1]
                for a in range(3):
                    axis[a] = A[a, 0] * table[j, AXIS] + A[a, 1] * table[j, AXIS + 1] + A[a, 2] * table[j, AXIS + 2]
                slides = table[j, KIND] == 7.0 or 3.0 <= table[j, KIND] <= 5.0
                for a in range(3):
                    b, c = (a + 1) % 3, (a + 2) % 3
                    if slides:
                        J[a, j], J[a + 3, j] = axis[a], 0.0
                    else:
                        J[a, j] = axis[b] * (tool[c, 3] - A[c, 3]) - axis[c] * (tool[b, 3] - A[b, 3])
                        J[a + 3, j] = axis[a]
            damping = _DAMPING * (missing_m + missing_rad) + _LEAST_DAMPING
            free[:] = 1.0
            _step(J, free, error, damping, L, step)
            stopped = False
            for j in range(n):
                stop[j] = 0.0
                if not lower[j] < x[j] + step[j] < upper[j]:
                    stop[j], free[j], stopped = min(max(x[j] + step[j], lower[j]), upper[j]) - x[j], 0.0, True
            if stopped:
                for i in range(6):
                    rest[i] = error[i]
                    for j in range(n):
                        rest[i] -= J[i, j] * stop[j]
                _step(J, free, rest, damping, L, step)
                for j in range(n):
                    step[j] += stop[j]
            largest = _LARGEST_STEP
            for j in range(n):
                largest = max(largest, abs(step[j]))
            for j in range(n):
                x[j] = min(max(x[j] + step[j] * (_LARGEST_STEP / largest), lower[j]), upper[j])
        left[s] = error
    return left
