"""What planning needs of a robot arm: the one in this package is `pr2.Pr2Arm`."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.checks import FloatArray


class Arm(Protocol):
    """An arm of D joints that stands somewhere.

    Attributes:
        chain: its kinematics.
    """

    chain: KinematicChain

    def body_points(self) -> BodyPoints:
        """Return points on its surface, which the human occupancy is summed over."""

    def spheres(self) -> BodySpheres:
        """Return spheres that cover what must keep clear."""

    def difference(self, q_from: ArrayLike, q_to: ArrayLike) -> FloatArray:
        """Return the shortest change (..., D) from one configuration to another."""

    def configuration_distance(self, a: ArrayLike, b: ArrayLike) -> FloatArray:
        """Return how far apart configurations are, (...), in the weighted distance of P1."""
