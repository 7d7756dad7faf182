"""Points on a serial chain and their derivatives, compiled: planning for a human moves 100000 postures per prediction.

Positions are computed for 64 postures at a time, structure of arrays, so that the innermost loops vectorise; sines and
cosines are polynomials, in single precision for float32 postures and exact to rounding for float64 ones.

A chain is given as (see `chain_points`):
    kind (J,): 0, 1, 2 for a joint that turns about x, y, z; 3, 4, 5 for one that slides along x, y, z
    sign (J,): -1 where it does so the other way round
    offset (J, 3): from the previous joint's frame to this one's, metres
    first (J + 2,): the points fixed to joint number j (0 is the root) are those from first[j] to first[j + 1]
    local (P, 3): the points in their joints' frames, metres
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part, fast, fast_inline, fast_part

BLOCK = 64
#: Rows of the scratch array, each BLOCK long: rotation (9, row by row), position (3), sine, cosine, angle.
_SIN, _COS, _ANGLE, _ROWS = 12 * BLOCK, 13 * BLOCK, 14 * BLOCK, 15

# Taylor coefficients; on [-pi/2, pi/2] the rest is below 1e-7 (float32) and 1e-16 (float64).
_F0, _F1, _HALF, _FOUR = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(4.0)
_F_INV_PI = np.float32(1.0 / np.pi)
_F_PI_HIGH, _F_PI_LOW = np.float32(3.140625), np.float32(np.pi - 3.140625)
_F3, _F5, _F7, _F9, _F11 = (np.float32(c) for c in (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800))
_F2, _F4, _F6 = (np.float32(c) for c in (-1 / 2, 1 / 24, -1 / 720))
_F8, _F10, _F12 = (np.float32(c) for c in (1 / 40320, -1 / 3628800, 1 / 479001600))


@fast
def positions(
    q: NDArray[Any],
    kind: NDArray[np.int64],
    sign: NDArray[Any],
    offset: NDArray[Any],
    first: NDArray[np.int64],
    local: NDArray[Any],
    single: bool,
) -> NDArray[Any]:
    """Return the points (M, P, 3) of postures (M, J); all arrays of one precision, `single` if that is float32."""
    count, joints = q.shape
    out = np.empty((count, len(local), 3), dtype=q.dtype)
    w = np.empty(_ROWS * BLOCK, dtype=q.dtype)
    for start in range(0, count, BLOCK):
        size = min(BLOCK, count - start)
        for i in range(12 * BLOCK):
            w[i] = 0
        for i in range(BLOCK):
            w[i] = w[4 * BLOCK + i] = w[8 * BLOCK + i] = 1
        _write(w, first[0], first[1], local, out, start, size)
        for j in range(joints):
            if offset[j, 0] != 0 or offset[j, 1] != 0 or offset[j, 2] != 0:
                _shift(w, offset[j, 0], offset[j, 1], offset[j, 2])
            for i in range(BLOCK):  # lanes beyond the end repeat the last posture
                w[_ANGLE + i] = sign[j] * q[start + min(i, size - 1), j]
            if kind[j] < 3:
                if single:
                    _sincos32(w)
                else:
                    _sincos64(w)
            if kind[j] == 0:
                _turn(w, 1, 2)
            elif kind[j] == 1:
                _turn(w, 2, 0)
            elif kind[j] == 2:
                _turn(w, 0, 1)
            elif kind[j] == 3:
                _slide(w, 0)
            elif kind[j] == 4:
                _slide(w, 1)
            else:
                _slide(w, 2)
            _write(w, first[j + 1], first[j + 2], local, out, start, size)
    return out


@fast_inline
def _turn(w: NDArray[Any], a: int, b: int) -> None:
    """Turn about the axis that follows a and b: a towards b."""
    for row in range(3):
        for i in range(BLOCK):
            u, v = w[(3 * row + a) * BLOCK + i], w[(3 * row + b) * BLOCK + i]
            s, c = w[_SIN + i], w[_COS + i]
            w[(3 * row + a) * BLOCK + i] = c * u + s * v
            w[(3 * row + b) * BLOCK + i] = c * v - s * u


@fast_inline
def _slide(w: NDArray[Any], a: int) -> None:
    for row in range(3):
        for i in range(BLOCK):
            w[(9 + row) * BLOCK + i] += w[(3 * row + a) * BLOCK + i] * w[_ANGLE + i]


@fast_part
def _shift(w: NDArray[Any], x: Any, y: Any, z: Any) -> None:
    for row in range(3):
        for i in range(BLOCK):
            w[(9 + row) * BLOCK + i] += (
                w[3 * row * BLOCK + i] * x + w[(3 * row + 1) * BLOCK + i] * y + w[(3 * row + 2) * BLOCK + i] * z
            )


@fast_part
def _write(w: NDArray[Any], low: int, high: int, local: NDArray[Any], out: NDArray[Any], start: int, size: int) -> None:
    for k in range(low, high):
        x, y, z = local[k, 0], local[k, 1], local[k, 2]
        for row in range(3):
            for i in range(size):
                out[start + i, k, row] = w[(9 + row) * BLOCK + i] + (
                    w[3 * row * BLOCK + i] * x + w[(3 * row + 1) * BLOCK + i] * y + w[(3 * row + 2) * BLOCK + i] * z
                )


@fast_part
def _sincos32(w: NDArray[Any]) -> None:
    for i in range(BLOCK):
        x = w[_ANGLE + i]
        turns = np.rint(x * _F_INV_PI)
        r = (x - turns * _F_PI_HIGH) - turns * _F_PI_LOW
        half = turns * _HALF
        flip = _F1 - _FOUR * abs(half - np.rint(half))
        r2 = r * r
        w[_SIN + i] = flip * r * (_F1 + r2 * (_F3 + r2 * (_F5 + r2 * (_F7 + r2 * (_F9 + r2 * _F11)))))
        w[_COS + i] = flip * (_F1 + r2 * (_F2 + r2 * (_F4 + r2 * (_F6 + r2 * (_F8 + r2 * (_F10 + r2 * _F12))))))


@fast_part
def _sincos64(w: NDArray[Any]) -> None:
    for i in range(BLOCK):
        w[_SIN + i] = np.sin(w[_ANGLE + i])
        w[_COS + i] = np.cos(w[_ANGLE + i])


@exact
def jacobians(
    q: FloatArray,
    kind: NDArray[np.int64],
    sign: FloatArray,
    offset: FloatArray,
    first: NDArray[np.int64],
    local: FloatArray,
    points: FloatArray,
) -> FloatArray:
    """Return d(point)/d(DoF) (M, P, 3, J) for postures (M, J) whose points (M, P, 3) are known."""
    count, joints = q.shape
    out = np.zeros((count, len(local), 3, joints))
    axis, origin = np.empty((joints, 3)), np.empty((joints, 3))
    for m in range(count):
        _axes(q[m], kind, sign, offset, axis, origin)
        for j in range(joints):
            for k in range(first[j + 1], len(local)):
                if kind[j] >= 3:
                    for a in range(3):
                        out[m, k, a, j] = axis[j, a]
                else:
                    for a in range(3):
                        b, c = (a + 1) % 3, (a + 2) % 3
                        out[m, k, a, j] = axis[j, b] * (points[m, k, c] - origin[j, c]) - axis[j, c] * (
                            points[m, k, b] - origin[j, b]
                        )
    return out


@exact_part
def _axes(
    q: FloatArray,
    kind: NDArray[np.int64],
    sign: FloatArray,
    offset: FloatArray,
    axis: FloatArray,
    origin: FloatArray,
) -> None:
    """Fill in each joint's axis and origin (J, 3) in the root's frame, for one posture (J,)."""
    R, p = np.eye(3), np.zeros(3)
    for j in range(len(kind)):
        a = kind[j] % 3
        for row in range(3):
            p[row] += R[row, 0] * offset[j, 0] + R[row, 1] * offset[j, 1] + R[row, 2] * offset[j, 2]
            axis[j, row] = sign[j] * R[row, a]
            if kind[j] >= 3:
                p[row] += axis[j, row] * q[j]
            origin[j, row] = p[row]
        if kind[j] < 3:
            b, c = (a + 1) % 3, (a + 2) % 3
            sine, cosine = np.sin(sign[j] * q[j]), np.cos(q[j])
            for row in range(3):
                u, v = R[row, b], R[row, c]
                R[row, b], R[row, c] = cosine * u + sine * v, cosine * v - sine * u
