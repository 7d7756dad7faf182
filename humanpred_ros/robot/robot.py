"""A robot's arm before it stands anywhere: its description and file read together, and what stands for its links.

Everything is derived from the URDF and its collision geometry when it is asked for, so a changed URDF cannot disagree
with a stored copy. Arms of one robot share it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros.errors import HumanPredError, RobotError
from humanpred_ros.geometry.chain import BodyBoxes, BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.description import Description, LinkSurface, PlacedDescription
from humanpred_ros.geometry.solids import Box, Sphere
from humanpred_ros.geometry.urdf import read_description
from humanpred_ros.robot.robot_file import RobotFile, find_source, read_robot_file, robot_path
from humanpred_ros.robot.semantics import Pair, Semantics, pair_of, read_srdf, with_spheres
from humanpred_ros.robot.surface import Bounds, covering_boxes, covering_spheres, sample

#: Between 3 and 5 cm: fine against a forearm's width, coarse enough for some 180 points on an arm.
BODY_POINT_SPACING_M = 0.04
#: Largest spheres of a link, as a share of the radius of the column that holds it: some 40 on an arm. Larger ones would
#: stick out farther. None is larger than the most or, on thin links, smaller than the least, m.
_SHARE, _LEAST_SPHERE_M, _MOST_SPHERE_M = 0.85, 0.03, 0.075
_LARGEST_SHOULDER_SPHERE_M = 0.1  # only decides whether a scene leaves the shoulder room
#: A sphere is a box of no size with a round edge; boxes need a size, m.
_NO_SIZE_M = 1e-9
#: No arm is longer: metres were meant for millimetres.
_LONGEST_LINK_M = 10.0
_WEIGHT_SAMPLES = 256
#: So the seven weights found for the PR2 add up to P1's.
_UNIT = 1.5


@dataclass(frozen=True, eq=False)
class Robot:
    """An arm as its file and its description give it; made by `load_robot`.

    Raises:
        RobotError: for a file that does not fit the description.
    """

    file: RobotFile
    path: Path  #: of the file
    urdf: Path  #: of the description
    description: Description
    collision: Description  #: the same with spheres from a file instead of the collision geometry, where there is one
    semantic: Semantics

    def __post_init__(self) -> None:
        said, file = self.description, self.file
        n = len(file.joints)
        for name in (file.tool_frame, *([file.base_frame] if file.base_frame else ())):
            said.link_index(name)
        for name in (*file.standing, *(joint for joints in file.scene_keys.values() for joint in joints)):
            self.check_standing(name)
        for what in ("velocity_limit", "acceleration_limit", "distance_weights"):
            given = getattr(file, what)
            if given is not None and len(given) not in (1, n):
                raise RobotError(f"{what}: wanted one number or {n}, got {len(given)}; give one for each of joints")
        for name, q in file.states.items():
            if len(q) != n:
                raise RobotError(f"states: {name}: wanted {n} numbers, got {len(q)}; give one for each of joints")
        for number in said.supports(said.joint_index(file.joints[0]) + 1):
            if said.kind[number - 1] in ("floating", "planar"):
                raise RobotError(
                    f"joints: wanted an arm that stands on joints that turn or slide, got the {said.kind[number - 1]} "
                    f"joint {said.joint_names[number - 1]} below it; make that fixed in the URDF"
                )
        for name, mimic in said.mimic.items():
            if mimic.joint in file.joints:
                raise RobotError(f"joints: wanted joints that move alone, got {mimic.joint}, which {name} follows")
        links = [*file.collision.shoulder, *file.collision.largest_sphere_of_m]
        links += [link for pair in file.collision.pairs_left_out for side in pair for link in side]
        for link in links:
            if link not in said.link_names:
                raise RobotError(f"collision: wanted links of {said.name}, got {link!r}; see the URDF's links")
        chain = self.chain(PlacedDescription(said, np.eye(4), {}))
        for joint, speed in zip(file.joints, chain.velocity_limit, strict=True):
            if not np.isfinite(speed):
                raise RobotError(
                    f"velocity_limit: wanted one of {joint}, got none in file and URDF; add velocity_limit to the file"
                )
        if not any(self._moving):
            raise RobotError(
                f"description: wanted collision geometry on links that {', '.join(file.joints)} move, got none; name a "
                "file with collision: spheres, or add <collision> to the URDF"
            )
        for surface in (surface for surfaces in self._moving for surface in surfaces):
            if (size := float(np.abs(surface.triangles).max())) > _LONGEST_LINK_M:
                raise RobotError(
                    f"description: wanted metres, got {surface.link}, which is {size:.0f} m long; millimetres want "
                    'scale="0.001 0.001 0.001" in the URDF\'s <mesh>'
                )
        shoulder = {self.joint_of_link(link) for link in file.collision.shoulder}
        if not shoulder <= {0, 1}:
            raise RobotError("collision: shoulder: wanted links that the first two joints move, got others; correct it")

    @property
    def name(self) -> str:
        """What messages and reports call it."""
        return self.file.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The J joints that are planned for."""
        return self.file.joints

    def chain(self, placed: PlacedDescription) -> KinematicChain:
        """Return the arm's kinematics, placed."""
        chain = placed.chain(self.file.joints, self.file.tool_frame)
        changes: dict[str, Any] = {
            name: np.array(np.broadcast_to(given, (chain.n_joints,)), dtype=np.float64)
            for name in ("velocity_limit", "acceleration_limit")
            if (given := getattr(self.file, name)) is not None
        }
        return replace(chain, **changes) if changes else chain

    def check_standing(self, joint: str) -> None:
        """Check that a joint may stand still; raises RobotError for one of the arm's, or without a value."""
        kind = self.description.kind[self.description.joint_index(joint)]
        if joint in self.file.joints or kind in ("floating", "planar"):
            why = "is planned for" if joint in self.file.joints else f"is {kind}"
            raise RobotError(f"standing: wanted joints that turn or slide and stand still, got {joint}, which {why}")

    @cached_property
    def standing(self) -> dict[str, float]:
        """Value (rad or m) of each joint that stands still and is not at zero."""
        said, values = self.description, dict(self.file.standing)
        for name, kind, lower, upper in zip(said.joint_names, said.kind, said.lower, said.upper, strict=True):
            ours = name in self.file.joints or name in said.mimic or kind in ("floating", "planar")
            if name not in values and not ours and not lower <= 0.0 <= upper:
                values[name] = float(np.clip(0.0, lower, upper))
        return {name: float(value) for name, value in values.items()}

    def joint_of_link(self, link: str) -> int:
        """Return which of the arm's joints a link moves with, -1 if with none."""
        said = self.description
        numbers = [said.joint_index(name) + 1 for name in self.file.joints]
        supports = said.supports(int(said.link_joint[said.link_index(link)]))
        return max((numbers.index(number) for number in supports if number in numbers), default=-1)

    def state(self, name: str) -> FloatArray:
        """Return a configuration (J,) by its name in the robot's file or SRDF.

        Raises:
            RobotError: for an unknown name, or one that says nothing of one of the joints.
        """
        if name in self.file.states:
            return np.array(self.file.states[name], dtype=np.float64)
        values = self.semantic.states.get(name)
        if values is None:
            known = ", ".join([*self.file.states, *self.semantic.states]) or "none"
            raise RobotError(f"state: wanted one of {self.name}'s ({known}), got {name!r}; name one, or give joints")
        missing = [joint for joint in self.file.joints if joint not in values]
        if missing:
            raise RobotError(f"state {name}: wanted all of {self.name}'s joints, got none of {', '.join(missing)}")
        return np.array([values[joint] for joint in self.file.joints])

    @cached_property
    def _hand(self) -> dict[str, float]:
        """Those of the standing joints that move with the arm: fingers. What else stands does not change its links."""
        said = self.description
        arm = {said.joint_index(name) + 1 for name in self.file.joints}
        return {
            name: value
            for name, value in self.standing.items()
            if arm.intersection(said.supports(said.joint_index(name) + 1))
        }

    @cached_property
    def _moving(self) -> list[list[LinkSurface]]:
        return PlacedDescription(self.collision, np.eye(4), self._hand).moving_surfaces(self.file.joints)

    def _parts(self, *, shoulder: bool) -> list[tuple[int, LinkSurface]]:
        """Return joint and surface of every moving body: of the shoulder, or of all others."""
        left_out = set(self.file.collision.shoulder)
        return [
            (joint, surface)
            for joint, surfaces in enumerate(self._moving)
            for surface in surfaces
            if (surface.link in left_out) == shoulder
        ]

    def body_points(self, spacing_m: float = BODY_POINT_SPACING_M) -> BodyPoints:
        """Sample the surfaces of all moving links but the shoulder's, in joint order.

        Args:
            spacing_m: least distance between two points of a joint, and the largest gap between them.
        """
        link, points = [], []
        by_joint: dict[int, list[FloatArray]] = {}
        for joint, surface in self._parts(shoulder=False):
            by_joint.setdefault(joint, []).append(surface.triangles)
        for joint, triangles in by_joint.items():
            part = sample(np.concatenate(triangles), spacing_m)
            link.append(np.full(len(part), joint))
            points.append(part)
        return BodyPoints(np.concatenate(link), np.concatenate(points))

    def link_surfaces(self) -> dict[str, FloatArray]:
        """Return the surface (F, 3, 3) of every moving link but the shoulder's, in the frame of its joint."""
        found: dict[str, list[FloatArray]] = {}
        for _, surface in self._parts(shoulder=False):
            found.setdefault(surface.link, []).append(surface.triangles)
        return {link: np.concatenate(triangles) for link, triangles in found.items()}

    @cached_property
    def spheres(self) -> BodySpheres:
        """Spheres that cover the surfaces of all moving links but the shoulder's, in joint order."""
        return self._sphere_cover(shoulder=False)[0]

    @cached_property
    def sphere_links(self) -> tuple[str, ...]:
        """(S,) the link that each of `spheres` covers."""
        return self._sphere_cover(shoulder=False)[1]

    @cached_property
    def shoulder_spheres(self) -> BodySpheres | None:
        """Spheres that cover the shoulder, in joint order; None for an arm all of which is planned for."""
        return self._sphere_cover(shoulder=True)[0] if self.file.collision.shoulder else None

    def _sphere_cover(self, *, shoulder: bool) -> tuple[BodySpheres, tuple[str, ...]]:
        link, centres, radii, links = [], [], [], list[str]()
        for joint, surface in self._parts(shoulder=shoulder):
            if isinstance(surface.shape, Sphere) and surface.centre_m is not None:
                centre, radius = surface.centre_m[None], np.array([surface.shape.radius_m])
            else:
                largest_m = _LARGEST_SHOULDER_SPHERE_M if shoulder else self._largest_sphere_m(surface)
                centre, radius = covering_spheres(surface.triangles, largest_m)
            link.append(np.full(len(radius), joint))
            centres.append(centre)
            radii.append(radius)
            links += [surface.link] * len(radius)
        return BodySpheres(np.concatenate(link), np.concatenate(centres), np.concatenate(radii)), tuple(links)

    def _largest_sphere_m(self, surface: LinkSurface) -> float:
        said = self.file.collision
        given = said.largest_sphere_of_m.get(surface.link, said.largest_sphere_m)
        if given is not None:
            return given
        return float(np.clip(_SHARE * slimness_m(surface.triangles), _LEAST_SPHERE_M, _MOST_SPHERE_M))

    @cached_property
    def inner_boxes(self) -> tuple[BodyBoxes, tuple[str, ...]]:
        """Boxes that fill the moving links, in joint order, and the link that each fills: what others can run into."""
        boxes: list[tuple[int, FloatArray, FloatArray, float]] = []
        saving_m3 = self.file.collision.box_saving_m3
        links: list[str] = []
        for joint, surface in ((joint, one) for joint, surfaces in enumerate(self._moving) for one in surfaces):
            if isinstance(surface.shape, Sphere) and surface.centre_m is not None:
                found = [(joint, surface.centre_m, np.full(3, _NO_SIZE_M), surface.shape.radius_m)]
            else:
                found = [
                    (joint, (lower + upper) / 2.0, (upper - lower) / 2.0, 0.0)
                    for lower, upper in covering_boxes(surface.triangles, saving_m3)
                ]
            boxes += found
            links += [surface.link] * len(found)
        link, centre, half, round_m = (np.array(part) for part in zip(*boxes, strict=True))
        return BodyBoxes(link, centre, half, round_m), tuple(links)

    @cached_property
    def fixed_boxes(self) -> tuple[tuple[Bounds, ...], ...]:
        """Boxes that fill each fixed surface of the collision geometry, in its own frame; none for round solids."""
        surfaces = PlacedDescription(self.collision, np.eye(4), {}).fixed_surfaces(self.file.joints)
        saving_m3 = self.file.collision.box_saving_m3
        return tuple(
            tuple(covering_boxes(surface.triangles, saving_m3))
            if surface.shape is None or isinstance(surface.shape, Box)
            else ()
            for surface, _ in surfaces
        )

    @cached_property
    def left_out(self) -> frozenset[Pair]:
        """Pairs of links that file or SRDF leave out, or that are next to each other: of one joint, or two in a row."""
        said, file = self.description, self.file
        pairs = {
            pair_of(a, b) for one, other in file.collision.pairs_left_out for a in one for b in other if a != b
        } | self.semantic.left_out
        moved = {said.joint_index(name) + 1 for name in file.joints}
        links = {surface.link: int(said.link_joint[said.link_index(surface.link)]) for surface in self._surfaces}

        def carrier(number: int) -> int:
            """Return the nearest joint inwards that moves: what stands still in between joins links to one body."""
            while number and number not in moved:
                number = int(said.parent[number - 1])
            return number

        before = {number: carrier(int(said.parent[number - 1])) for number in moved}
        for a, number_a in links.items():
            for b, number_b in links.items():
                one, other = carrier(number_a), carrier(number_b)
                if a < b and (one == other or before.get(one) == other or before.get(other) == one):
                    pairs.add(pair_of(a, b))
        return frozenset(pairs)

    @property
    def _surfaces(self) -> list[LinkSurface]:
        fixed = PlacedDescription(self.collision, np.eye(4), {}).fixed_surfaces(self.file.joints)
        return [surface for surface, _ in fixed] + [surface for part in self._moving for surface in part]

    @cached_property
    def distance_weights(self) -> FloatArray:
        """(J,) configuration distance of one radian of each joint, as the file gives them.

        Without any, from how far a joint moves what it carries: mean distance of the body points from its axis, over
        configurations drawn within the limits, in the unit of P1's weights.
        """
        n = len(self.file.joints)
        if self.file.distance_weights is not None:
            return np.array(np.broadcast_to(self.file.distance_weights, (n,)), dtype=np.float64)
        chain = self.chain(PlacedDescription(self.description, np.eye(4), {}))
        lower = np.where(chain.continuous, -np.pi, chain.lower)
        upper = np.where(chain.continuous, np.pi, chain.upper)
        q = np.random.default_rng(0).uniform(lower, upper, (_WEIGHT_SAMPLES, n))
        poses, points = chain.link_poses(q), self.body_points()
        world = points.world_m(chain, q)
        weights = np.empty(n)
        for j in range(n):
            axis = poses[:, j, :3, :3] @ chain.joint_axis[j]
            beyond = world[:, points.link >= j] - poses[:, None, j, :3, 3]
            weights[j] = _UNIT * np.linalg.norm(np.cross(beyond, axis[:, None]), axis=-1).mean() if beyond.size else 0.0
        return np.maximum(weights, 1e-3)


def slimness_m(triangles: FloatArray) -> float:
    """Return the radius of the round column along the longest side of a surface (F, 3, 3) that holds it, metres."""
    corners = triangles.reshape(-1, 3)
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    across = np.delete(corners - (lower + upper) / 2.0, int(np.argmax(upper - lower)), axis=1)
    return float(np.linalg.norm(across, axis=1).max())


def load_robot(name_or_path: str | Path) -> Robot:
    """Return a robot: of the package by name (`panda`), or of a YAML file by its path.

    Raises:
        RobotError: with the file, the place in it, what was wanted and what to do.
    """
    path = robot_path(name_or_path).absolute()
    try:
        state = os.stat(path)
    except OSError:
        return _load(path, 0, 0)  # which says why
    return _load(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=16)
def _load(path: Path, changed_ns: int, size: int) -> Robot:
    file = read_robot_file(path)
    try:
        urdf = find_source(file.description, path.parent, ".urdf")
        description = read_description(urdf)
        semantic, collision, ignored = Semantics(), description, frozenset[Pair]()
        if file.semantic:
            semantic = read_srdf(find_source(file.semantic, path.parent, ".srdf"), description)
        if file.collision.spheres:
            spheres = find_source(file.collision.spheres, path.parent, ".xrdf")
            collision, ignored = with_spheres(description, spheres)
        semantic = Semantics(semantic.states, semantic.left_out | ignored)
        return Robot(file, path, urdf, description, collision, semantic)
    except HumanPredError as trouble:
        raise RobotError(f"robot {path}: {trouble}") from trouble
