"""The PR2's right arm placed in a scene: the one robot both experiments of P1 plan for.

Everything is derived from the URDF and its collision meshes when the arm is made (about 0.1 s), so a
changed URDF cannot disagree with a stored copy. The base, torso, head and left arm stand still.
"""

from __future__ import annotations

import os
import sys
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import GoalUnreachableError, SceneError, UsageError
from humanpred_ros.geometry.chain import BodyBoxes, BodyPoints, BodySpheres, KinematicChain, reach_m
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.description import LinkSurface, PlacedDescription
from humanpred_ros.geometry.solids import Box, Obstacle
from humanpred_ros.geometry.urdf import read_description
from humanpred_ros.robot.surface import Bounds, covering_boxes, covering_spheres, sample

_ARM_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "upper_arm_roll_joint",
    "elbow_flex_joint",
    "forearm_roll_joint",
    "wrist_flex_joint",
    "wrist_roll_joint",
)
RIGHT_ARM_JOINTS = tuple(f"r_{name}" for name in _ARM_JOINTS)
LEFT_ARM_JOINTS = tuple(f"l_{name}" for name in _ARM_JOINTS)
TOOL_FRAME = "r_gripper_tool_frame"

LEFT_ARM_RAD = tuple(float(np.deg2rad(deg)) for deg in (-4.966, 79.626, 83.104, -54.144, 82.692, -62.511, 179.154))
"""Where the left arm is in the authors' scenes (docs/papers.md, P1 scenes)."""

TORSO_LIFT_M = 0.31
"""Height of the torso in the authors' scenes (docs/papers.md, P1 costs)."""

DISTANCE_WEIGHT_M = (0.54, 0.19, 0.49, 0.14, 0.37, 0.06, 0.14)
"""Move3D's weight of each joint, the reach of what it moves (docs/papers.md, P1 costs: estimated)."""

BODY_POINT_SPACING_M = 0.04
"""Between 3 and 5 cm: fine against a forearm's width, coarse enough for some 180 points."""

_FIRST_BODY_JOINT = RIGHT_ARM_JOINTS.index("r_upper_arm_roll_joint")
_ELBOW_JOINT = RIGHT_ARM_JOINTS.index("r_elbow_flex_joint")
# The radius of each limb's cross-section plus about 1 cm: smaller spheres would need several rows, larger ones
# stick out farther. The thin fingertips get small ones, because goals beside a cup leave them 1 cm.
_LARGEST_SPHERE_M = {
    "r_upper_arm_roll_link": 0.115,
    "r_upper_arm_link": 0.115,
    "r_elbow_flex_link": 0.085,
    "r_forearm_roll_link": 0.085,
    "r_forearm_link": 0.085,
    "r_gripper_l_finger_tip_link": 0.03,
    "r_gripper_r_finger_tip_link": 0.03,
}
_LARGEST_OTHER_SPHERE_M = 0.05
_LARGEST_SHOULDER_SPHERE_M = 0.1  # only decides whether a scene leaves the shoulder room
_LEAST_SAVING_M3 = 0.0005  # half a litre: some 60 boxes in all; the torso's are 0.064 m3, one box would be 0.173
_PR2_URDF = Path("share", "example-robot-data", "robots", "pr2_description", "urdf", "pr2.urdf")
_LIMIT_TOLERANCE_RAD = 1e-6  # limits are written with about ten digits, scene angles with six


class Pr2Arm:
    """The right arm of a PR2 that stands still, and what it must not hit of itself.

    Attributes:
        chain: its kinematics, rooted in torso_lift_link.
        link_names: (J) the link each joint moves.
        tool_frame: name of the frame that `chain.tool_pose` gives.
        T_world_base: (4, 4) pose of base_footprint.
        torso_lift_m, left_arm_rad: the fixed joints.
        urdf: the file everything comes from.

    Args:
        T_world_base: (4, 4) pose of base_footprint, on the floor between the wheels.
        torso_lift_m: height of the torso, 0 to 0.31.
        left_arm_rad: (7,) configuration of the left arm.
        urdf: another URDF of a PR2; example-robot-data's otherwise.

    Raises:
        SceneError: for a base, torso height or left arm that is impossible.
        UsageError: if no URDF is found or it is not a PR2's.
    """

    def __init__(
        self,
        T_world_base: ArrayLike,
        torso_lift_m: float = TORSO_LIFT_M,
        left_arm_rad: ArrayLike = LEFT_ARM_RAD,
        urdf: Path | None = None,
    ) -> None:
        self.T_world_base = checked("robot base", T_world_base, (4, 4), error=SceneError).copy()
        self.torso_lift_m = float(torso_lift_m)
        self.left_arm_rad = checked("left arm", left_arm_rad, (len(LEFT_ARM_JOINTS),), error=SceneError).copy()
        for array in (self.T_world_base, self.left_arm_rad):
            array.setflags(write=False)
        fixed = {"torso_lift_joint": self.torso_lift_m}
        fixed.update(zip(LEFT_ARM_JOINTS, map(float, self.left_arm_rad), strict=True))
        self.urdf = urdf or find_pr2_urdf()
        self._urdf = PlacedDescription(read_description(self.urdf), self.T_world_base, fixed)
        for joint, value in fixed.items():
            self._check_fixed(joint, value)
        self.chain: KinematicChain = self._urdf.chain(RIGHT_ARM_JOINTS, TOOL_FRAME)
        self.link_names = tuple(self._urdf.description.link_of(joint) for joint in RIGHT_ARM_JOINTS)
        self.tool_frame = TOOL_FRAME

    def body_points(self, spacing_m: float = BODY_POINT_SPACING_M) -> BodyPoints:
        """Sample the surface of upper arm, elbow, forearm, wrist and gripper, in joint order.

        These are what the human occupancy is summed over; the shoulder is left out as in the
        authors' planner (docs/papers.md, P1 costs). The gripper is closed.

        Args:
            spacing_m: least distance between two points of a link, and the largest gap between them.
        """
        link, points = [], []
        for joint, surfaces in enumerate(self._urdf.moving_surfaces(RIGHT_ARM_JOINTS)):
            if joint >= _FIRST_BODY_JOINT:
                part = sample(np.concatenate([surface.triangles for surface in surfaces]), spacing_m)
                link.append(np.full(len(part), joint))
                points.append(part)
        return BodyPoints(np.concatenate(link), np.concatenate(points))

    def spheres(self) -> BodySpheres:
        """Cover the surface of upper arm, elbow, forearm, wrist and gripper with spheres, in joint order.

        The turret and the shoulder are left out: they never touch the torso, and a scene whose obstacles they
        could reach is refused.
        """
        return _sphere_cover(self.urdf, _FIRST_BODY_JOINT, len(RIGHT_ARM_JOINTS), _LARGEST_OTHER_SPHERE_M)

    def shoulder_spheres(self) -> BodySpheres:
        """Cover what `spheres` leaves out, turret and shoulder, in joint order."""
        return _sphere_cover(self.urdf, 0, _FIRST_BODY_JOINT, _LARGEST_SHOULDER_SPHERE_M)

    def inner_boxes(self) -> BodyBoxes:
        """Fill turret, shoulder and upper arm with boxes, in joint order: what forearm and hand can run into."""
        return _inner_box_cover(self.urdf)

    @cached_property
    def fixed_obstacles(self) -> tuple[Obstacle, ...]:
        """The robot's own base, torso, head, laser and left arm as boxes, named after their links.

        No body is left out: the arm's spheres begin at the upper arm, whose mesh keeps 0.08 m or more from
        all of them in the authors' configurations. What the arm does to itself (forearm against turret) is
        `SelfCollision`'s.
        """
        obstacles = []
        surfaces = self._urdf.fixed_surfaces(RIGHT_ARM_JOINTS)
        for (surface, T_world_frame), boxes in zip(surfaces, _fixed_box_covers(self.urdf), strict=True):
            for lower, upper in boxes:
                T_world_box = T_world_frame.copy()
                T_world_box[:3, 3] += T_world_frame[:3, :3] @ ((lower + upper) / 2.0)
                obstacles.append(Obstacle(surface.link, Box(*(upper - lower)), T_world_box))
        return tuple(obstacles)

    @cached_property
    def reach(self) -> tuple[FloatArray, float]:
        """Centre (3,) and radius of a ball that the moving bodies never leave, world frame, metres."""
        return reach_m(self.chain, self.spheres())

    def difference(self, q_from: ArrayLike, q_to: ArrayLike) -> FloatArray:
        """Return the change (..., J) that leads from one configuration to another.

        Continuous joints go the shorter way round, so `q_from + difference` may name the same place as
        `q_to` by another angle.
        """
        change = np.asarray(q_to, dtype=np.float64) - np.asarray(q_from, dtype=np.float64)
        shorter = (change + np.pi) % (2.0 * np.pi) - np.pi
        result: FloatArray = np.where(self.chain.continuous, shorter, change)
        return result

    def configuration_distance(self, a: ArrayLike, b: ArrayLike) -> FloatArray:
        """Return Move3D's distance (...) between configurations (..., J), the unit of P1's path parameter.

        The root of the summed squares of each joint's change times `DISTANCE_WEIGHT_M` (docs/papers.md, P1 costs).
        """
        distance: FloatArray = np.linalg.norm(self.difference(a, b) * np.array(DISTANCE_WEIGHT_M), axis=-1)
        return distance

    def check_configuration(self, q: ArrayLike, name: str) -> FloatArray:
        """Return `q` (7,) if it lies within the joint limits.

        Args:
            q: configuration in rad.
            name: what the configuration is, for the message.

        Raises:
            GoalUnreachableError: naming the joint, its value and its limits.
        """
        array = checked(name, q, (self.chain.n_joints,), error=GoalUnreachableError)
        for joint, value, lower, upper in zip(
            self.chain.joint_names, array, self.chain.lower, self.chain.upper, strict=True
        ):
            if not lower - _LIMIT_TOLERANCE_RAD <= value <= upper + _LIMIT_TOLERANCE_RAD:
                raise GoalUnreachableError(
                    f"{name}: wanted {joint} within {lower:.4f} to {upper:.4f} rad, got {value:.4f} rad "
                    f"({np.rad2deg(value):.2f} deg); choose a configuration within the limits"
                )
        return array

    def _check_fixed(self, joint: str, value: float) -> None:
        lower, upper = self._urdf.description.limits(joint)
        if not lower - _LIMIT_TOLERANCE_RAD <= value <= upper + _LIMIT_TOLERANCE_RAD:
            raise SceneError(
                f"robot: wanted {joint} within {lower:.4f} to {upper:.4f} (rad or m), got {value}; correct the scene"
            )


def find_pr2_urdf() -> Path:
    """Return the PR2's URDF from wherever example-robot-data is installed (wheel, conda, apt).

    Raises:
        UsageError: if it is nowhere; the message says what to install.
    """
    # pip puts the data into cmeel.prefix of some site-packages, others below a prefix that site-packages are also in.
    prefixes = [
        prefix for entry in sys.path if entry for prefix in (Path(entry) / "cmeel.prefix", *Path(entry).parents)
    ]
    prefixes += [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    prefixes.append(Path(sys.prefix))
    for prefix in prefixes:
        if (prefix / _PR2_URDF).is_file():
            return prefix / _PR2_URDF
    raise UsageError(
        f"the PR2's URDF was looked for as {_PR2_URDF} below {len(prefixes)} prefixes and not found; "
        "install example-robot-data (pip install example-robot-data), or give the path of a URDF"
    )


# The covers below do not depend on where the robot stands, so scenes of one process share them.


def _unplaced(urdf: Path) -> PlacedDescription:
    return PlacedDescription(read_description(urdf), np.eye(4), {})


def _moving(urdf: Path, first: int, end: int) -> list[tuple[int, LinkSurface]]:
    """Return what each joint from `first` to before `end` moves, in the joint's frame, with the joint's number."""
    moving = _unplaced(urdf).moving_surfaces(RIGHT_ARM_JOINTS)
    return [(joint, surface) for joint in range(first, end) for surface in moving[joint]]


@lru_cache(maxsize=4)
def _sphere_cover(urdf: Path, first: int, end: int, largest_m: float) -> BodySpheres:
    link, centres, radii = [], [], []
    for joint, surface in _moving(urdf, first, end):
        centre, radius = covering_spheres(surface.triangles, _LARGEST_SPHERE_M.get(surface.link, largest_m))
        link.append(np.full(len(radius), joint))
        centres.append(centre)
        radii.append(radius)
    return BodySpheres(np.concatenate(link), np.concatenate(centres), np.concatenate(radii))


@lru_cache(maxsize=2)
def _inner_box_cover(urdf: Path) -> BodyBoxes:
    boxes = [
        (joint, lower, upper)
        for joint, surface in _moving(urdf, 0, _ELBOW_JOINT)
        for lower, upper in covering_boxes(surface.triangles, _LEAST_SAVING_M3)
    ]
    link, lower, upper = (np.array(part) for part in zip(*boxes, strict=True))
    return BodyBoxes(link, (lower + upper) / 2.0, (upper - lower) / 2.0)


@lru_cache(maxsize=2)
def _fixed_box_covers(urdf: Path) -> tuple[tuple[Bounds, ...], ...]:
    surfaces = _unplaced(urdf).fixed_surfaces(RIGHT_ARM_JOINTS)
    return tuple(tuple(covering_boxes(surface.triangles, _LEAST_SAVING_M3)) for surface, _ in surfaces)
