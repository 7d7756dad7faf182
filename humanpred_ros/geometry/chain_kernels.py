"""Forward kinematics, compiled: frames of the joints of an arm or a person, and places of points fixed to them.

One table describes the joints for every kernel (`Joints.table`). In double precision, one
configuration at a time, joints may form a tree and turn about any axis (`joint_frames`, and what is made of it). In
single precision, for planning, joints follow one another and turn about, or slide along, coordinate axes; 64
configurations are moved at a time, structure of arrays, in one flat scratch array whose rows lie at constant offsets,
so that the compiler can prove that they do not overlap; sines and cosines are polynomials.

Rows of the scratch array (each `BLOCK` long): 0 to 8 rotation of the current joint's frame, row by row; 9 to 11 its
position; then those named below.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import Array, exact, exact_part, fast, fast_inline, fast_part
from humanpred_ros.geometry.joints import AXIS, FIRST, KIND, LAST, ROTATION, SIGN, TURNED, Joints

Scalar: TypeAlias = Any

BLOCK = 64
_SIN, _COS, _ANGLE = 12 * BLOCK, 13 * BLOCK, 14 * BLOCK
#: Where `place` writes the coordinates of a point. What is computed from neighbouring configurations reads one element
#: beyond these rows: the rows before and after belong to nothing else.
X, Y, Z = 17 * BLOCK, 18 * BLOCK, 19 * BLOCK
#: Rows that are free for what is done with the points: the one numbered so, and those from `FREE` on.
BEFORE_X, FREE = 15 * BLOCK, 21

_0, _1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
# pi and its rest below float32, so that reducing an angle of many turns stays exact to float32.
_INV_PI = np.float32(1.0 / np.pi)
_PI_HIGH = np.float32(3.140625)
_PI_LOW = np.float32(np.pi - 3.140625)
# Taylor coefficients; the truncation is below 1e-7 on [-pi/2, pi/2].
_S3, _S5, _S7, _S9, _S11 = (np.float32(c) for c in (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800))
_C2, _C4, _C6 = (np.float32(c) for c in (-1 / 2, 1 / 24, -1 / 720))
_C8, _C10, _C12 = (np.float32(c) for c in (1 / 40320, -1 / 3628800, 1 / 479001600))


@exact_part
def joint_frames(q: FloatArray, joints: Joints, frames: FloatArray) -> None:
    """Write the frames after each joint at q (J,): frames (J + 1, 3, 4), the root's first, which is the identity."""
    parent, table = joints
    for a in range(3):
        for b in range(4):
            frames[0, a, b] = 1.0 if a == b else 0.0
    for j in range(len(table)):
        x, y, z, kind, before = table[j, 0], table[j, 1], table[j, 2], table[j, KIND], parent[j]
        u, v, w = table[j, AXIS], table[j, AXIS + 1], table[j, AXIS + 2]
        f = table[j, ROTATION:TURNED]
        turned, slides = table[j, TURNED] != 0.0, kind == 7.0 or 3.0 <= kind <= 5.0
        if slides:
            u, v, w = q[j] * u, q[j] * v, q[j] * w
            if turned:
                u, v, w = f[0] * u + f[1] * v + f[2] * w, f[3] * u + f[4] * v + f[5] * w, f[6] * u + f[7] * v + f[8] * w
            x, y, z = u + x, v + y, w + z
        # The rotation by q about the axis (Rodrigues), not used where the joint slides.
        s, d = np.sin(q[j]), 1.0 - np.cos(q[j])
        t00, t01, t02 = 1.0 - d * (v * v + w * w), d * u * v - s * w, d * u * w + s * v
        t10, t11, t12 = d * u * v + s * w, 1.0 - d * (u * u + w * w), d * v * w - s * u
        t20, t21, t22 = d * u * w - s * v, d * v * w + s * u, 1.0 - d * (u * u + v * v)
        for row in range(3):
            a, b, c = frames[before, row, 0], frames[before, row, 1], frames[before, row, 2]
            frames[j + 1, row, 3] = a * x + b * y + c * z + frames[before, row, 3]
            if turned:
                a, b, c = a * f[0] + b * f[3] + c * f[6], a * f[1] + b * f[4] + c * f[7], a * f[2] + b * f[5] + c * f[8]
            if not slides:
                a, b, c = a * t00 + b * t10 + c * t20, a * t01 + b * t11 + c * t21, a * t02 + b * t12 + c * t22
            frames[j + 1, row, 0], frames[j + 1, row, 1], frames[j + 1, row, 2] = a, b, c


@exact
def link_poses(q: FloatArray, joints: Joints, link_joint: NDArray[np.int64], T_joint_link: FloatArray) -> FloatArray:
    """Return the poses (T, L, 4, 4) of links in the root's frame, for configurations (T, J).

    Args:
        q: rad and m.
        joints: of an arm or a person.
        link_joint: (L,) number of the joint each link is fixed to.
        T_joint_link: (L, 4, 4) of each link in that joint.
    """
    out = np.empty((len(q), len(link_joint), 4, 4))
    frames = np.empty((len(joints.table) + 1, 3, 4))
    for t in range(len(q)):
        joint_frames(q[t], joints, frames)
        for k in range(len(link_joint)):
            A, B = frames[link_joint[k]], T_joint_link[k]
            for a in range(3):
                for b in range(3):
                    out[t, k, a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
                out[t, k, a, 3] = A[a, 0] * B[0, 3] + A[a, 1] * B[1, 3] + A[a, 2] * B[2, 3] + A[a, 3]
            for b in range(4):
                out[t, k, 3, b] = 1.0 if b == 3 else 0.0
    return out


@exact
def point_positions(q: FloatArray, joints: Joints, joint: NDArray[np.int64], local: FloatArray) -> FloatArray:
    """Return the places (M, P, 3) of points in the root's frame, for configurations (M, J).

    Args:
        q, joints: as in `link_poses`.
        joint: (P,) number of the joint each point is fixed to.
        local: (P, 3) the points in their joints' frames, m.
    """
    out = np.empty((len(q), len(local), 3))
    frames = np.empty((len(joints.table) + 1, 3, 4))
    for m in range(len(q)):
        joint_frames(q[m], joints, frames)
        _write_points(frames, joint, local, out[m])
    return out


@exact_part
def _write_points(frames: FloatArray, joint: NDArray[np.int64], local: FloatArray, out: FloatArray) -> None:
    for k in range(len(local)):
        A, x, y, z = frames[joint[k]], local[k, 0], local[k, 1], local[k, 2]
        for a in range(3):
            out[k, a] = A[a, 0] * x + A[a, 1] * y + A[a, 2] * z + A[a, 3]


@exact
def point_jacobians(q: FloatArray, joints: Joints, joint: NDArray[np.int64], local: FloatArray) -> FloatArray:
    """Return d(point)/d(joint) (M, P, 3, J) of the points of `point_positions`."""
    parent, table = joints
    n_joints = len(table)
    out = np.zeros((len(q), len(local), 3, n_joints))
    frames, points, axis = np.empty((n_joints + 1, 3, 4)), np.empty((len(local), 3)), np.empty(3)
    for m in range(len(q)):
        joint_frames(q[m], joints, frames)
        _write_points(frames, joint, local, points)
        for k in range(len(local)):
            number = joint[k]
            while number > 0:
                A, j = frames[number], number - 1
                for a in range(3):
                    axis[a] = A[a, 0] * table[j, AXIS] + A[a, 1] * table[j, AXIS + 1] + A[a, 2] * table[j, AXIS + 2]
                if table[j, KIND] == 7.0 or 3.0 <= table[j, KIND] <= 5.0:
                    for a in range(3):
                        out[m, k, a, j] = axis[a]
                else:
                    for a in range(3):
                        b, c = (a + 1) % 3, (a + 2) % 3
                        out[m, k, a, j] = axis[b] * (points[k, c] - A[c, 3]) - axis[c] * (points[k, b] - A[b, 3])
                number = parent[j]
    return out


@fast
def point_positions_32(q: Array, table: Array, points: Array) -> Array:
    """Return the places (M, P, 3) of points in the root's frame in single precision, a block at a time.

    Args:
        q: (M, J) configurations, float32.
        table: as in `FlatChain`, of joints that follow one another, of kinds 0 to 5.
        points: (P, 4) in the order of their joints, those of the root first; the last column is not used.
    """
    count, n_joints = q.shape
    out = np.empty((count, len(points), 3), dtype=np.float32)
    w = np.empty(FREE * BLOCK, dtype=np.float32)
    for first in range(0, count, BLOCK):
        for k in range(12):
            for i in range(BLOCK):
                w[k * BLOCK + i] = _1 if k % 4 == 0 and k < 9 else _0
        for j in range(-1, n_joints):
            if j >= 0:
                next_joint(w, q, first, j, table)
                begin, end = int(table[j, FIRST]), int(table[j, LAST])
            else:
                begin, end = 0, int(table[0, FIRST])
            for p in range(begin, end):
                place(w, points[p, 0], points[p, 1], points[p, 2])
                for i in range(min(BLOCK, count - first)):
                    out[first + i, p, 0], out[first + i, p, 1], out[first + i, p, 2] = w[X + i], w[Y + i], w[Z + i]
    return out


@fast_part
def spread(root: Array) -> Array:
    """Repeat the 12 numbers of the root's frame for every configuration of a block."""
    frames = np.empty(12 * BLOCK, dtype=np.float32)
    for k in range(12):
        for i in range(BLOCK):
            frames[k * BLOCK + i] = root[k]
    return frames


@fast_part
def start(w: Array, frames: Array) -> None:
    """Put a block's frames to the root."""
    for i in range(12 * BLOCK):
        w[i] = frames[i]


@fast_part
def next_joint(w: Array, q: Array, first: int, j: int, table: Array) -> None:
    """Carry a block's frames over joint j; its configurations start at row `first` of q.

    Configurations before the first and beyond the last row of q repeat these.
    """
    last = len(q) - 1
    if first >= 0 and first + BLOCK <= len(q):
        flat = q.reshape(-1)
        # Unsigned indices spare the test for counting from the end.
        at, step = np.uint64(first * q.shape[1] + j), np.uint64(q.shape[1])
        for i in range(BLOCK):
            w[_ANGLE + i] = flat[at + np.uint64(i) * step]
    else:
        for i in range(BLOCK):
            w[_ANGLE + i] = q[min(max(first + i, 0), last), j]
    if table[j, SIGN] < _0:
        for i in range(BLOCK):
            w[_ANGLE + i] = -w[_ANGLE + i]
    _translate(w, table[j, 0], table[j, 1], table[j, 2])
    if table[j, TURNED] != _0:
        _turn_fixed(w, table[j, ROTATION:TURNED])
    kind = int(table[j, KIND])
    if kind >= 3:
        _slide(w, kind - 3)
        return
    _sincos(w)
    if kind == 0:
        _rotate_x(w)
    elif kind == 1:
        _rotate_y(w)
    else:
        _rotate_z(w)


@fast_part
def place(w: Array, x: Scalar, y: Scalar, z: Scalar) -> None:
    """Write where a point of the current joint's frame is to rows X, Y, Z."""
    for i in range(BLOCK):
        w[X + i] = w[i] * x + w[BLOCK + i] * y + w[2 * BLOCK + i] * z + w[9 * BLOCK + i]
        w[Y + i] = w[3 * BLOCK + i] * x + w[4 * BLOCK + i] * y + w[5 * BLOCK + i] * z + w[10 * BLOCK + i]
        w[Z + i] = w[6 * BLOCK + i] * x + w[7 * BLOCK + i] * y + w[8 * BLOCK + i] * z + w[11 * BLOCK + i]


@fast_part
def _sincos(w: Array) -> None:
    for i in range(BLOCK):
        x = w[_ANGLE + i]
        turns = np.rint(x * _INV_PI)
        r = (x - turns * _PI_HIGH) - turns * _PI_LOW
        half = turns * _HALF
        sign = _1 - np.float32(4.0) * abs(half - np.rint(half))
        r2 = r * r
        w[_SIN + i] = sign * r * (_1 + r2 * (_S3 + r2 * (_S5 + r2 * (_S7 + r2 * (_S9 + r2 * _S11)))))
        w[_COS + i] = sign * (_1 + r2 * (_C2 + r2 * (_C4 + r2 * (_C6 + r2 * (_C8 + r2 * (_C10 + r2 * _C12))))))


@fast_part
def _translate(w: Array, x: Scalar, y: Scalar, z: Scalar) -> None:
    for k in range(3):
        for i in range(BLOCK):
            w[(9 + k) * BLOCK + i] += (
                w[3 * k * BLOCK + i] * x + w[(3 * k + 1) * BLOCK + i] * y + w[(3 * k + 2) * BLOCK + i] * z
            )


@fast_part
def _slide(w: Array, axis: int) -> None:
    for k in range(3):
        for i in range(BLOCK):
            w[(9 + k) * BLOCK + i] += w[(3 * k + axis) * BLOCK + i] * w[_ANGLE + i]


@fast_part
def _turn_fixed(w: Array, f: Array) -> None:
    for k in range(3):
        for i in range(BLOCK):
            a = w[3 * k * BLOCK + i]
            b = w[(3 * k + 1) * BLOCK + i]
            c = w[(3 * k + 2) * BLOCK + i]
            w[3 * k * BLOCK + i] = a * f[0] + b * f[3] + c * f[6]
            w[(3 * k + 1) * BLOCK + i] = a * f[1] + b * f[4] + c * f[7]
            w[(3 * k + 2) * BLOCK + i] = a * f[2] + b * f[5] + c * f[8]


@fast_inline
def _rotate(w: Array, u: int, v: int) -> None:
    for k in range(3):
        for i in range(BLOCK):
            a = w[(3 * k + u) * BLOCK + i]
            b = w[(3 * k + v) * BLOCK + i]
            w[(3 * k + u) * BLOCK + i] = a * w[_COS + i] + b * w[_SIN + i]
            w[(3 * k + v) * BLOCK + i] = b * w[_COS + i] - a * w[_SIN + i]


@fast_part
def _rotate_x(w: Array) -> None:
    _rotate(w, 1, 2)


@fast_part
def _rotate_y(w: Array) -> None:
    _rotate(w, 2, 0)


@fast_part
def _rotate_z(w: Array) -> None:
    _rotate(w, 0, 1)
