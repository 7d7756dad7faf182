"""What an arm is made of, and how far it can be trusted: its covers against its meshes, its verdicts against coal's.

coal is pinocchio's collision library; kinematics and collisions computed here are compared with both.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.outputs import write_plot
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.urdf import urdf_text
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.clearance import SelfCollision, nearest_contacts
from humanpred_ros.robot.inverse_kinematics import ToolPose, solve_tool_pose
from humanpred_ros.robot.robot import Robot, load_robot
from humanpred_ros.robot.semantics import pair_of
from humanpred_ros.settings import LARGEST_SEED, Settings, setting
from humanpred_ros.viewing.figures import MUTED, SERIES, new_figure

#: Free configurations that keep this distance from everything should be called free, m.
CLEAR_M = 0.01
#: Points on a link's surface, and on each of its spheres.
_SURFACE_POINTS, _RIM_POINTS = 4000, 100


class RobotCheckSettings(Settings):
    """Settings of `humanpred robot check`."""

    robot: str = setting(..., "name of a robot of the package, or a YAML file", positional=True)
    plot: Path | None = setting(None, "picture of links and spheres to write: .png, .svg or .pdf")
    configurations: int = setting(0, "random configurations compared with coal, pinocchio's collision library", low=0)
    poses: int = setting(0, "tool poses of free configurations that inverse kinematics must find", low=0)
    seed: int = setting(0, "of what is drawn", low=0, high=LARGEST_SEED)


@dataclass(frozen=True)
class Agreement:
    """Verdicts on N configurations beside those of the meshes."""

    touching: int  #: configurations in which meshes touch
    missed: int  #: those of them that were called free
    clear: int  #: free ones that keep `CLEAR_M`
    called_free: int  #: those of them that were called free
    tool_error: float  #: largest difference of a tool pose's elements, m and 1


def run(settings: RobotCheckSettings, console: Console) -> int:
    """Show what an arm is made of, and compare it with its meshes; the exit status is 1 if a collision was missed."""
    robot = load_robot(settings.robot)
    arm = Arm(robot, np.eye(4))
    chain, spheres = arm.chain, arm.spheres()
    console.print(
        f"{robot.name}: {robot.path}\n{robot.urdf}\ntool {arm.tool_frame}, reach {arm.reach[1]:.2f} m at most"
    )
    table = Table("joint", "lower", "upper", "speed (rad/s)", "acceleration (rad/s^2)", "weight", box=None)
    for j, name in enumerate(chain.joint_names):
        limits = ["endless"] * 2 if chain.continuous[j] else [f"{chain.lower[j]:.3f}", f"{chain.upper[j]:.3f}"]
        acceleration = "planner's" if np.isinf(chain.acceleration_limit[j]) else f"{chain.acceleration_limit[j]:g}"
        weight = f"{robot.distance_weights[j]:.2f}"
        table.add_row(name, *limits, f"{chain.velocity_limit[j]:g}", acceleration, weight)
    console.print(table)
    table = Table("link", "spheres", "largest (mm)", "sticks out (mm: mean, most)", "not covered (%)", box=None)
    for link, (mean_m, most_m, bare) in cover(robot).items():
        radii = spheres.radius_m[np.array(robot.sphere_links) == link]
        out = f"{1e3 * mean_m:.0f}, {1e3 * most_m:.0f}"
        table.add_row(link, str(len(radii)), f"{1e3 * radii.max():.0f}", out, f"{100.0 * bare:.1f}")
    console.print(table)
    itself = SelfCollision.for_arm(arm)
    console.print(
        f"{len(spheres)} spheres, {len(arm.body_points())} body points, {len(itself.pairs)} pairs of links checked"
    )
    left_out = sorted(f"{a} - {b}" for a, b in robot.left_out if {a, b} & set(robot.sphere_links))
    console.print(f"not checked: {', '.join(left_out) or 'none'}")
    _advise(robot, console)
    rng, missed = np.random.default_rng(settings.seed), 0
    if settings.configurations:
        with console.status("comparing with coal"):
            found = compare(arm, draw(arm, settings.configurations, rng))
        missed = found.missed
        share = found.called_free / max(found.clear, 1)
        console.print(
            f"{settings.configurations} configurations: {found.touching} touch, {missed} of them called free; "
            f"{100.0 * share:.2f} % of the {found.clear} at {1e3 * CLEAR_M:.0f} mm or more called free; "
            f"tool poses within {found.tool_error:.1e} of pinocchio's"
        )
    if settings.poses:
        with console.status("solving tool poses"):
            reached, times_s = solve(arm, settings.poses, rng)
        median, most = 1e3 * np.quantile(times_s, [0.5, 0.95])
        console.print(
            f"{settings.poses} tool poses: {100.0 * reached:.1f} % found, {1e3 * times_s.mean():.1f} ms of processor "
            f"time each (median {median:.1f}, 95 % below {most:.1f})"
        )
    if settings.plot is not None:
        write_plot(settings.plot, lambda: robot_figure(arm))
        console.print(f"plot  {settings.plot}")
    return 1 if missed else 0


def _advise(robot: Robot, console: Console) -> None:
    """Say what is missing and where it could come from."""
    if robot.file.semantic is None and not robot.file.collision.pairs_left_out:
        console.print("semantic: none; an SRDF names pairs of links that need no check, and states")
    if robot.file.acceleration_limit is None:
        console.print("acceleration_limit: none; the manufacturer's data sheet or XRDF's cspace has it")


def draw(arm: Arm, count: int, rng: np.random.Generator) -> FloatArray:
    """Return random configurations (N, J) within the limits."""
    chain = arm.chain
    lower, upper = np.where(chain.continuous, -np.pi, chain.lower), np.where(chain.continuous, np.pi, chain.upper)
    return rng.uniform(lower, upper, (count, chain.n_joints))


class MeshCollision:
    """The robot's meshes in pinocchio, with the pairs of links that its file and SRDF do not leave out."""

    def __init__(self, arm: Arm) -> None:
        import pinocchio as pin

        self._pin, self._arm, robot = pin, arm, arm.robot
        text = urdf_text(robot.urdf, str)
        self._model = pin.buildModelFromXML(text)
        try:
            self._geometry = pin.buildGeomFromUrdfString(self._model, text, pin.GeometryType.COLLISION)
        except (ValueError, RuntimeError) as trouble:
            raise UsageError(f"{robot.urdf}: pinocchio cannot read its collision geometry ({trouble})") from trouble
        links = [str(self._model.frames[item.parentFrame].name) for item in self._geometry.geometryObjects]
        moved = [robot.joint_of_link(link) for link in links]
        for j, b in enumerate(links):
            for i, a in enumerate(links[:j]):
                if a != b and max(moved[i], moved[j]) >= 0 and pair_of(a, b) not in robot.left_out:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._data, self._placed = self._model.createData(), self._geometry.createData()

    @cached_property
    def _at_rest(self) -> FloatArray:
        return self._set(np.array(self._pin.neutral(self._model)), self._arm.standing)

    def _set(self, full: FloatArray, values: Any) -> FloatArray:
        values = dict(values)
        for name, mimic in self._arm.robot.description.mimic.items():
            if name not in values and mimic.joint in values:
                values[name] = mimic.multiplier * values[mimic.joint] + mimic.offset
        for name, value in values.items():
            joint = self._model.joints[self._model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        return full

    def place(self, q: Sequence[float]) -> FloatArray:
        """Bring the arm to a configuration (J,); return the tool's pose (4, 4) in the root's frame."""
        full = self._set(self._at_rest.copy(), zip(self._arm.chain.joint_names, q, strict=True))
        self._pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, full)
        self._pin.updateFramePlacements(self._model, self._data)
        T: FloatArray = self._data.oMf[self._model.getFrameId(self._arm.tool_frame)].homogeneous
        return T

    def touches(self) -> bool:
        """Return whether any pair touches."""
        return bool(self._pin.computeCollisions(self._geometry, self._placed, True))

    def distance_m(self) -> float:
        """Return the least distance of any pair."""
        return float(
            self._placed.distanceResults[self._pin.computeDistances(self._geometry, self._placed)].min_distance
        )


def compare(arm: Arm, q: FloatArray) -> Agreement:
    """Return how verdicts on an arm alone, at configurations (N, J), agree with its meshes.

    Args:
        arm: whose base is at the origin.
    """
    meshes = MeshCollision(arm)
    ours = np.array([contact.clearance_m for contact in nearest_contacts(arm, (), q)])
    touching, clear = np.zeros(len(q), dtype=np.bool_), np.zeros(len(q), dtype=np.bool_)
    tool_error, poses = 0.0, arm.chain.tool_pose(q)
    for k, (one, pose) in enumerate(zip(q, poses, strict=True)):
        tool_error = max(tool_error, float(np.abs(meshes.place(one) - pose).max()))
        touching[k] = meshes.touches()
        # Distances of the covers are never larger than those of the meshes.
        clear[k] = not touching[k] and (ours[k] >= CLEAR_M or meshes.distance_m() >= CLEAR_M)
    free = ours >= 0.0
    return Agreement(
        int(touching.sum()), int((touching & free).sum()), int(clear.sum()), int((clear & free).sum()), tool_error
    )


def solve(arm: Arm, count: int, rng: np.random.Generator) -> tuple[float, FloatArray]:
    """Return the share of tool poses of free configurations that are found, and the processor time (N,) of each, s."""
    chosen: list[FloatArray] = []
    while len(chosen) < count:
        q = draw(arm, 2 * count, rng)
        chosen += [one for one, found in zip(q, nearest_contacts(arm, (), q), strict=True) if found.clearance_m > 0.0]
    chain = arm.chain
    middle = np.where(chain.continuous, 0.0, np.clip(0.0, chain.lower, chain.upper))
    reached, times_s = 0, []
    solve_tool_pose(arm, ToolPose.within(chain.tool_pose(middle), 0.0, 0.0), middle)  # compiles it
    for one in chosen[:count]:
        target = ToolPose.within(chain.tool_pose(one), 0.0, 0.0)
        began = time.process_time()
        reached += len(solve_tool_pose(arm, target, middle).configurations) > 0
        times_s.append(time.process_time() - began)
    return reached / count, np.array(times_s)


def cover(robot: Robot) -> dict[str, tuple[float, float, float]]:
    """Return how far the spheres of each link stick out of its surface, mean and most (m), and what they leave bare.

    The last is a share of the link's surface. Points of a sphere within the link's boxes or other spheres of the link
    count as 0.
    """
    (boxes, box_links), spheres = robot.inner_boxes, robot.spheres
    directions = np.random.default_rng(0).normal(size=(_RIM_POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    found = {}
    for link, triangles in robot.link_surfaces().items():
        own, filled = np.array(robot.sphere_links) == link, np.array(box_links) == link
        centre, radius = spheres.local_m[own], spheres.radius_m[own]
        surface = _scattered(triangles, np.random.default_rng(0))
        bare = (np.linalg.norm(surface[:, None] - centre, axis=2) - radius).min(axis=1) > 1e-6
        rim = (centre[:, None] + radius[:, None, None] * directions).reshape(-1, 3)
        outside = (np.linalg.norm(rim[:, None] - centre, axis=2) - radius).min(axis=1) > -1e-9
        beyond = np.abs(rim[:, None] - boxes.local_m[filled]) - boxes.half_m[filled]
        outside &= (beyond.max(axis=2) > 0.0).all(axis=1)
        out = np.where(outside, cKDTree(surface).query(rim)[0], 0.0)
        found[link] = float(out[outside].mean()) if outside.any() else 0.0, float(out.max()), float(bare.mean())
    return found


def _scattered(triangles: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return random points (N, 3) spread evenly over a surface (F, 3, 3)."""
    a, b, c = np.swapaxes(triangles, 0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(area), _SURFACE_POINTS, p=area / area.sum())
    points: FloatArray = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), _SURFACE_POINTS), triangles[face])
    return points


def robot_figure(arm: Arm) -> Figure:
    """Return a drawing of the arm's surfaces and spheres in the middle of its limits, from the front and the side."""
    chain, spheres = arm.chain, arm.spheres()
    q = np.where(chain.continuous, 0.0, (chain.lower + chain.upper) / 2.0)
    poses, centres = chain.link_poses(q), spheres.world_m(chain, q)
    figure = new_figure(5.5)
    for k, sides in enumerate(([0, 2], [1, 2])):
        axes = figure.add_subplot(1, 2, k + 1)
        axes.set_aspect("equal")
        axes.set_xlabel(f"{'xy'[k]} in m")
        axes.set_ylabel("z in m")
        for link, triangles in arm.robot.link_surfaces().items():
            T = poses[arm.robot.joint_of_link(link)]
            flat = (triangles @ T[:3, :3].T + T[:3, 3])[..., sides]
            axes.add_collection(PolyCollection(list(flat), facecolor=MUTED, alpha=0.15, linewidth=0))
        for centre, radius in zip(centres[:, sides].tolist(), spheres.radius_m.tolist(), strict=True):
            axes.add_patch(Circle((centre[0], centre[1]), radius, fill=False, edgecolor=SERIES[1], linewidth=0.6))
        axes.autoscale_view()
    return figure
