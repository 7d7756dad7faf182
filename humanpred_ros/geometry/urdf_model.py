"""A robot's URDF read once through pinocchio into arrays, so that nothing else has to know pinocchio's types."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.chain import KinematicChain
from humanpred_ros.geometry.checks import FloatArray

_PR2_URDF = Path("share", "example-robot-data", "robots", "pr2_description", "urdf", "pr2.urdf")

# Corners of a box's twelve triangles, as indices into its eight corners (x slowest, z fastest).
_BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_BOX_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_BOX_TRIANGLES = np.array([corners for a, b, c, d in _BOX_SIDES for corners in ((a, b, c), (a, c, d))])


def find_pr2_urdf() -> Path:
    """Return the PR2's URDF from wherever example-robot-data is installed (wheel, conda, apt).

    Raises:
        UsageError: if it is nowhere; the message says what to install.
    """
    package = Path(pin.__file__).resolve()
    prefixes = list(package.parents)
    # pip may put pinocchio and the data into different site-packages.
    prefixes += [Path(entry) / "cmeel.prefix" for entry in sys.path if entry]
    prefixes += [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    prefixes.append(Path(sys.prefix))
    for prefix in prefixes:
        if (prefix / _PR2_URDF).is_file():
            return prefix / _PR2_URDF
    raise UsageError(
        f"the PR2's URDF was looked for as {_PR2_URDF} below {len(prefixes)} prefixes and not found; "
        "install example-robot-data (pip install example-robot-data), or give the path of a URDF"
    )


@dataclass(frozen=True, eq=False)
class LinkSurface:
    """A link's collision surface: triangles (F, 3, 3) in metres, in the frame its owner states."""

    link: str
    triangles: FloatArray


class UrdfModel:
    """A robot at one pose: base placed in the world, named joints set, every other joint at zero.

    Args:
        urdf: path of the URDF.
        T_world_base: (4, 4) pose of the URDF's root link.
        joints: angle in rad or travel in m of the joints that are not at zero.

    Raises:
        UsageError: if the file cannot be read or a joint is unknown.
    """

    def __init__(self, urdf: Path, T_world_base: FloatArray, joints: Mapping[str, float]) -> None:
        self._model, self._geometry = _load(urdf)
        self._T_world_base = pin.SE3(np.array(T_world_base, dtype=np.float64))
        self._data = self._model.createData()
        q = pin.neutral(self._model)
        for name, value in joints.items():
            joint = self._model.joints[self._joint_id(name)]
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value))  # continuous joints are stored as cos, sin
            )
        pin.framesForwardKinematics(self._model, self._data, q)

    def limits(self, joint: str) -> tuple[float, float]:
        """Return a joint's lower and upper limit in rad or m, -inf and inf for a continuous joint."""
        which = self._model.joints[self._joint_id(joint)]
        if which.nq == 2:
            return -np.inf, np.inf
        return (
            float(self._model.lowerPositionLimit[which.idx_q]),
            float(self._model.upperPositionLimit[which.idx_q]),
        )

    def frame_pose(self, frame: str) -> FloatArray:
        """Return the (4, 4) world pose of a link or other frame."""
        pose: FloatArray = (self._T_world_base * self._data.oMf[self._frame_id(frame)]).homogeneous
        return pose

    def link_of(self, joint: str) -> str:
        """Return the name of the link that a joint moves (the URDF's child link)."""
        index = self._joint_id(joint)
        return next(
            str(frame.name)
            for frame in self._model.frames
            if frame.parentJoint == index and frame.type == pin.FrameType.BODY
        )

    def chain(self, joints: Sequence[str], tool_frame: str) -> KinematicChain:
        """Return the serial chain through `joints`, rooted in the frame the first of them hangs on.

        Raises:
            UsageError: if the joints do not follow each other, or one is not a hinge.
        """
        model, indices = self._model, [self._joint_id(name) for name in joints]
        for before, after in pairwise(indices):
            if model.parents[after] != before:
                raise UsageError(
                    f"chain: wanted joints that follow each other, got {model.names[after]} after "
                    f"{model.names[before]}; list every joint from root to tool"
                )
        axes = []
        for index in indices:
            motion = np.asarray(_motion_subspace(model.joints[index]))
            if motion.shape != (6,) or motion[:3].any():
                raise UsageError(f"chain: wanted hinges, got {model.joints[index].shortname()} {model.names[index]}")
            axes.append(motion[3:])
        limits = np.array([self.limits(name) for name in joints])
        placements = [model.jointPlacements[index] for index in indices]
        root = self._T_world_base * self._data.oMi[model.parents[indices[0]]]
        tool = self._data.oMi[indices[-1]].inverse() * self._data.oMf[self._frame_id(tool_frame)]
        return KinematicChain(
            joint_names=tuple(joints),
            joint_origin_m=np.array([placement.translation for placement in placements]),
            joint_rotation=np.array([placement.rotation for placement in placements]),
            joint_axis=np.array(axes),
            T_world_root=root.homogeneous,
            T_last_tool=tool.homogeneous,
            lower=limits[:, 0],
            upper=limits[:, 1],
            continuous=np.isinf(limits[:, 0]),
            velocity_limit=np.array([model.velocityLimit[model.joints[index].idx_v] for index in indices]),
        )

    def moving_surfaces(self, joints: Sequence[str]) -> list[list[LinkSurface]]:
        """Return, for each of `joints`, the collision surfaces that move with it, in its frame.

        What hangs on other joints further out (fingers) counts with the last of `joints` before it.
        """
        indices = [self._joint_id(name) for name in joints]
        moving: list[list[LinkSurface]] = [[] for _ in joints]
        for item in self._geometry.geometryObjects:
            owners = [indices.index(i) for i in self._model.supports[item.parentJoint] if i in indices]
            if owners:
                owner = owners[-1]
                T_owner_item = self._data.oMi[indices[owner]].inverse() * self._placement(item)
                moving[owner].append(LinkSurface(self._link_name(item), _triangles(item, T_owner_item)))
        return moving

    def fixed_surfaces(self, joints: Sequence[str]) -> list[tuple[LinkSurface, FloatArray]]:
        """Return the collision surfaces that none of `joints` moves, each with its frame.

        Returns:
            (surface in the frame of its link's geometry, (4, 4) world pose of that frame).
        """
        indices = {self._joint_id(name) for name in joints}
        return [
            (
                LinkSurface(self._link_name(item), _triangles(item, pin.SE3.Identity())),
                (self._T_world_base * self._placement(item)).homogeneous,
            )
            for item in self._geometry.geometryObjects
            if not indices.intersection(self._model.supports[item.parentJoint])
        ]

    def _placement(self, item: Any) -> Any:
        return self._data.oMi[item.parentJoint] * item.placement

    def _link_name(self, item: Any) -> str:
        return str(self._model.frames[item.parentFrame].name)

    def _joint_id(self, name: str) -> int:
        if not self._model.existJointName(name):
            known = ", ".join(list(self._model.names)[1:])
            raise UsageError(f"robot: wanted a joint of {self._model.name}, got {name!r}; it has {known}")
        return int(self._model.getJointId(name))

    def _frame_id(self, name: str) -> int:
        if not self._model.existFrame(name):
            raise UsageError(f"robot: wanted a frame of {self._model.name}, got {name!r}; see the URDF's links")
        return int(self._model.getFrameId(name))


@lru_cache(maxsize=4)
def _load(urdf: Path) -> tuple[Any, Any]:
    if not urdf.is_file():
        raise UsageError(f"robot: wanted a URDF file, got {urdf}, which does not exist")
    # package:// names a folder above the URDF, whatever that package is called in this installation.
    package_dirs = [str(parent) for parent in urdf.resolve().parents]
    try:
        model = pin.buildModelFromUrdf(str(urdf))
        geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION, package_dirs=package_dirs)
    except (ValueError, RuntimeError) as trouble:
        raise UsageError(f"robot: wanted a readable URDF with its meshes, got {urdf}: {trouble}") from trouble
    return model, geometry


def _motion_subspace(joint: Any) -> Any:
    data = joint.createData()
    joint.calc(data, np.array([1.0, 0.0]) if joint.nq == 2 else np.zeros(joint.nq))
    return data.S


def _triangles(item: Any, T_frame_item: Any) -> FloatArray:
    """Return a collision geometry's triangles (F, 3, 3) in the frame given."""
    shape = item.geometry
    if hasattr(shape, "tri_indices"):
        corners = np.array(shape.vertices())
        faces = np.array([[shape.tri_indices(f)[k] for k in range(3)] for f in range(shape.num_tris)])
    elif hasattr(shape, "halfSide"):
        corners, faces = _BOX_CORNERS * shape.halfSide, _BOX_TRIANGLES
    else:
        raise UsageError(
            f"robot: wanted collision meshes or boxes, got {type(shape).__name__} on {item.name}; "
            "describe that link by a mesh or a box in the URDF"
        )
    triangles: FloatArray = (corners @ T_frame_item.rotation.T + T_frame_item.translation)[faces]
    return triangles
