"""A human as a kinematic chain with a body, read from a URDF: the one definition of posture that every stage uses.

The transforms are computed by a compiled kernel for all postures of a motion at once; it agrees with pinocchio to
rounding (tested). Points and link poses are in the frame of the URDF's root link, the tracker's frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import HumanModelError, UsageError
from humanpred_ros.files import read_text
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.description import Body
from humanpred_ros.geometry.joints import Joints
from humanpred_ros.geometry.urdf import parse_description
from humanpred_ros.resources import share_file

#: Names users know the humans by, and whose they are; the default first.
HUMANS = {
    "kinect12": "P1: 12 DoFs, as a Kinect tracker sees a person",
    "mocap23": "P2: 23 DoFs, as motion capture sees trunk and right arm",
}
#: Frames of the trackers that see them so, where nobody says otherwise.
TRACKER_FRAMES = {"kinect12": "kinect", "mocap23": "mocap"}

#: Bodies of people are smaller, and have fewer parts.
_LARGEST_M, _MOST = 5.0, 300

T = TypeVar("T", bound=np.generic)

#: The DoFs of P2's human, in the order of its recordings' columns (docs/papers.md, P2 human).
MOCAP23_DOFS = (
    "PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotX", "PelvisRotY", "PelvisRotZ",
    "TorsoX", "TorsoZ", "TorsoY", "rShoulderTransX", "rShoulderTransY", "rShoulderTransZ",
    "rShoulderY1", "rShoulderX", "rShoulderY2", "rArmTrans", "rElbowZ", "rElbowX", "rElbowY",
    "rForeArmTrans", "rWristZ", "rWristX", "rWristY",
)  # fmt: skip


class SurfacePoints(NamedTuple):
    """Points on the surface of a model's bodies, fixed to its links; read-only."""

    link: NDArray[np.int64]  #: (P,) index of each point's link in the model's `link_names`
    local_m: FloatArray  #: (P, 3) the points in their links' frames


class HumanModel:
    """Kinematics and body of a human; immutable, and safe to use from several threads.

    Attributes:
        name: the URDF's robot name.
        urdf: the URDF text, as published on `/humans/bodies/<id>/urdf`.
        dof_names: D names, in the order of the postures' columns.
        lower, upper: (D,) joint limits, metres and radians.
        link_names: L names, the root first, a parent always before its children.
        joints: the moving joints in the order of `dof_names`.
        link_joint: (L,) number of the joint each link is fixed to: 0 for the root, j + 1 for DoF j.
        T_joint_link: (L, 4, 4) pose of each link in that joint.
        bodies: the solids the human is made of.
        signature: sha256 (hex) of what defines kinematics and bodies; layout and comments of the file do not enter.

    Raises:
        HumanModelError: not a URDF, or one with joints other than fixed and limited one-DoF joints.
    """

    def __init__(self, urdf: str) -> None:
        # The text may come from a recording: it names no files and defines no entities.
        if "<mesh" in urdf or "<!" in urdf.replace("<!--", ""):
            raise HumanModelError(
                "human model: wanted boxes, cylinders or spheres as <collision>, and no document type, got others; "
                "replace meshes by such solids"
            )
        try:
            said = parse_description(urdf)
        except UsageError as trouble:
            raise HumanModelError(f"human model: {trouble}") from trouble
        self.urdf, self.name, self.signature = urdf, said.name, said.signature
        for name, kind in zip(said.joint_names, said.kind, strict=True):
            if kind not in ("revolute", "prismatic") or name in said.mimic:
                found = "a mimic joint" if name in said.mimic else kind
                raise HumanModelError(
                    f"human model {self.name}: joint {name} is {found}; wanted prismatic or revolute joints (write a "
                    "continuous joint as revolute with limits)"
                )
        if not said.joint_names:
            raise HumanModelError(f"human model {self.name}: wanted at least one moving joint, got none")
        lengths = [float(x) for body in said.bodies for x in (*vars(body.shape).values(), *body.T_link_body[:3, 3])]
        lengths += [*said.T_parent_joint[:, :3, 3].ravel(), *said.T_joint_link[:, :3, 3].ravel()]
        if max(map(abs, lengths), default=0.0) > _LARGEST_M or max(len(said.joint_names), len(said.bodies)) > _MOST:
            raise HumanModelError(
                f"human model {self.name}: wanted lengths up to {_LARGEST_M:g} m, and up to {_MOST} joints and bodies, "
                "got more; a person is smaller"
            )
        self.dof_names: tuple[str, ...] = said.joint_names
        self.bodies: tuple[Body, ...] = said.bodies
        self.lower, self.upper = _readonly(said.lower), _readonly(said.upper)
        self.joints: Joints = said.joints
        self.link_names: tuple[str, ...] = said.link_names
        self.link_joint, self.T_joint_link = said.link_joint, said.T_joint_link
        self._surfaces: dict[float, SurfacePoints] = {}

    @classmethod
    def kinect12(cls) -> HumanModel:
        """Return P1's 12-DoF human, as a Kinect tracker sees a person (docs/papers.md, P1 human)."""
        return cls.from_urdf(share_file("urdf", "human_kinect12.urdf"))

    @classmethod
    def mocap23(cls) -> HumanModel:
        """Return P2's 23-DoF human, as motion capture sees trunk and right arm (docs/papers.md, P2 human)."""
        return cls.from_urdf(share_file("urdf", "human_mocap23.urdf"))

    @classmethod
    def from_urdf(cls, path: str | Path) -> HumanModel:
        """Return the model of a URDF file (HumanModelError if it cannot be read or used)."""
        return cls(read_text(Path(path), HumanModelError))

    def __repr__(self) -> str:
        return f"HumanModel({self.name!r}, {len(self.dof_names)} DoF, {self.signature[:8]})"

    def __reduce__(self) -> tuple[type[HumanModel], tuple[str]]:
        return (HumanModel, (self.urdf,))  # cheap to rebuild, and pinocchio objects stay out of pickles

    def check_dofs(self, names: Sequence[str]) -> None:
        """Check that `names` are this model's DoFs in its order.

        Raises:
            HumanModelError: with the unknown and the missing names, or the first place where the order differs.
        """
        names = tuple(names)
        if names == self.dof_names:
            return
        unknown = [name for name in names if name not in self.dof_names]
        missing = [name for name in self.dof_names if name not in names]
        doubled = sorted({name for name in names if names.count(name) > 1})
        said = [f"{word}: {', '.join(found)}" for word, found in
                (("unknown", unknown), ("missing", missing), ("more than once", doubled)) if found]  # fmt: skip
        if not said:
            k = next(i for i, (got, want) in enumerate(zip(names, self.dof_names, strict=True)) if got != want)
            said = [f"another order: DoF {k} is {names[k]} instead of {self.dof_names[k]}"]
        raise HumanModelError(
            f"human model {self.name}: wanted its {len(self.dof_names)} DoFs in its order, got {len(names)} names "
            f"({'; '.join(said)}); use {', '.join(self.dof_names)}"
        )

    @cached_property
    def dof_index(self) -> Mapping[str, int]:
        """Column of each DoF in a posture."""
        return {name: i for i, name in enumerate(self.dof_names)}

    def link_poses(self, q: ArrayLike) -> FloatArray:
        """Return the poses (T, L, 4, 4) of all links for postures (T, D); (L, 4, 4) for one posture (D,).

        Raises:
            HumanModelError: wrong shape or values that are not finite.
        """
        postures = self._checked(q)
        from humanpred_ros.geometry.chain_kernels import link_poses  # numba, which not every node needs

        postures = np.require(postures, requirements="W")  # numba compiles once more for what is read-only
        poses = link_poses(postures, self.joints, self.link_joint, self.T_joint_link)
        return poses[0] if np.ndim(q) == 1 else poses

    def forward(self, q: ArrayLike) -> dict[str, FloatArray]:
        """Return where the origin of each link is: name -> (T, 3) for postures (T, D), (3,) for one posture (D,).

        The links of the package's URDFs are named after the points of the body at their origins: pelvis, torso, neck,
        head, right_shoulder, right_elbow, right_wrist, right_palm, the same on the left, hips, knees and feet.
        """
        poses = self.link_poses(q)
        return {name: poses[..., i, :3, 3] for i, name in enumerate(self.link_names)}

    def body_poses(self, q: ArrayLike) -> FloatArray:
        """Return the poses (T, B, 4, 4) of `bodies` for postures (T, D); (B, 4, 4) for one posture (D,)."""
        links = [self.link_names.index(body.link) for body in self.bodies]
        local = np.array([body.T_link_body for body in self.bodies]).reshape(-1, 4, 4)
        poses: FloatArray = self.link_poses(q)[..., links, :, :] @ local
        return poses

    def surface(self, spacing_m: float) -> SurfacePoints:
        """Return points so that no surface point of any body is farther than `spacing_m` (metres) from one of them.

        Neighbours are at most `spacing_m` apart on the surface, and each body is covered whole, also where it lies
        inside another: that keeps the points independent of the posture, and such points fall in voxels that are
        occupied anyway.

        Raises:
            HumanModelError: a model without bodies, or a spacing that is not a positive length.
        """
        if not (np.isfinite(spacing_m) and spacing_m > 0):
            raise HumanModelError(f"surface points: wanted a positive spacing in metres, got {spacing_m}")
        if not self.bodies:
            raise HumanModelError("surface points: wanted a model with at least one <collision>, got none; add bodies")
        if spacing_m not in self._surfaces:
            points = [body.shape.sample(spacing_m) @ body.T_link_body[:3, :3].T + body.T_link_body[:3, 3]
                      for body in self.bodies]  # fmt: skip
            links = np.repeat([self.link_names.index(body.link) for body in self.bodies], [len(p) for p in points])
            self._surfaces[spacing_m] = SurfacePoints(_readonly(links), _readonly(np.concatenate(points)))
        return self._surfaces[spacing_m]

    def surface_points(self, q: ArrayLike, spacing_m: float = 0.02) -> FloatArray:
        """Return points (T, P, 3) on the body's surface for postures (T, D); (P, 3) for one posture (D,).

        Args:
            q: postures.
            spacing_m: greatest distance from the surface to its nearest point; 0.02 m is P1's for 0.05 m voxels.
        """
        surface, poses = self.surface(spacing_m), self.link_poses(q)
        points = np.empty((*poses.shape[:-3], len(surface.link), 3))
        for link in np.unique(surface.link):
            mine = surface.link == link
            R, p = poses[..., link, :3, :3], poses[..., link, :3, 3]
            points[..., mine, :] = surface.local_m[mine] @ np.swapaxes(R, -1, -2) + p[..., None, :]
        return points

    def _checked(self, q: ArrayLike) -> FloatArray:
        shape = (len(self.dof_names),) if np.ndim(q) == 1 else ("T", len(self.dof_names))
        return np.atleast_2d(checked(f"postures of {self.name}", q, shape, error=HumanModelError))


def _readonly(array: NDArray[T]) -> NDArray[T]:
    array = np.array(array)
    array.setflags(write=False)
    return array


def human_named(name: str) -> HumanModel:
    """Return the human of that name.

    Raises:
        UsageError: another name.
    """
    if name not in HUMANS:
        raise UsageError(f"human: wanted one of {', '.join(HUMANS)}, got {name!r}")
    return HumanModel.mocap23() if name == "mocap23" else HumanModel.kinect12()


def human_with(dof_names: Sequence[str]) -> HumanModel:
    """Return the human that has these DoFs in this order; errors as `name_of_human`."""
    return human_named(name_of_human(dof_names))


def name_of_human(dof_names: Sequence[str]) -> str:
    """Return the name of the human that has these DoFs in this order.

    Raises:
        HumanModelError: none of them has; the message is about the one that comes nearest.
    """
    humans = {name: human_named(name) for name in HUMANS}
    shared = {name: len(set(human.dof_names) & set(dof_names)) for name, human in humans.items()}
    nearest = max(humans, key=lambda name: shared[name] / len(humans[name].dof_names))
    humans[nearest].check_dofs(dof_names)
    return nearest
