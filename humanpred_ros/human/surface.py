"""Points on the surface of the human, because a voxel is occupied when the body's surface passes through it.

P1 samples the bodies' surfaces 0.02 m apart for voxels of 0.05 m (facts: iros2013, section 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.bodies import Body


@dataclass(frozen=True)
class SurfacePoints:
    """Points fixed to the links of a model: immutable.

    Attributes:
        link: (P,) index of each point's link in the model's `link_names`.
        local_m: (P, 3) the points in their links' frames.
    """

    link: NDArray[np.int64]
    local_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.link, self.local_m):
            array.setflags(write=False)


def sample_bodies(bodies: Sequence[Body], link_names: Sequence[str], spacing_m: float) -> SurfacePoints:
    """Return points so that no surface point of any body is farther than `spacing_m` from one of them.

    Neighbours are at most `spacing_m` apart on the surface, and each body is covered whole, also where it lies inside
    another: that keeps the points independent of the posture, and such points fall in voxels that are occupied anyway.

    Args:
        bodies: the solids, at least one.
        link_names: the model's links, to number them.
        spacing_m: a length in metres.

    Raises:
        HumanModelError: no bodies, or a spacing that is not a positive length.
    """
    if not (np.isfinite(spacing_m) and spacing_m > 0):
        raise HumanModelError(f"surface points: wanted a positive spacing in metres, got {spacing_m}")
    if not bodies:
        raise HumanModelError("surface points: wanted a model with at least one <collision>, got none; add bodies")
    links, points = [], []
    for body in bodies:
        local = body.shape.sample(spacing_m) @ body.T_link_body[:3, :3].T + body.T_link_body[:3, 3]
        points.append(local)
        links.append(np.full(len(local), link_names.index(body.link)))
    return SurfacePoints(np.concatenate(links), np.concatenate(points))
