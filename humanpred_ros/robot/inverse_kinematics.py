"""Configurations that bring the tool to a pose, and how exactly a task wants that pose.

A pose has tolerances, because few tasks need all six numbers of it. The tool's displacement and rotation are measured
along the wanted pose's own axes. The rotation is split into a twist about one axis of the tool, the one with the
largest tolerance, and the rotation that tilts that axis. So a tool that may turn freely about its own x axis
(tolerance 180 degrees) keeps the tolerances of how far that axis tilts, however far it has turned.

A seven-joint arm reaches a pose in a whole curve of configurations, or in none. Many seeds are solved at once by damped
least squares, as one batch: the damping follows the remaining error (Sugihara 2011); joints that would leave their
limits are stopped there, and the other joints make up for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.robot.arm import Arm
from humanpred_ros.settings import LARGEST_SEED, Settings, setting

_RIGID = 1e-6


@dataclass(frozen=True, eq=False)
class ToolPose:
    """A pose wanted of the tool, with tolerances.

    Raises:
        SceneError: for a pose that is not rigid, or tolerances that are negative.
    """

    T_world_tool: FloatArray  #: (4, 4) wanted pose
    position_tolerance_m: FloatArray  #: (3,) largest displacement along each axis of the wanted pose
    orientation_tolerance_rad: FloatArray  #: (3,) largest rotation about each axis, pi or more for any

    def __post_init__(self) -> None:
        T = checked("tool pose", self.T_world_tool, (4, 4), error=SceneError)
        rotation = T[:3, :3]
        skew = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if skew > _RIGID or np.linalg.det(rotation) < 0.0 or np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > _RIGID:
            raise SceneError(f"tool pose: wanted a rigid (4, 4) transform, got\n{T}\nnormalise its rotation")
        object.__setattr__(self, "T_world_tool", frozen(T))
        for name in ("position_tolerance_m", "orientation_tolerance_rad"):
            tolerance = checked(f"tool pose {name}", getattr(self, name), (3,), error=SceneError)
            if (tolerance < 0.0).any():
                raise SceneError(f"tool pose {name}: wanted numbers of at least 0, got {tolerance}; 0 means exactly")
            object.__setattr__(self, name, frozen(tolerance))

    @classmethod
    def within(
        cls, T_world_tool: ArrayLike, position_tolerance_m: ArrayLike, orientation_tolerance_rad: ArrayLike
    ) -> ToolPose:
        """Return a pose whose tolerances are given by three numbers or by one for all axes; raises as the class."""
        T = checked("tool pose", T_world_tool, (4, 4), error=SceneError)
        return cls(T, _each("position", position_tolerance_m), _each("orientation", orientation_tolerance_rad))

    def tightened(self, by: float) -> ToolPose:
        """Return the pose with every tolerance smaller by `by` (m and rad), at least 0."""
        return ToolPose(
            self.T_world_tool,
            np.maximum(self.position_tolerance_m - by, 0.0),
            np.maximum(self.orientation_tolerance_rad - by, 0.0),
        )

    def nearest(self, T_world_tool: ArrayLike) -> FloatArray:
        """Return the allowed poses (..., 4, 4) nearest to other poses (..., 4, 4), part by part."""
        from scipy.spatial.transform import Rotation  # only tool poses need it

        T = np.asarray(T_world_tool, dtype=np.float64)
        wanted, flat = self.T_world_tool, T.reshape(-1, 4, 4)
        result = np.zeros_like(flat)
        result[:, 3, 3] = 1.0
        shift = (flat[:, :3, 3] - wanted[:3, 3]) @ wanted[:3, :3]
        allowed = np.clip(shift, -self.position_tolerance_m, self.position_tolerance_m)
        result[:, :3, 3] = wanted[:3, 3] + allowed @ wanted[:3, :3].T
        turned = wanted[:3, :3].T @ flat[:, :3, :3]
        a = int(np.argmax(self.orientation_tolerance_rad))
        b, c = (a + 1) % 3, (a + 2) % 3
        twist = np.zeros((len(flat), 3))
        # With the quaternion's real part w and its part x along a: 4 w x over 2 (w^2 - x^2), the tangent of the twist.
        twist[:, a] = np.arctan2(turned[:, c, b] - turned[:, b, c], turned[:, b, b] + turned[:, c, c])

        tilt = Rotation.from_matrix(turned @ Rotation.from_rotvec(-twist).as_matrix()).as_rotvec()
        limit = self.orientation_tolerance_rad
        tilt, twist = np.clip(tilt, -limit, limit), np.clip(twist, -limit, limit)
        result[:, :3, :3] = (
            wanted[:3, :3] @ Rotation.from_rotvec(tilt).as_matrix() @ Rotation.from_rotvec(twist).as_matrix()
        )
        nearest: FloatArray = result.reshape(T.shape)
        return nearest

    def error(self, T_world_tool: ArrayLike) -> FloatArray:
        """Return what is missing to the nearest allowed pose, world axes.

        Returns:
            (..., 6) translation in m, then rotation vector in rad, both zero within the tolerances.
        """
        from scipy.spatial.transform import Rotation

        T = np.asarray(T_world_tool, dtype=np.float64)
        nearest = self.nearest(T)
        back = np.swapaxes(T[..., :3, :3], -1, -2)

        turn = Rotation.from_matrix((nearest[..., :3, :3] @ back).reshape(-1, 3, 3)).as_rotvec()
        turn = turn.reshape(*T.shape[:-2], 3)
        missing: FloatArray = np.concatenate([nearest[..., :3, 3] - T[..., :3, 3], turn], axis=-1)
        return missing


def _each(what: str, tolerance: ArrayLike) -> FloatArray:
    """Return (3,) from one number or three."""
    given = np.asarray(tolerance, dtype=object)  # lists of odd content are for `checked` to refuse
    return checked(
        f"tool pose {what} tolerance", np.tile(given, 3) if given.ndim == 0 else given, (3,), error=SceneError
    )


_CONVERGED = 1e-6
"""Error left of a solution, m and rad: far below what a robot's encoders tell apart."""
_DAMPING = 1e-2
_LEAST_DAMPING = 1e-12
_LARGEST_STEP_RAD = 0.6
_PULL = 0.3
#: Where few are found, as of an arm that is nearly stretched, other seeds are tried, so many times at most.
_ENOUGH, _ROUNDS = 8, 4


class InverseKinematicsSettings(Settings):
    """How hard solutions are looked for."""

    n_seeds: int = setting(128, "Configurations to begin from; the first is the start", low=1)
    n_iterations: int = setting(60, "Iterations of every seed at most", low=1)
    seed: int = setting(
        0, "Offset of the low-discrepancy sequence that the seeds are taken from", low=0, high=LARGEST_SEED
    )
    limit_margin_rad: float = setting(
        0.02,
        "Distance of solutions from the joint limits: on a limit, single precision may be beyond",
        low=0.0,
        high=1.0,
    )
    duplicate_distance: float = setting(0.02, "Configuration distance below which two solutions are one", low=0.0)


@dataclass(frozen=True, eq=False)
class InverseKinematics:
    """What was found."""

    #: (K, J) rad, the nearest to the start first, continuous joints the shorter way from it; K = 0 if the pose was not
    #: reached
    configurations: FloatArray
    missing_m: float  #: how far beyond its tolerances the tool stays at best, 0 if it was reached
    missing_rad: float


def solve_tool_pose(
    arm: Arm, target: ToolPose, start: ArrayLike, settings: InverseKinematicsSettings | None = None
) -> InverseKinematics:
    """Find different configurations within the joint limits whose tool pose is within a target's tolerances.

    Every second seed is drawn towards the start while it converges, so that the nearest solutions are
    among those found; the others spread over all there are. The same arguments give the same result.

    Args:
        start: (J,) rad, what nearness is measured from.

    Raises:
        ArrayError: for a start of another shape or not finite.
    """
    settings = settings or InverseKinematicsSettings()
    start = checked("inverse kinematics: start", start, (arm.chain.n_joints,))
    lower, upper = arm.chain.lower + settings.limit_margin_rad, arm.chain.upper - settings.limit_margin_rad
    inside = target.tightened(2.0 * _CONVERGED)
    solutions = np.empty((0, arm.chain.n_joints))
    missing = np.full(2, np.inf)
    for k in range(_ROUNDS):
        q, error = _converged(arm, inside, start, (lower, upper), settings, k)
        lengths = _missing(error)
        missing = min(missing, lengths[int(np.argmin(np.linalg.norm(error, axis=1)))], key=np.linalg.norm)
        reached = q[(lengths <= _CONVERGED).all(axis=1)]
        solutions = np.concatenate([solutions, start + arm.difference(start, reached)])
        solutions = solutions[np.argsort(arm.configuration_distance(start, solutions), kind="stable")]
        solutions = spread(arm, solutions, settings.duplicate_distance)
        if len(solutions) >= _ENOUGH:
            break
    missing_m, missing_rad = (0.0, 0.0) if len(solutions) else missing
    return InverseKinematics(solutions, float(missing_m), float(missing_rad))


def _converged(
    arm: Arm,
    inside: ToolPose,
    start: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    settings: InverseKinematicsSettings,
    k: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the configurations (N, J) that the seeds of round `k` lead to, and the errors (N, 6) left."""
    lower, upper = limits
    q = _seeds(arm, start, lower, upper, settings, k)
    drawn = np.arange(len(q)) % 2 == 0
    error = np.full((len(q), 6), np.inf)
    active = np.arange(len(q))
    pulling = settings.n_iterations // 2
    for iteration in range(settings.n_iterations + 1):
        if iteration < pulling:
            # A drawn seed gives way to the pull, then returns to the tolerances: it slides along the solutions.
            q[drawn] += _PULL * (1.0 - iteration / pulling) * arm.difference(q[drawn], start)
        error[active] = inside.error(arm.chain.tool_pose(q[active]))
        active = np.flatnonzero((_missing(error) > _CONVERGED).any(axis=1) | (drawn & (iteration < pulling)))
        if len(active) == 0 or iteration == settings.n_iterations:
            break
        q[active] = _stepped(arm, q[active], error[active], lower, upper)
    return q, error


def spread(arm: Arm, configurations: FloatArray, separation: float, most: int | None = None) -> FloatArray:
    """Return the first configurations (K, J) that keep a configuration distance from all kept before them.

    Args:
        configurations: (N, J), the most wanted first.
        separation: least distance between two that are kept.
        most: how many are kept at most, as many as there are by default.
    """
    kept: list[int] = []
    room = np.full(len(configurations), np.inf)
    for i in range(len(configurations)):
        if room[i] >= separation and (most is None or len(kept) < most):
            kept.append(i)
            room = np.minimum(room, arm.configuration_distance(configurations[i], configurations))
    return configurations[kept]


def _missing(error: FloatArray) -> FloatArray:
    """Return the lengths (N, 2), m and rad, of errors (N, 6)."""
    length: FloatArray = np.linalg.norm(error.reshape(-1, 2, 3), axis=2)
    return length


def _seeds(
    arm: Arm, start: FloatArray, lower: FloatArray, upper: FloatArray, settings: InverseKinematicsSettings, k: int
) -> FloatArray:
    """Return the seeds (N, J) of round `k` within the limits; of the first round the start first."""
    endless = arm.chain.continuous
    low, high = np.where(endless, start - np.pi, lower), np.where(endless, start + np.pi, upper)
    n = arm.chain.n_joints
    # Even in every dimension: multiples of the powers of the root of x^(n + 1) = x + 1 (Roberts 2018).
    root = 2.0
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (n + 1))
    offset = np.random.default_rng(settings.seed).random(n)
    numbers = k * settings.n_seeds + np.arange(settings.n_seeds)
    draws = (offset + numbers[:, None] * root ** -np.arange(1.0, n + 1.0)) % 1.0
    seeds: FloatArray = low + draws * (high - low)
    if k == 0:
        seeds[0] = np.clip(start, lower, upper)
    return seeds


def _stepped(arm: Arm, q: FloatArray, error: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return configurations (N, J) after one step against the errors (N, 6), within the limits."""
    J = _jacobian(arm, q)
    damping = _DAMPING * (error**2).sum(axis=1) + _LEAST_DAMPING
    step = _solved(J, error, damping)
    free = (q + step > lower) & (q + step < upper)
    if not free.all():
        stop = np.where(free, 0.0, np.clip(q + step, lower, upper) - q)
        step = stop + _solved(J * free[:, None, :], error - np.einsum("nij,nj->ni", J, stop), damping)
    largest = np.abs(step).max(axis=1, keepdims=True)
    step *= np.minimum(1.0, _LARGEST_STEP_RAD / np.maximum(largest, _LARGEST_STEP_RAD))
    result: FloatArray = np.clip(q + step, lower, upper)
    return result


def _solved(J: FloatArray, error: FloatArray, damping: FloatArray) -> FloatArray:
    """Return the damped least-squares steps (N, J) for errors (N, 6)."""
    normal = J @ np.swapaxes(J, 1, 2) + damping[:, None, None] * np.eye(6)
    step: FloatArray = np.einsum("nij,ni->nj", J, np.linalg.solve(normal, error[..., None])[..., 0])
    return step


def _jacobian(arm: Arm, q: FloatArray) -> FloatArray:
    """Return (N, 6, J): velocity of the tool's origin, then angular velocity, world axes, per joint."""
    poses = arm.chain.link_poses(q)
    tool = (poses[:, -1] @ arm.chain.T_last_tool)[:, None, :3, 3]
    axis = np.einsum("njab,jb->nja", poses[..., :3, :3], arm.chain.joint_axis)
    J = np.concatenate([np.cross(axis, tool - poses[..., :3, 3]), axis], axis=-1)
    jacobian: FloatArray = np.swapaxes(J, 1, 2)
    return jacobian
