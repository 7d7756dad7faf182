"""The verdict on single configurations: what the arm touches or nearly touches, be it obstacle, robot or itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.shapes import Obstacle
from humanpred_ros.robot.clearance import Approach, nearest_approaches
from humanpred_ros.robot.pr2 import Pr2Arm
from humanpred_ros.robot.self_collision import SelfCollision


def nearest_contacts(arm: Pr2Arm, obstacles: Sequence[Obstacle], q: FloatArray) -> tuple[Approach, ...]:
    """Return where the arm comes closest to anything, at each of the configurations `q` (N, 7).

    The robot's own fixed bodies are among what is looked at, and the arm's own links: there the approach's
    `obstacle` is the name of a link.

    Args:
        obstacles: what else there is, may be empty.

    Raises:
        ArrayError: for configurations of another shape or not finite.
    """
    q = checked("configurations", q, ("N", arm.chain.n_joints))
    outside = nearest_approaches(arm, arm.spheres(), (*obstacles, *arm.fixed_obstacles), q)
    itself = SelfCollision.for_arm(arm)
    return tuple(
        itself.nearest(one) if inside < approach.clearance_m else approach
        for one, inside, approach in zip(q, itself.clearance(q), outside, strict=True)
    )


def shoulder_approach(arm: Pr2Arm, obstacles: Sequence[Obstacle]) -> Approach:
    """Return where turret and shoulder come closest to obstacles, whatever the arm does.

    Planners leave these two out (`Pr2Arm.spheres`); nothing may stand where they could get to.

    Args:
        obstacles: at least one.

    Returns:
        A clearance no larger than the true one: covers and the steps between the sampled angles take
        up to 0.1 m of it.
    """
    chain, counts = arm.chain, (49, 25)
    grids = [np.linspace(chain.lower[joint], chain.upper[joint], count) for joint, count in enumerate(counts)]
    q = np.zeros((counts[0] * counts[1], chain.n_joints))
    q[:, :2] = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 2)
    spheres = arm.shoulder_spheres()
    nearest = min(nearest_approaches(arm, spheres, obstacles, q), key=lambda approach: approach.clearance_m)
    # No point moves farther between a sampled angle and the middle of two than half the step times its arm.
    half_steps = sum(float(grid[1] - grid[0]) / 2.0 for grid in grids)
    lever = float(np.linalg.norm(chain.joint_origin_m[1])) + float(
        (np.linalg.norm(spheres.centre_m, axis=1) + spheres.radius_m).max()
    )
    return Approach(nearest.link, nearest.obstacle, nearest.clearance_m - half_steps * lever)
