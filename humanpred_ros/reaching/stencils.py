"""The finite differences with which P2 measures how smooth a reach is, and the sampling covariance that follows.

A reach is N postures dt apart, continued on both sides by `PADDING` postures: before its start by what the person did
(or by copies of the first posture), after its end by copies of the last. The rules below are those of P2 (facts
section 4) over offsets -3..+3; they are not centred, which is how the reference values were made.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cholesky_banded, solveh_banded

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.reaching.feature_kernels import REACH
from humanpred_ros.reaching.smooth_noise_kernels import solve_upper

#: First, second and third difference over offsets -3..+3, in units of dt.
VELOCITY_RULE = tuple(c / 6.0 for c in (0.0, 0.0, -2.0, -3.0, 6.0, -1.0, 0.0))
ACCELERATION_RULE = tuple(c / 12.0 for c in (0.0, -1.0, 16.0, -30.0, 16.0, -1.0, 0.0))
JERK_RULE = tuple(c / 12.0 for c in (0.0, 1.0, -17.0, 46.0, -46.0, 17.0, -1.0))
#: One rule for each derivative, as rows of one array (3, 7).
RULES = np.array([VELOCITY_RULE, ACCELERATION_RULE, JERK_RULE])
#: Postures kept of what came before a reach (P2: 6), more than the rules look back.
PADDING = 6


def difference_matrix(rule: FloatArray, n_waypoints: int) -> FloatArray:
    """Return the dense differences (N + 12, N) of a reach alone, every padded row that sees a waypoint included.

    Row r stands at waypoint r - 6; what lies outside the reach counts as zero, so D'D is the quadratic form of a
    change that vanishes outside.
    """
    rows = n_waypoints + 2 * PADDING
    D = np.zeros((rows, n_waypoints))
    for row in range(rows):
        for offset, factor in zip(range(-REACH, REACH + 1), rule, strict=True):
            column = row - PADDING + offset
            if 0 <= column < n_waypoints:
                D[row, column] += factor
    return D


@dataclass(frozen=True, eq=False)
class JerkCovariance:
    """R = D'D of the jerk rule over the N waypoints, and draws of N(0, 1/R) by its banded Cholesky factor.

    Attributes:
        n_waypoints: N.
        factor: (7, N) upper Cholesky factor U, R = U'U, in LAPACK's bands.
    """

    n_waypoints: int
    factor: FloatArray

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """Return smooth noise (R, N, L) of unit scale for `shape` (R, L): x = U^-1 z."""
        rows, width = shape
        white = rng.standard_normal((self.n_waypoints, rows * width))
        drawn = np.empty((rows, self.n_waypoints, width))
        solve_upper(self.factor, white, drawn)
        return drawn


@lru_cache(maxsize=16)
def jerk_covariance(n_waypoints: int) -> JerkCovariance:
    """Return the covariance of reaches with `n_waypoints` waypoints (kept for the next caller).

    Raises:
        MotionError: fewer waypoints than the rules look at.
    """
    if n_waypoints < 2 * REACH + 1:
        raise MotionError(f"sampling: wanted at least {2 * REACH + 1} waypoints, got {n_waypoints}")
    return JerkCovariance(n_waypoints, frozen(cholesky_banded(_bands(n_waypoints))))  # type: ignore[arg-type]


def standard_deviation(n_waypoints: int) -> FloatArray:
    """Return the (N,) standard deviation of unit-scale noise at each waypoint."""
    variance = np.diagonal(solveh_banded(_bands(n_waypoints), np.eye(n_waypoints)))
    deviation: FloatArray = np.sqrt(variance)
    return deviation


def _bands(n_waypoints: int) -> FloatArray:
    D = difference_matrix(np.array(JERK_RULE), n_waypoints)
    R, width = D.T @ D, 2 * REACH
    bands = np.zeros((width + 1, n_waypoints))
    for k in range(width + 1):
        bands[width - k, k:] = np.diagonal(R, k)
    return bands
