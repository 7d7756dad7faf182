"""Weights of the 24 features that need no learning: P2's baselines, and what its authors learned (facts 4 and 5)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.reaching.features import N_FEATURES, N_SMOOTHNESS

#: Of squared posture velocity in the baselines: 100 x the 1e-4 that P2's parameter files multiply it by, over the
#: feature's scale of 1e-5 (facts section 4).
_BASELINE_SMOOTHNESS = 1000.0
_CONSERVATIVE = 10.0


def _weights(smoothness: tuple[float, ...], distances: tuple[float, ...]) -> FloatArray:
    w = np.zeros(N_FEATURES)
    w[: len(smoothness)] = smoothness
    w[N_SMOOTHNESS:] = distances
    return frozen(w)  # type: ignore[return-value]


#: "baseline_0" keeps no distance from the partner, "baseline_1" much from every link. "authors_static" and
#: "authors_dynamic" are means over the seven weights that the authors learned from one demonstration each, without and
#: with cuts; they are not left out of what is tested here.
NAMED_WEIGHTS: Mapping[str, FloatArray] = MappingProxyType(
    {
        "baseline_0": _weights((0.0, _BASELINE_SMOOTHNESS), (0.0,) * 16),
        "baseline_1": _weights((0.0, _BASELINE_SMOOTHNESS), (_CONSERVATIVE,) * 16),
        "authors_static": _weights(
            (129, 150, 154, 150, 134, 156, 201, 180),
            (174, 60, 36, 123, 115, 50, 4, 10, 103, 41, 0, 15, 55, 69, 7, 14),
        ),
        "authors_dynamic": _weights(
            (113, 170, 145, 143, 95, 177, 132, 202),
            (112, 46, 30, 121, 75, 49, 47, 67, 74, 0, 43, 83, 121, 98, 0, 5),
        ),
    }
)


def named_weights(name: str) -> FloatArray:
    """Return the (24,) weights of that name.

    Raises:
        UsageError: another name.
    """
    if name not in NAMED_WEIGHTS:
        raise UsageError(f"weights: wanted one of {', '.join(NAMED_WEIGHTS)}, got {name!r}")
    return NAMED_WEIGHTS[name]
