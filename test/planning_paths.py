"""Paths and limits of a PR2 arm that tests of times share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.planning.path import straight
from humanpred_ros.planning.trajectory import TimedTrajectory

#: Half the PR2 arm's velocity limits, as the replanner uses them.
V = np.array([2.088, 2.082, 3.27, 3.3, 3.6, 3.078, 3.6]) * 0.5
A = np.full(7, 4.0)
BOX = 1.5


def a_path(rng: np.random.Generator, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """A smooth path of planner's waypoints within the box, from q: anywhere, or on in the present direction."""
    n = int(rng.integers(20, 110))
    s = np.linspace(0.0, 1.0, n)[:, None]
    path = straight(q, rng.uniform(-1.2, 1.2, 7), n)
    path += np.sin(np.pi * rng.integers(1, 4) * s) * rng.normal(0.0, 0.15, 7)
    if rng.random() < 0.4:
        path += s * (1.0 - s) ** 2 * (v * rng.uniform(0.3, 1.5) - path[-1] + path[0])
    path = np.clip(path, -BOX, BOX)
    path[0] = q
    return path


def rest_of(trajectory: TimedTrajectory, t_s: float, n_waypoints: int) -> NDArray[np.float64]:
    """Return configurations from a time to the end, evenly spaced in time."""
    return trajectory.sample(np.linspace(t_s, trajectory.end_s, n_waypoints))[0]
