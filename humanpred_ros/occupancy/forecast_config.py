"""One place for the settings of the forecast, shared by the predictor and its tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

from humanpred_ros.errors import UsageError
from humanpred_ros.occupancy.voxeliser import DEFAULT_SPACING_M

#: A voxel remembers in one bit each which of the futures touch it.
MOST_FUTURES = 32


@dataclass(frozen=True)
class ForecastConfig:
    """How futures are drawn, attached to the present posture and turned into probabilities.

    None of them is critical: half or twice any of these defaults makes the leave-one-out Brier score on library_b 4 %
    worse at most, and thinning or steps halved, at twice the time, 1 % better.

    Attributes:
        n_futures: recorded futures followed in each update, 32 at most. Twice as many score 1.5 % better.
        least_share: a class less probable than this gets no future, so that the others get more.
        kept: share of the difference between the person's posture and the recorded one that lasts.
        fade: the rest of the difference falls to 1/e while this share of the recorded motion passes.
        step_voxels: successive postures of a future are so many voxels apart, where a part of the body moves most.
        thinning: each posture of a future takes only every so manieth point of the surface, the next one others.
        spread: share of its probability that a voxel gives to its six neighbours: samples are few, trackers noisy.
        spacing_m: distance between points on the body's surface.
    """

    n_futures: int = 12
    least_share: float = 0.01
    kept: float = 0.6
    fade: float = 0.2
    step_voxels: float = 0.8
    thinning: int = 3
    spread: float = 0.3
    spacing_m: float = DEFAULT_SPACING_M

    def __post_init__(self) -> None:
        if not 1 <= self.n_futures <= MOST_FUTURES or self.thinning < 1:
            raise UsageError(
                f"forecast: wanted 1 to {MOST_FUTURES} futures and a thinning of 1 or more, "
                f"got n_futures={self.n_futures}, thinning={self.thinning}"
            )
        for name in ("fade", "step_voxels", "spacing_m"):
            if not 0 < getattr(self, name) < math.inf:
                raise UsageError(f"forecast: wanted a positive {name}, got {getattr(self, name)}")
        for name in ("least_share", "kept", "spread"):
            if not 0 <= getattr(self, name) <= 1:
                raise UsageError(f"forecast: wanted {name} within [0, 1], got {getattr(self, name)}")
