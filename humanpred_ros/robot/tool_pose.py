"""Where a task wants the tool and how exactly, because few tasks need all six numbers of a pose.

The tool's displacement and rotation from the wanted pose are measured along the wanted pose's own axes. The
rotation is split into a twist about one axis of the tool, the one with the largest tolerance, and the
rotation that tilts that axis. A tool that may turn freely about its own x axis (tolerance 180 degrees) so
keeps the tolerances of how far that axis tilts, however far it has turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.rotation_vectors import rotation_matrix, rotation_vector

_RIGID = 1e-6


@dataclass(frozen=True, eq=False)
class ToolPose:
    """A pose wanted of the tool, with tolerances.

    Attributes:
        T_world_tool: (4, 4) wanted pose.
        position_tolerance_m: (3,) largest displacement along each axis of the wanted pose.
        orientation_tolerance_rad: (3,) largest rotation about each axis, pi or more for any.

    Raises:
        SceneError: for a pose that is not rigid, or tolerances that are negative.
    """

    T_world_tool: FloatArray
    position_tolerance_m: FloatArray
    orientation_tolerance_rad: FloatArray

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
        tilt = rotation_vector(turned @ rotation_matrix(-twist))
        limit = self.orientation_tolerance_rad
        tilt, twist = np.clip(tilt, -limit, limit), np.clip(twist, -limit, limit)
        result[:, :3, :3] = wanted[:3, :3] @ rotation_matrix(tilt) @ rotation_matrix(twist)
        nearest: FloatArray = result.reshape(T.shape)
        return nearest

    def error(self, T_world_tool: ArrayLike) -> FloatArray:
        """Return what is missing to the nearest allowed pose, world axes.

        Returns:
            (..., 6) translation in m, then rotation vector in rad, both zero within the tolerances.
        """
        T = np.asarray(T_world_tool, dtype=np.float64)
        nearest = self.nearest(T)
        back = np.swapaxes(T[..., :3, :3], -1, -2)
        turn = rotation_vector(nearest[..., :3, :3] @ back)
        missing: FloatArray = np.concatenate([nearest[..., :3, 3] - T[..., :3, 3], turn], axis=-1)
        return missing


def _each(what: str, tolerance: ArrayLike) -> FloatArray:
    """Return (3,) from one number or three."""
    given = np.asarray(tolerance, dtype=object)  # lists of odd content are for `checked` to refuse
    return checked(
        f"tool pose {what} tolerance", np.tile(given, 3) if given.ndim == 0 else given, (3,), error=SceneError
    )
