"""The person as the planner sees them in one occupancy: a cost to come near, and a distance never to go below.

The cost is soft: how much predicted occupancy a path meets, widened by a margin. It prefers one path to another
and forbids none. The distance is hard: the arm's covering spheres keep `min_separation_m` from every voxel that
the person occupies for certain (where the body is now), and no path ends, and no arm rests, as close to a voxel
that the person is likely to sweep.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.motion_check import MotionChecker, Trouble
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.trajectory import Schedule, TimedTrajectory

#: Distances beyond this many times the separation need not be told apart, and this at least, m.
_CAP_SEPARATIONS, _LEAST_CAP_M = 3.0, 0.2
#: How often a trajectory is compared with where the person is likely to be, s, and how much deeper into that an arm
#: may come on its way out, m.
_LOOK_S, _DEEPER_M = 0.02, 0.01
#: An arm that is too close to the person already may come closer by this before it is stopped, m; moments of a
#: stretch at which that is looked at.
_CLOSER_M, _LOOKS = 0.01, 9
#: A voxel whose centre is exactly at the margin counts, whatever rounding says.
_ROUNDING = 1e-9


class Person:
    """Where the person is and will be, for one arm; distances are computed when first asked for.

    With a separation of 0 nothing is ever too close.
    """

    def __init__(self, occupancy: Occupancy, checker: MotionChecker, config: ReplannerConfig) -> None:
        """Take the occupancy, and the arm's checker against obstacles for what it knows of the arm."""
        self.occupancy, self._checker, self._config = occupancy, checker, config

    def conflict(self, trajectory: TimedTrajectory, begin_s: float, end_s: float | None = None) -> Trouble | None:
        """Return where a trajectory first comes too close to where the person is for certain, or None."""
        return None if self._certain is None else self._certain.first_trouble(trajectory, begin_s, end_s)

    def crossing(self, trajectory: TimedTrajectory, begin_s: float) -> str:
        """Return why a trajectory should not be executed: it crosses where the person is likely to be. Else empty.

        An arm that is in such a place already may leave it, never deeper into it. Looked at every 20 ms: being likely
        is no sharp border.
        """
        if self._likely is None:
            return ""
        begin = min(begin_s, trajectory.end_s)
        t = np.linspace(begin, trajectory.end_s, max(2, int(np.ceil((trajectory.end_s - begin) / _LOOK_S)) + 1))
        clearance = self.likely_gap_m(trajectory.sample(t)[0])
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

    def rest_conflict(self, q: ArrayLike) -> str:
        """Return why an arm should not rest at `q` (D,): the person is likely to come there. Empty if it may."""
        if self._likely is None:
            return ""
        nearest = self._likely.nearest(np.atleast_2d(q))
        if nearest.clearance_m >= self._config.min_separation_m:
            return ""
        return (
            f"the person is likely (p >= {self._config.likely_probability:g}) to come within "
            f"{max(nearest.clearance_m, 0.0):.2f} m of {nearest.link.removesuffix('_joint')} there"
        )

    def stop_reason(self, schedule: Schedule, from_s: float, to_s: float) -> str:
        """Return why the robot must stop at once: it would come too close to the person before `to_s`. Else empty.

        An arm that is too close already, because the person came to it, is stopped only if it comes closer itself; one
        that is within them, where nothing tells what is closer, unless it gets out of there.
        """
        for begin_s, end_s, trajectory in schedule.pieces(from_s, to_s):
            if trajectory.end_s <= begin_s:
                continue  # an arm at rest can do nothing by stopping
            trouble = self.conflict(trajectory, begin_s, end_s)
            if trouble is None:
                continue
            here = float(self.certain_gap_m(schedule.state_at(from_s)[0][None])[0])
            coming = self.certain_gap_m(trajectory.sample(np.linspace(begin_s, end_s, _LOOKS))[0])
            closer = float(coming.min()) < min(self._config.min_separation_m, here - _CLOSER_M)
            if closer or coming[-1] <= here < 0.0:
                return f"too close: {trouble}"
        return ""

    def calls_for_replanning(self, schedule: Schedule, t_s: float, t_switch_s: float) -> bool:
        """Return whether what is executed at `t_s` should be replaced as soon as a new plan can take over.

        That is if it comes too close to where the person is, crosses where they are likely to be, or ends there. While
        the answer to the last such danger has not taken over yet, nothing is asked for.
        """
        if schedule.last_from_s > t_s:
            return False
        executing = schedule.at(t_s)
        if self.rest_conflict(executing.q[-1]) or self.conflict(executing, t_switch_s):
            return True
        return executing.end_s > t_s and bool(self.crossing(executing, t_switch_s))

    def likely_gap_m(self, q: FloatArray) -> FloatArray:
        """Return the distances (K,) of the arm at configurations (K, D) from where the person is likely to be."""
        return np.full(len(q), np.inf) if self._likely is None else self._likely.gaps_m(q)

    def certain_gap_m(self, q: FloatArray) -> FloatArray:
        """Return the distances (K,) of the arm at configurations (K, D) from where the person is for certain."""
        return np.full(len(q), np.inf) if self._certain is None else self._certain.gaps_m(q)

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
        centre, radius = self._checker.reach
        cap_m = max(_CAP_SEPARATIONS * separation, _LEAST_CAP_M)
        field = distance_to_voxels(self.occupancy.grid, voxels, centre - radius, centre + radius, cap_m)
        return self._checker.against(field, padding_m=separation, what="the person", self_clearance=None)


def widened(occupancy: Occupancy, margin_m: float) -> Occupancy:
    """Return the occupancy with every voxel as likely as the likeliest within `margin_m` of its centre.

    The arm is then charged for coming closer to the person than the margin. Voxels whose centres are
    farther apart than the margin do not affect each other, so 0 changes nothing.

    Returns:
        The box of the lattice that holds all of it: beyond, everything is 0.

    Raises:
        PlanningError: a margin that is negative or not finite.
    """
    if not 0.0 <= margin_m < np.inf:
        raise PlanningError(f"human margin: wanted a distance >= 0 m, got {margin_m}")
    grid = occupancy.grid
    steps = int(margin_m / grid.resolution_m + _ROUNDING)
    cells = np.stack(np.unravel_index(occupancy.voxels_above(0.0), grid.shape), axis=1)
    if len(cells) == 0:
        cells = np.zeros((1, 3), dtype=np.int64)
    low = np.maximum(cells.min(axis=0) - steps, 0)
    high = np.minimum(cells.max(axis=0) + steps + 1, grid.shape)
    part = occupancy.probability[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    origin = np.asarray(grid.origin_m) + low * grid.resolution_m
    nx, ny, nz = (int(size) for size in high - low)
    box = VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), grid.resolution_m, (nx, ny, nz))
    if steps == 0:
        return Occupancy(box, part, occupancy.t_s)
    reach = np.arange(-steps, steps + 1)
    offsets = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    near = (offsets**2).sum(axis=1) <= (margin_m / grid.resolution_m) ** 2 + _ROUNDING
    wide = np.zeros(box.shape, dtype=np.float32)
    _spread(np.ascontiguousarray(part), cells - low, offsets[near], wide)
    return Occupancy(box, wide, occupancy.t_s)


@exact
def _spread(
    probability: NDArray[np.float32], cells: NDArray[np.int64], offsets: NDArray[np.int64], wide: NDArray[np.float32]
) -> None:
    nx, ny, nz = wide.shape
    for c in range(len(cells)):
        x, y, z = cells[c]
        p = probability[x, y, z]
        for k in range(len(offsets)):
            i, j, m = x + offsets[k, 0], y + offsets[k, 1], z + offsets[k, 2]
            if 0 <= i < nx and 0 <= j < ny and 0 <= m < nz and wide[i, j, m] < p:
                wide[i, j, m] = p


def distance_to_voxels(
    grid: VoxelGrid, flat: NDArray[np.int64], lower_m: ArrayLike, upper_m: ArrayLike, cap_m: float
) -> SignedDistanceField:
    """Return the distance to voxels, each a solid cube, within a box; made anew for every occupancy.

    Exact distances to cubes are separable: the squared gap to a cube is the sum of three squared gaps along the axes,
    so three passes of minima along lines give them at all voxel centres. Only distances up to a cap are wanted, and
    only where the arm can be, which keeps it to a millisecond or two.

    Args:
        grid: the lattice of the occupancy.
        flat: (M,) flat indices of the voxels, as of `Occupancy.voxels_above`.
        lower_m, upper_m: (3,) box that holds every point asked for (the arm's reach), world frame. Points
            outside the box may get too large distances; points outside the grid do not.
        cap_m: larger distances are reported as this.

    Returns:
        Distances at voxel centres, exact outside the cubes and up to the cap; inside they are minus half a voxel
        however deep. Interpolated between, they are exact in front of faces, and at most half a voxel too large in
        front of the corner of a single cube.

    Raises:
        PlanningError: for a box that is empty or does not meet the grid, a cap that is not positive, or indices
            outside the grid.
    """
    lower = checked("person distance: lower corner", lower_m, (3,), error=PlanningError)
    upper = checked("person distance: upper corner", upper_m, (3,), error=PlanningError)
    h, shape, origin = grid.resolution_m, np.array(grid.shape), np.asarray(grid.origin_m)
    if not (cap_m > 0.0 and np.isfinite(cap_m)):
        raise PlanningError(f"person distance: wanted a cap > 0 m, got {cap_m}")
    # Nodes are voxel centres; one beyond the box on each side, so that it lies between them.
    first = np.clip(np.floor((lower - origin) / h - 0.5).astype(np.int64), 0, shape - 1)
    last = np.clip(np.ceil((upper - origin) / h - 0.5).astype(np.int64), 0, shape - 1)
    if not (upper > lower).all() or (last - first < 1).any():
        raise PlanningError(
            f"person distance: wanted a box that overlaps the grid by two voxels or more, got {lower} to {upper} "
            f"in a grid from {grid.origin_m} of {grid.shape} voxels of {h} m"
        )
    if len(flat) and (flat.min() < 0 or flat.max() >= grid.size):
        raise PlanningError(f"person distance: wanted voxels 0 to {grid.size - 1}, got {flat.min()} to {flat.max()}")
    cells = _capped(flat, shape, first, last, int(np.ceil(cap_m / h + 0.5)), np.float32(cap_m / h))
    return SignedDistanceField(origin + (first + 0.5) * h, h, cells * np.float32(h))


@exact
def _capped(
    flat: NDArray[np.int64],
    shape: NDArray[np.int64],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    reach: int,
    cap: np.float32,
) -> NDArray[np.float32]:
    """Return distances in voxels at nodes `first` to `last`; marks more than `reach` away are left out."""
    nx, ny, nz = last[0] - first[0] + 1, last[1] - first[1] + 1, last[2] - first[2] + 1
    far = np.float32(cap * cap)
    # Marks can count from outside the box, up to `reach`; each pass drops that margin along its axis.
    y0, z0 = max(first[1] - reach, 0), max(first[2] - reach, 0)
    y1, z1 = min(last[1] + reach, shape[1] - 1), min(last[2] + reach, shape[2] - 1)
    my, mz = y1 - y0 + 1, z1 - z0 + 1
    gap = np.empty(reach + 1, dtype=np.float32)
    for d in range(reach + 1):
        g = np.float32(max(d - 0.5, 0.0))
        gap[d] = g * g
    a = np.empty((nx, my, mz), dtype=np.float32)
    for x in range(nx):
        for y in range(my):
            _fill(a[x, y], far)
    inside = np.zeros((nx, ny, nz), dtype=np.bool_)
    used = np.zeros((nx, my), dtype=np.bool_)
    for m in range(len(flat)):
        i = flat[m] // (shape[1] * shape[2])
        j = flat[m] // shape[2] % shape[1]
        k = flat[m] % shape[2]
        if j < y0 or j > y1 or k < z0 or k > z1:
            continue
        for x in range(max(i - reach, first[0]), min(i + reach, last[0]) + 1):
            here = a[x - first[0], j - y0, k - z0]
            a[x - first[0], j - y0, k - z0] = min(here, gap[abs(x - i)])
            used[x - first[0], j - y0] = True
        if first[0] <= i <= last[0] and first[1] <= j <= last[1] and first[2] <= k <= last[2]:
            inside[i - first[0], j - first[1], k - first[2]] = True
    out = np.empty((nx, ny, nz), dtype=np.float32)
    line, padded = np.empty(mz, dtype=np.float32), np.empty(nz + 2 * reach, dtype=np.float32)
    shift = first[2] - reach - z0
    for x in range(nx):
        for y in range(ny):
            _fill(line, far)
            some = False
            for j in range(max(y + first[1] - reach, y0), min(y + first[1] + reach, y1) + 1):
                if used[x, j - y0]:
                    some = True
                    _lower(line, a[x, j - y0], gap[abs(j - first[1] - y)])
            if not some:
                _fill(out[x, y], cap)
                continue
            _fill(padded, far)
            for k in range(mz):
                padded[k - shift] = line[k]
            target = out[x, y]
            _fill(target, far)
            for d in range(-reach, reach + 1):
                _lower(target, padded[reach + d : reach + d + nz], gap[abs(d)])
            for k in range(nz):
                target[k] = np.float32(-0.5) if inside[x, y, k] else np.sqrt(target[k])
    return out


@exact_part
def _fill(line: NDArray[np.float32], value: np.float32) -> None:
    for k in range(len(line)):
        line[k] = value


@exact_part
def _lower(target: NDArray[np.float32], source: NDArray[np.float32], by: np.float32) -> None:
    for k in range(len(target)):
        value = source[k] + by
        target[k] = value if value < target[k] else target[k]
