"""Configurations that bring the tool to a pose, and how exactly a task wants that pose.

A pose has tolerances, because few tasks need all six numbers of it. The tool's displacement and rotation are measured
along the wanted pose's own axes. The rotation is split into a twist about one axis of the tool, the one with the
largest tolerance, and the rotation that tilts that axis. So a tool that may turn freely about its own x axis
(tolerance 180 degrees) keeps the tolerances of how far that axis tilts, however far it has turned.

A seven-joint arm reaches a pose in a whole curve of configurations, or in none. Many seeds are solved by damped
least squares: the damping follows the remaining error (Sugihara 2011); joints that would leave their
limits are stopped there, and the other joints make up for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.tool_pose_kernels import converge, nearest_poses
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
        T = np.asarray(T_world_tool, dtype=np.float64)
        return nearest_poses(_poses(T), *self.parts)[0].reshape(T.shape)

    def error(self, T_world_tool: ArrayLike) -> FloatArray:
        """Return what is missing to the nearest allowed pose, world axes.

        Returns:
            (..., 6) translation in m, then rotation vector in rad, both zero within the tolerances.
        """
        T = np.asarray(T_world_tool, dtype=np.float64)
        return nearest_poses(_poses(T), *self.parts)[1].reshape(*T.shape[:-2], 6)

    @property
    def parts(self) -> tuple[FloatArray, FloatArray]:
        """The pose (4, 4), and its tolerances (6,), m and rad, as kernels take them."""
        tolerance = np.concatenate([self.position_tolerance_m, self.orientation_tolerance_rad])
        return self.T_world_tool.copy(), tolerance  # a copy, because numba compiles once more for read-only arrays


def _poses(T: FloatArray) -> FloatArray:
    return np.array(T.reshape(-1, 4, 4))


def _each(what: str, tolerance: ArrayLike) -> FloatArray:
    """Return (3,) from one number or three."""
    given = np.asarray(tolerance, dtype=object)  # lists of odd content are for `checked` to refuse
    return checked(
        f"tool pose {what} tolerance", np.tile(given, 3) if given.ndim == 0 else given, (3,), error=SceneError
    )


_CONVERGED = 1e-6
"""Error left of a solution, m and rad: far below what a robot's encoders tell apart."""
#: Kept where no solution is farther from the limits: more than single precision loses.
_LEAST_MARGIN_RAD = 1e-4
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
        "Distance of solutions from the joint limits, where there are any; else 0.0001",
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
    margin_rad = settings.limit_margin_rad
    inside = target.tightened(2.0 * _CONVERGED)
    chain = arm.chain
    problem = (chain.joints, chain.T_last_tool.copy(), *inside.parts, start, chain.continuous.copy())
    solutions = np.empty((0, chain.n_joints))
    missing = np.full(2, np.inf)
    for k in range(_ROUNDS):
        if k and not len(solutions):  # a stretched arm may reach the pose at its limits alone
            margin_rad = min(margin_rad, _LEAST_MARGIN_RAD)
        lower, upper = chain.lower + margin_rad, chain.upper - margin_rad
        q = _seeds(arm, start, lower, upper, settings, k)
        # Every second one is drawn towards the start.
        drawn = np.arange(len(q)) % 2 == 0
        error = converge(q, drawn, *problem, lower, upper, settings.n_iterations, _CONVERGED)
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
