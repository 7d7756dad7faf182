"""Reaches that a person could have made instead: smooth random variations of a demonstration (P2 III-C).

What distinguishes the demonstration from them is what inverse optimal control learns from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.checks import FloatArray
from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.reaching.splitting import Demonstration
from humanpred_ros.reaching.stencils import jerk_covariance

#: Says which of reaches (R, N, J) collide, (R,).
Collides = Callable[[FloatArray], NDArray[np.bool_]]


@dataclass(frozen=True)
class SamplingConfig:
    """How reaches are varied (facts section 5).

    Attributes:
        n_samples: for each demonstration.
        deviation: scale of the noise of every DoF, N(0, deviation^2 / R) with R of the jerk rule: 1.5e-4 moves the
            middle of a reach by 0.11 rad (and m), its ends by 1e-4.
        attempts: rounds of drawing again what collided.

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


def sample_around(
    demo: Demonstration, config: SamplingConfig, rng: np.random.Generator, collides: Collides | None = None
) -> FloatArray:
    """Return variations (K, N, J) of a demonstration, K = n_samples; colliding ones are replaced by new ones.

    If some are still lacking after the last attempt, fewer are returned.

    Raises:
        MotionError: all samples collide, with the demonstration's name.
    """
    covariance = jerk_covariance(len(demo.q))
    kept: list[FloatArray] = []
    lacking = config.n_samples
    for _ in range(config.attempts):
        samples = demo.q + config.deviation * covariance.draw(rng, (lacking, demo.q.shape[1]))
        if collides is not None:
            samples = samples[~np.asarray(collides(samples), dtype=np.bool_)]
        kept.append(samples)
        lacking -= len(samples)
        if lacking == 0:
            break
    if lacking == config.n_samples:
        raise MotionError(
            f"demonstration {demo.name}: wanted samples around it that do not collide, all {config.attempts} x "
            f"{config.n_samples} do; check where table and objects stand, or lower the deviation {config.deviation}"
        )
    return np.concatenate(kept)
