"""Reaches that a person could have made instead: smooth random variations of a demonstration (P2 III-C).

What distinguishes the demonstration from them is what inverse optimal control learns from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.demonstrations import Demonstration
from humanpred_ros.reaching.stencils import jerk_covariance


class Collides(Protocol):
    """Decides what is impossible."""

    def __call__(self, q: FloatArray) -> NDArray[np.bool_]:
        """Return which of reaches (R, N, J) collide, (R,)."""
        ...

    def usual_touch(self, q: FloatArray) -> str:
        """Return what most of the reaches (R, N, J) that collide run into, in words."""
        ...


@dataclass(frozen=True)
class SamplingConfig:
    """How reaches are varied (facts section 5).

    Attributes:
        n_samples: for each demonstration.
        deviation: scale of the noise of every DoF, N(0, deviation^2 / R) with R of the jerk rule: 1.5e-4 moves the
            middle of a reach by 0.11 rad (and m), its ends by 1e-4.
        attempts: at most so many times n_samples are drawn to find n_samples that do not collide.

    Raises:
        UsageError: numbers that cannot be.
    """

    n_samples: int = 700
    deviation: float = 1.5e-4
    attempts: int = 10

    def __post_init__(self) -> None:
        if self.n_samples < 1 or self.attempts < 1 or not (np.isfinite(self.deviation) and self.deviation > 0.0):
            raise UsageError(
                "sampling: wanted at least 1 sample and attempt and a positive deviation, got "
                f"{self.n_samples}, {self.attempts} and {self.deviation}"
            )


@dataclass(frozen=True, eq=False)
class Samples:
    """Variations of one demonstration.

    Attributes:
        q: (K, N, J) postures; none of them collides.
        collided: how many more were drawn that do.
    """

    q: FloatArray
    collided: int


def sample_around(
    demo: Demonstration, config: SamplingConfig, rng: np.random.Generator, collides: Collides | None = None
) -> Samples:
    """Return variations of a demonstration, K = n_samples; colliding ones are discarded and replaced by new ones.

    If some are still lacking after the last attempt, fewer are returned. (The authors' code keeps colliding ones then.)

    Raises:
        MotionError: all samples collide, with the demonstration's name.
    """
    covariance = jerk_covariance(len(demo.q))
    kept: list[FloatArray] = []
    found, drawn, collided, count = 0, 0, 0, config.n_samples
    for _ in range(config.attempts):
        samples = demo.q + config.deviation * covariance.draw(rng, (count, demo.q.shape[1]))
        drawn += count
        free = samples if collides is None else samples[~np.asarray(collides(samples), dtype=np.bool_)]
        collided += count - len(free)
        kept.append(free[: config.n_samples - found])
        found += len(kept[-1])
        if found == config.n_samples:
            break
        # As many as should do, going by what collided so far.
        count = min(config.n_samples, 1 + (config.n_samples - found) * drawn // max(found, 1))
    if found == 0 and collides is not None:
        raise MotionError(
            f"demonstration {demo.name}: wanted samples around it that do not collide, all {config.attempts} x "
            f"{config.n_samples} do, most with {collides.usual_touch(samples)}; check where table and objects stand, "
            f"leave the recording out, or lower the deviation {config.deviation}"
        )
    return Samples(np.concatenate(kept), collided)
