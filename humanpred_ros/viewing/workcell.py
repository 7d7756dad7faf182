"""The scene, arm and human a run was recorded with, and how close arm and human came: the figure a run is judged by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull

from humanpred_ros.errors import HumanModelError, HumanPredError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.clearance import SeparationMeter
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.robot.scene_file import recorded_scene
from humanpred_ros.viewing.recorded import JointTrack
from humanpred_ros.viewing.run import Run

_PALM = "right_palm"
_OUTLINE_SPACING_M = 0.03


@dataclass(frozen=True)
class Workcell:
    """What a run's recordings are measured and drawn with; parts that cannot be found are None."""

    scene: Scene | None  #: that the facts name
    human: HumanModel | None  #: the recorded URDF's model, else the 12-DoF human
    notes: tuple[str, ...] = ()  #: why a part is missing

    @property
    def arm(self) -> Arm | None:
        """The robot's arm."""
        return None if self.scene is None else self.scene.arm

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Table and objects."""
        return () if self.scene is None else self.scene.obstacles

    @cached_property
    def goals(self) -> Mapping[str, FloatArray]:
        """All configurations (K, J) in which a goal is reached, by name, the preferred one first."""
        return {} if self.scene is None else {goal.name: goal.configurations for goal in self.scene.goals}

    def tool_path(self, q: FloatArray) -> FloatArray:
        """Return the tool's places (T, 3) at configurations (T, J), world frame; none without an arm."""
        if self.arm is None or not len(q):
            return np.zeros((0, 3))
        return np.asarray(self.arm.chain.tool_pose(q)[:, :3, 3], dtype=np.float64)

    def palm_path(self, postures: JointTrack) -> FloatArray:
        """Return the right palm's places (T, 3) in the world frame; none without a scene or a palm."""
        if self.scene is None or self.human is None or not len(postures) or _PALM not in self.human.link_names:
            return np.zeros((0, 3))
        return _moved(self.scene.T_world_human, self.human.forward(postures.q)[_PALM])

    def human_outlines(self, q: FloatArray) -> list[FloatArray]:
        """Return the outlines (N, 2) of the human's bodies in posture (D,), from above, the lowest body first."""
        if self.scene is None or self.human is None:
            return []
        points = [
            _moved(self.scene.T_world_human @ T, body.shape.sample(_OUTLINE_SPACING_M))
            for body, T in zip(self.human.bodies, self.human.body_poses(q), strict=True)
        ]
        upwards = sorted(points, key=lambda world: float(world[:, 2].max()))
        return [world[ConvexHull(world[:, :2]).vertices, :2] for world in upwards]


def load_workcell(run: Run) -> Workcell:
    """Return the workcell a run's facts and recordings point to; what is missing is told in its notes."""
    notes = []
    scene: Scene | None = None
    name = run.facts.get("scene", "")
    if not name:
        notes.append("the bag does not say which scene was used: distances and goals cannot be evaluated")
    else:
        try:
            scene = load_scene(recorded_scene(run.folder, name))
        except HumanPredError as trouble:
            notes.append(f"scene {name} cannot be loaded, so distances and goals are not evaluated: {trouble}")
    human: HumanModel | None = None
    try:
        human = HumanModel(run.human_urdf) if run.human_urdf else HumanModel.kinect12()
        if len(run.postures):
            human.check_dofs(run.postures.names)
    except HumanModelError as trouble:
        human = None
        notes.append(f"the recorded postures fit no human model, so distances are not evaluated: {trouble}")
    return Workcell(scene, human, tuple(notes))


def _moved(T: FloatArray, points_m: FloatArray) -> FloatArray:
    moved: FloatArray = points_m @ T[:3, :3].T + T[:3, 3]
    return moved


@dataclass(frozen=True)
class Closest:
    """The least distance between robot and human: negative when they penetrate."""

    distance_m: float
    t_s: float
    percent: float | None
    robot_link: str
    human_body: str


@dataclass(frozen=True)
class Clearance:
    """Least distance between the robot's spheres and the human's body, at every posture."""

    t_s: FloatArray  #: (T,) times of the postures for which the arm's configuration is known
    distance_m: FloatArray  #: (T,) negative where they penetrate
    closest: Closest | None = None  #: the least of all, None without any
    place_m: FloatArray = field(default_factory=lambda: np.zeros(3))  #: centre of the robot's sphere then, world frame

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
    q_robot = run.robot.at(run.postures.t_s)
    known = np.isfinite(q_robot).all(axis=1)
    if not known.any():
        return nothing
    arm, spheres, t_s = scene.arm, scene.arm.spheres(), run.postures.t_s[known]
    apart = SeparationMeter(arm, human, scene.T_world_human, run.postures.q[known]).measure(q_robot[known])
    k = int(np.argmin(apart.distance_m))
    part, when_s = int(apart.part[k]), float(t_s[k])
    link, body = arm.link_names[int(spheres.link[part])], human.bodies[int(apart.body[k])].name
    closest = Closest(apart.least_m, when_s, run.percent(when_s), link, body)
    return Clearance(t_s, apart.distance_m, closest, spheres.world_m(arm.chain, q_robot[known][k : k + 1])[0, part])
