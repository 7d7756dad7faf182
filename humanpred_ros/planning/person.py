"""The person as the planner sees them in one occupancy: a cost to come near, and a distance never to go below.

The cost is soft: how much predicted occupancy a path meets, widened by a margin. It prefers one path to another
and forbids none. The distance is hard: the arm's covering spheres keep `min_separation_m` from every voxel that
the person occupies for certain (where the body is now), and no path ends, and no arm rests, as close to a voxel
that the person is likely to sweep.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.chain import reach_m
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.person_distance import PersonDistance
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.timing.trajectory import TimedTrajectory
from humanpred_ros.planning.validity.motion_check import MotionChecker, Trouble

#: Distances beyond this many times the separation need not be told apart, and this at least, m.
_CAP_SEPARATIONS, _LEAST_CAP_M = 3.0, 0.2
#: How often a trajectory is held against where the person is likely to be, s, and how much deeper into that an arm
#: may come on its way out, m.
_LOOK_S, _DEEPER_M = 0.02, 0.01


class Person:
    """Where the person is and will be, for one arm; distances are computed when first asked for.

    With a separation of 0 nothing is ever too close.
    """

    def __init__(self, occupancy: Occupancy, checker: MotionChecker, config: ReplannerConfig) -> None:
        """Take the occupancy, and the arm's checker against obstacles for what it knows of the arm."""
        self.occupancy, self._checker, self._config = occupancy, checker, config

    def in_the_way(self, trajectory: TimedTrajectory, begin_s: float, end_s: float | None = None) -> Trouble | None:
        """Return where a trajectory first comes too close to where the person is for certain, or None."""
        return None if self._certain is None else self._certain.first_trouble(trajectory, begin_s, end_s)

    def on_the_way(self, trajectory: TimedTrajectory, begin_s: float) -> str:
        """Return why a trajectory should not be executed: it crosses where the person is likely to be. Else empty.

        An arm that is in such a place already may leave it, never deeper into it. Looked at every 20 ms: being likely
        is no sharp border.
        """
        if self._likely is None:
            return ""
        begin = min(begin_s, trajectory.end_s)
        t = np.linspace(begin, trajectory.end_s, max(2, int(np.ceil((trajectory.end_s - begin) / _LOOK_S)) + 1))
        clearance = self.clearance_m(trajectory.sample(t)[0])
        separation = self._config.min_separation_m
        wanted = np.full(len(t), separation)
        if clearance[0] < separation:
            out = clearance >= separation
            wanted[: int(np.argmax(out)) if out.any() else len(t)] = clearance[0] - _DEEPER_M
        lacking = clearance < wanted
        if not lacking.any():
            return ""
        k = int(np.argmax(lacking))
        return (
            f"it crosses where the person is likely (p >= {self._config.likely_probability:g}) to be: "
            f"{clearance[k]:.2f} m at {t[k]:.2f} s"
        )

    def least_gap_m(self, trajectory: TimedTrajectory, begin_s: float) -> float:
        """Return how close a trajectory comes to where the person is for certain."""
        return np.inf if self._certain is None else self._certain.nearest(trajectory, begin_s).clearance_m

    def comes_to(self, q: ArrayLike) -> str:
        """Return why an arm should not rest at `q` (D,): the person is likely to come there. Empty if it may."""
        if self._likely is None:
            return ""
        nearest = self._likely.nearest_on_path(np.atleast_2d(np.asarray(q, dtype=np.float64)))
        if nearest.clearance_m >= self._config.min_separation_m:
            return ""
        return (
            f"the person is likely (p >= {self._config.likely_probability:g}) to come within "
            f"{max(nearest.clearance_m, 0.0):.2f} m of {nearest.link.removesuffix('_joint')} there"
        )

    def clearance_m(self, q: FloatArray) -> FloatArray:
        """Return the distances (K,) of the arm at configurations (K, D) from where the person is likely to be."""
        return self._gaps(self._likely, q)

    def gap_m(self, q: FloatArray) -> FloatArray:
        """Return the distances (K,) of the arm at configurations (K, D) from where the person is for certain."""
        return self._gaps(self._certain, q)

    def _gaps(self, checker: MotionChecker | None, q: FloatArray) -> FloatArray:
        if checker is None:
            return np.full(len(q), np.inf)
        gaps = checker.field.distance(checker.spheres.world_m(checker.chain, q)) - checker.spheres.radius_m
        least: FloatArray = gaps.min(axis=1)
        return least

    @cached_property
    def _certain(self) -> MotionChecker | None:
        return self._beyond(self._config.certain_probability)

    @cached_property
    def _likely(self) -> MotionChecker | None:
        return self._beyond(self._config.likely_probability)

    def _beyond(self, probability: float) -> MotionChecker | None:
        separation = self._config.min_separation_m
        if separation == 0.0:
            return None
        # `voxels_above` is exclusive, the configured probabilities are not.
        voxels = self.occupancy.voxels_above(float(np.nextafter(np.float32(probability), np.float32(0.0))))
        distances = _distances(self.occupancy.grid, self._checker, max(_CAP_SEPARATIONS * separation, _LEAST_CAP_M))
        return self._checker.against(distances.field(voxels), separation, "the person")


@lru_cache(maxsize=4)
def _distances(grid: VoxelGrid, checker: MotionChecker, cap_m: float) -> PersonDistance:
    centre, radius = reach_m(checker.chain, checker.spheres)
    return PersonDistance(grid, centre - radius, centre + radius, cap_m)
