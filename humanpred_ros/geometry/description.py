"""What a URDF says of a robot or a person, as plain arrays (joints, links, collision geometry), and where it stands."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.chain import KinematicChain, inverse_pose
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.joints import Joints
from humanpred_ros.geometry.solids import Shape

TURNING, SLIDING = ("revolute", "continuous"), ("prismatic",)


@dataclass(frozen=True, eq=False)
class Body:
    """One collision solid, fixed to a link."""

    name: str  #: the collision element's name, or the link's if it has none
    link: str  #: name of the link it moves with
    shape: Shape  #: the solid in its own frame
    T_link_body: FloatArray  #: (4, 4) pose of that frame in the link

    @property
    def triangles(self) -> FloatArray:
        """Its surface (F, 3, 3) in its own frame; at round places a little outside."""
        return self.shape.triangles()


@dataclass(frozen=True, eq=False)
class MeshBody:
    """One collision mesh, fixed to a link: as `Body`, with triangles (F, 3, 3) in metres instead of a solid."""

    name: str
    link: str
    triangles: FloatArray
    T_link_body: FloatArray


class LinkSurface(NamedTuple):
    """A link's collision surface, in the frame its owner states."""

    link: str
    triangles: FloatArray  #: (F, 3, 3) in metres
    shape: Shape | None = None  #: the solid that it is the surface of, if it is one
    centre_m: FloatArray | None = None  #: (3,) that solid's centre


class Mimic(NamedTuple):
    """A joint that follows another one: its value is `multiplier` times that joint's plus `offset` (rad or m)."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Description:
    """A tree of links, joints and collision solids. Joint 0 is the root, joint j of the arrays has number j + 1."""

    name: str  #: the robot's name in the URDF
    joint_names: tuple[str, ...]  #: J names of the joints that move, a parent always before its children
    #: J URDF types: revolute, continuous, prismatic, floating or planar. The last two are kept at zero.
    kind: tuple[str, ...]
    parent: NDArray[np.int64]  #: (J,) number of the joint before
    T_parent_joint: FloatArray  #: (J, 4, 4) pose of each joint at zero in the joint before
    axis: FloatArray  #: (J, 3) unit axes in the joints' own frames
    lower: FloatArray  #: (J,) limits in rad or m, -inf and inf for continuous joints
    upper: FloatArray
    velocity_limit: FloatArray  #: (J,) rad/s or m/s, inf where the URDF states none
    mimic: Mapping[str, Mimic]  #: joints that follow others, by name
    link_names: tuple[str, ...]  #: L names, the root first, a parent always before its children
    link_joint: NDArray[np.int64]  #: (L,) number of the joint each link is fixed to
    T_joint_link: FloatArray  #: (L, 4, 4) pose of each link in that joint
    bodies: tuple[Body, ...]  #: the collision solids, in the order of the file
    meshes: tuple[MeshBody, ...] = ()  #: the collision meshes, in the same order
    files: tuple[tuple[str, int, int], ...] = ()  #: name, size and time of change (ns) of each mesh that was read

    @property
    def collisions(self) -> tuple[Body | MeshBody, ...]:
        """Solids and meshes."""
        return (*self.bodies, *self.meshes)

    @cached_property
    def joints(self) -> Joints:
        """The joints as kernels want them; a floating or planar one stands still."""
        axis = np.where(np.isin(self.kind, TURNING + SLIDING)[:, None], self.axis, 0.0)
        return Joints.of(self.parent, self.T_parent_joint, axis, np.isin(self.kind, SLIDING))

    def link_poses(self, values: Mapping[str, float]) -> FloatArray:
        """Return the (L, 4, 4) poses of all links in the root link's frame.

        Args:
            values: rad or m of the joints that are not at zero; joints that mimic one of them follow it.

        Raises:
            UsageError: if a joint is unknown.
        """
        from humanpred_ros.geometry.chain_kernels import link_poses  # numba, which not every reader needs

        q = np.zeros((1, len(self.joint_names)))
        for name, value in values.items():
            q[0, self.joint_index(name)] = value
        for name, mimic in self.mimic.items():
            if name not in values:
                q[0, self.joint_index(name)] = mimic.multiplier * q[0, self.joint_index(mimic.joint)] + mimic.offset
        poses: FloatArray = link_poses(q, self.joints, self.link_joint, self.T_joint_link)[0]
        return poses

    def joint_index(self, name: str) -> int:
        """Return a joint's place in `joint_names`; UsageError if it is unknown."""
        if name not in self.joint_names:
            known = ", ".join(self.joint_names)
            raise UsageError(f"robot: wanted a joint of {self.name}, got {name!r}; it has {known}")
        return self.joint_names.index(name)

    def link_index(self, name: str) -> int:
        """Return a link's place in `link_names`; UsageError if it is unknown."""
        if name not in self.link_names:
            raise UsageError(f"robot: wanted a link of {self.name}, got {name!r}; see the URDF's links")
        return self.link_names.index(name)

    def limits(self, joint: str) -> tuple[float, float]:
        """Return a joint's lower and upper limit in rad or m, -inf and inf for a continuous joint."""
        index = self.joint_index(joint)
        return float(self.lower[index]), float(self.upper[index])

    def link_of(self, joint: str) -> str:
        """Return the name of the link that a joint moves (the URDF's child link)."""
        return self.link_names[int(np.argmax(self.link_joint == self.joint_index(joint) + 1))]

    def supports(self, number: int) -> list[int]:
        """Return the numbers of the joints between the root and joint `number`, that one last."""
        found: list[int] = []
        while number:
            found.append(number)
            number = int(self.parent[number - 1])
        return found[::-1]

    @cached_property
    def signature(self) -> str:
        """sha256 (hex) of what defines kinematics and bodies.

        Layout, comments, how numbers are written, the robot's name, visual geometry and inertias do not enter.
        """
        digest = hashlib.sha256()
        words = (self.joint_names, self.kind, self.parent.tolist(), self.link_names, self.link_joint.tolist())
        digest.update(repr(words).encode())
        numbers = [self.T_parent_joint, self.axis, self.lower, self.upper, self.T_joint_link]
        numbers += [body.T_link_body for body in self.collisions]
        numbers += [mesh.triangles for mesh in self.meshes]
        for array in numbers:
            digest.update(repr((np.round(array, 12) + 0.0).tolist()).encode())  # + 0.0: 0 and -0 are the same
        named = [(body.name, body.link, body.shape) for body in self.bodies], [(m.name, m.link) for m in self.meshes]
        digest.update(repr(named).encode())
        return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class PlacedDescription:
    """A robot that stands somewhere with some joints set and every other joint at zero.

    Raises:
        UsageError: if a joint is unknown.
    """

    description: Description  #: what the URDF says
    T_world_base: FloatArray  #: (4, 4) pose of the root link
    values: Mapping[str, float]  #: rad or m of the joints that are not at zero

    @cached_property
    def _links(self) -> FloatArray:
        """(L, 4, 4) poses of the links in the root link's frame."""
        return self.description.link_poses(self.values)

    def _joint(self, number: int) -> FloatArray:
        """Return the (4, 4) pose of a joint's frame, after its own motion, in the root link's frame."""
        link = int(np.argmax(self.description.link_joint == number))
        pose: FloatArray = self._links[link] @ inverse_pose(self.description.T_joint_link[link])
        return pose

    def chain(self, joints: Sequence[str], tool_frame: str) -> KinematicChain:
        """Return the serial chain through `joints`, rooted in the frame that the first of them hangs on.

        Raises:
            UsageError: if the joints do not follow each other, one is not a hinge, or the tool does not move with the
                last of them.
        """
        said, indices = self.description, [self.description.joint_index(name) for name in joints]
        for before, after in pairwise(indices):
            if said.parent[after] != before + 1:
                raise UsageError(
                    f"chain: wanted joints that follow each other, got {said.joint_names[after]} after "
                    f"{said.joint_names[before]}; list every joint from root to tool"
                )
        for index in indices:
            if said.kind[index] not in TURNING:
                raise UsageError(f"chain: wanted hinges, got the {said.kind[index]} joint {said.joint_names[index]}")
            if said.joint_names[index] in said.mimic:
                followed = said.mimic[said.joint_names[index]].joint
                raise UsageError(
                    f"chain: wanted joints that move alone, got {said.joint_names[index]}, which follows {followed}"
                )
            if not said.lower[index] < said.upper[index]:
                got = f"{said.lower[index]} and {said.upper[index]}"
                raise UsageError(
                    f"chain: wanted limits of {said.joint_names[index]} with lower < upper, got {got}; correct its "
                    "<limit> in the URDF"
                )
        tool = said.link_index(tool_frame)
        if indices[-1] + 1 not in said.supports(int(said.link_joint[tool])):
            raise UsageError(f"chain: wanted a tool that moves with {joints[-1]}, got {tool_frame}, which does not")
        T_base_tool = self._links[tool]
        return KinematicChain(
            joint_names=tuple(joints),
            joint_origin_m=said.T_parent_joint[indices, :3, 3],
            joint_rotation=said.T_parent_joint[indices, :3, :3],
            joint_axis=said.axis[indices],
            T_world_root=self.T_world_base @ self._joint(int(said.parent[indices[0]])),
            T_last_tool=inverse_pose(self._joint(indices[-1] + 1)) @ T_base_tool,
            lower=said.lower[indices],
            upper=said.upper[indices],
            continuous=np.isinf(said.lower[indices]),
            velocity_limit=said.velocity_limit[indices],
        )

    def moving_surfaces(self, joints: Sequence[str]) -> list[list[LinkSurface]]:
        """Return, for each of `joints`, the collision surfaces that move with it, in its frame.

        What hangs on other joints farther out (fingers) counts with the last of `joints` before it.
        """
        numbers = [self.description.joint_index(name) + 1 for name in joints]
        moving: list[list[LinkSurface]] = [[] for _ in joints]
        for surface, supports, T_base_body in self._surfaces():
            owners = [number for number in supports if number in numbers]
            if owners:
                T = inverse_pose(self._joint(owners[-1])) @ T_base_body
                triangles = surface.triangles @ T[:3, :3].T + T[:3, 3]
                moved = surface._replace(triangles=triangles, centre_m=T[:3, 3])
                moving[numbers.index(owners[-1])].append(moved)
        return moving

    def fixed_surfaces(self, joints: Sequence[str]) -> list[tuple[LinkSurface, FloatArray]]:
        """Return the collision surfaces that none of `joints` moves.

        Returns:
            (surface in the body's own frame, (4, 4) world pose of that frame).
        """
        numbers = {self.description.joint_index(name) + 1 for name in joints}
        return [
            (surface, self.T_world_base @ T_base_body)
            for surface, supports, T_base_body in self._surfaces()
            if not numbers.intersection(supports)
        ]

    def _surfaces(self) -> Iterator[tuple[LinkSurface, list[int], FloatArray]]:
        """Yield each body's surface in its own frame, the joints that move it, and its pose in the root's frame."""
        said = self.description
        for index, link in enumerate(said.link_names):
            for body in said.collisions:
                if body.link == link:
                    pose = self._links[index] @ body.T_link_body
                    surface = LinkSurface(link, body.triangles, body.shape if isinstance(body, Body) else None)
                    yield surface, said.supports(int(said.link_joint[index])), pose
