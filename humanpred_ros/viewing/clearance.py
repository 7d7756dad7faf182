"""How close robot and human came: the figure a run is judged by first."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.workcell import Workcell


@dataclass(frozen=True)
class Clearance:
    """Least distance between the robot's spheres and the human's body, at every posture.

    Attributes:
        t_s: (T,) times of the postures for which the arm's configuration is known.
        distance_m: (T,) negative where they penetrate.
        robot_link, human_body: (T,) names of the two parts that are closest.
        place_m: (T, 3) centre of the robot's closest sphere, world frame.
    """

    t_s: FloatArray
    distance_m: FloatArray
    robot_link: tuple[str, ...] = ()
    human_body: tuple[str, ...] = ()
    place_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def __len__(self) -> int:
        return len(self.t_s)


def measure_clearance(run: Run, workcell: Workcell) -> Clearance:
    """Return the distance at every posture, with the arm's configuration interpolated to the same data time.

    Arm and human stand for their collision bodies; the spheres contain the arm's links from the upper arm
    on, so the true distance is never smaller.
    """
    nothing = Clearance(np.zeros(0), np.zeros(0))
    scene, human = workcell.scene, workcell.human
    if scene is None or human is None:
        return nothing  # the workcell's own notes say why
    arm, T_world_human = scene.arm, scene.T_world_human
    q_robot = run.robot.at(run.postures.t_s)
    known = np.isfinite(q_robot).all(axis=1)
    if not known.any():
        return nothing
    t_s, postures = run.postures.t_s[known], run.postures.q[known]
    spheres = arm.spheres()
    centres_world = spheres.world_m(arm.chain, q_robot[known])
    # Into the tracker's frame, where the human's bodies are.
    centres = (centres_world - T_world_human[:3, 3]) @ T_world_human[:3, :3]
    poses = human.body_poses(postures)
    least = np.full((len(t_s), len(human.bodies), len(spheres)), np.inf)
    for b, body in enumerate(human.bodies):
        T = poses[:, b]
        local = (centres - T[:, None, :3, 3]) @ T[:, :3, :3]
        least[:, b] = body.shape.distance_m(local.reshape(-1, 3)).reshape(local.shape[:-1]) - spheres.radius_m
    flat = least.reshape(len(t_s), -1)
    where = flat.argmin(axis=1)
    nearest_body, nearest_sphere = np.unravel_index(where, least.shape[1:])
    return Clearance(
        t_s,
        flat[np.arange(len(t_s)), where],
        tuple(arm.link_names[int(spheres.link[s])] for s in nearest_sphere),
        tuple(human.bodies[int(b)].name for b in nearest_body),
        centres_world[np.arange(len(t_s)), nearest_sphere],
    )
