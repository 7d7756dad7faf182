"""How many of a plan's lookups the kernels really do, counted in NumPy by the conditions under which they skip.

The kernels look at blocks of consecutive configurations and skip a link, or a sphere, that is far from everything in
all of them. What is counted here is one iteration around a given trajectory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.evaluation.planner_bench_world import BenchWorld
from humanpred_ros.geometry.chain_kernels import BLOCK
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.stomp import iteration_kernels


def lookup_share(world: BenchWorld, path: FloatArray) -> tuple[float, float]:
    """Return the shares of points and of spheres looked up in an iteration around the trajectory `path` (N, 7)."""
    planner, count = world.planner, world.workload.rollouts
    bits = iteration_kernels.random_bits(np.random.default_rng(0), path[1:-1].size * count)
    run = planner.begin(path, np.random.default_rng(0))
    rollouts = np.empty((count + 1, *path.shape), dtype=np.float32)
    iteration_kernels.sample(np.array(path), bits, planner.noise_std, run._rules, rollouts)
    q = rollouts.astype(np.float64).reshape(-1, path.shape[1])
    return _points_done(world, q), _spheres_done(world, q)


def _points_done(world: BenchWorld, q: FloatArray) -> float:
    """A link's points are looked up where a ball around them meets the box of occupied voxels."""
    human, occupancy = world.human, world.human.occupancy
    grid = occupancy.grid
    used = np.argwhere(occupancy.probability > 0.0)
    low = np.asarray(grid.origin_m) + used.min(axis=0) * grid.resolution_m
    high = np.asarray(grid.origin_m) + (used.max(axis=0) + 1) * grid.resolution_m
    poses = world.arm.chain.link_poses(q)
    done = 0.0
    for link in np.unique(human.points.link):
        local = human.points.local_m[human.points.link == link]
        centre, radius = _ball(local, np.zeros(len(local)))
        at = poses[:, link, :3, :3] @ centre + poses[:, link, :3, 3]
        gap = np.maximum(low - at, at - high).max(axis=1)
        done += len(local) * float(_blocks(gap < radius + 0.5 * grid.resolution_m, BLOCK).mean())
    return done / len(human.points)


def _spheres_done(world: BenchWorld, q: FloatArray) -> float:
    """A sphere is looked up where its link's ball, and it itself, may be within the clearance of an obstacle."""
    obstacle = world.obstacle
    poses = world.arm.chain.link_poses(q)
    slack = obstacle.clearance_m + 1.75 * obstacle.field.resolution_m
    done = 0.0
    for link in np.unique(obstacle.spheres.link):
        of_link = obstacle.spheres.link == link
        local, radius = obstacle.spheres.local_m[of_link], obstacle.spheres.radius_m[of_link]
        centre, bound = _ball(local, radius)
        rotation, position = poses[:, link, :3, :3], poses[:, link, :3, 3]
        link_near = _blocks(obstacle.field.nearest(rotation @ centre + position) <= bound + slack, BLOCK - 2)
        for place, r in zip(local, radius, strict=True):
            near = _blocks(obstacle.field.nearest(rotation @ place + position) <= r + slack, BLOCK - 2)
            done += float((link_near & near).mean())
    return done / len(obstacle.spheres)


def _ball(local: FloatArray, radius: FloatArray) -> tuple[FloatArray, float]:
    """Return the ball that `flatten` puts around a link's spheres."""
    centre = ((local - radius[:, None]).min(axis=0) + (local + radius[:, None]).max(axis=0)) / 2.0
    return centre, float((np.linalg.norm(local - centre, axis=1) + radius).max())


def _blocks(near: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """Return for each block of configurations whether one of them is near."""
    return np.logical_or.reduceat(near, np.arange(0, len(near), block))
