"""Uses all that a replanning step is made of once: what compiles at its first use must not cost a step its deadline."""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.reconnection import reconnect
from humanpred_ros.planning.timing.parameterisation import time_parameterise
from humanpred_ros.planning.timing.path import straight
from humanpred_ros.planning.timing.stopping import brake_along
from humanpred_ros.planning.tools import Tools


def warm_up(tools: Tools, q: FloatArray, centre_m: FloatArray) -> None:
    """Plan, time, stop and check one small motion from a configuration (D,), beside a voxel at `centre_m` (3,)."""
    grid = VoxelGrid((float(centre_m[0]), float(centre_m[1]), float(centre_m[2])), 0.05, (4, 4, 4))
    corner = np.zeros(grid.shape, dtype=np.float32)
    corner[0, 0, 0] = 1.0
    occupancy = Occupancy(grid, corner)
    planner, _ = tools.planner(occupancy)
    path = straight(q, q + 0.1, tools.config.stomp.waypoints)
    planner.plan(path, np.random.default_rng(0))
    reconnect(q, path, planner.terms, tools.weights, tools.config.reconnect_step, len(path))
    trajectory = time_parameterise(path, tools.velocity_limit, tools.acceleration_limit)
    middle_s = 0.5 * trajectory.duration_s
    _, v, a = trajectory.sample(middle_s)
    time_parameterise(path, tools.velocity_limit, tools.acceleration_limit, v, a)
    brake_along(trajectory, middle_s, tools.acceleration_limit)
    tools.checker.first_trouble(trajectory)
    person = tools.person(occupancy)
    person.in_the_way(trajectory, 0.0)
    person.on_the_way(trajectory, 0.0)
    person.least_gap_m(trajectory, 0.0)
    person.comes_to(q)
