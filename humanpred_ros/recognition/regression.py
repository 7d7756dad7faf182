"""Gaussian mixture regression turns a class's mixture into its one expected motion (P1 III; facts 3).

The mixture is over (phase, posture). Given the phase, every component predicts a posture linearly and vouches
for it with its share of the phase's density; the mixture of these predictions has the mean and covariance below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.recognition.mixture import GaussianMixture, log_sum_exp


@dataclass(frozen=True, eq=False)
class Regression:
    """Posture expected at each phase.

    Attributes:
        phase: (N,) phases asked for, in frames.
        mean: (N, D) conditional mean posture.
        covariance: (N, D, D) conditional covariance of the posture.
    """

    phase: FloatArray
    mean: FloatArray
    covariance: FloatArray


def regress(mixture: GaussianMixture, phase: FloatArray) -> Regression:
    """Return mean and covariance of the posture given the phase.

    Args:
        mixture: over 1 + D features of which the first is the phase.
        phase: (N,) phases in the unit the mixture was fitted with (P1: frames 0 to 99).

    Raises:
        ArrayError: a mixture without postures, or phases that are not finite numbers.
    """
    if mixture.n_features < 2:
        raise ArrayError(f"regression: wanted a mixture over phase and posture, got {mixture.n_features} feature")
    phase = checked("phase", phase, ("N",))
    phase_mean, posture_mean = mixture.means[:, 0], mixture.means[:, 1:]
    phase_variance = mixture.covariances[:, 0, 0]
    slope = mixture.covariances[:, 1:, 0] / phase_variance[:, None]

    offset = phase[:, None] - phase_mean
    log_share = np.log(mixture.weights) - 0.5 * np.log(phase_variance) - 0.5 * offset**2 / phase_variance
    share = np.exp(log_share - log_sum_exp(log_share)[:, None])

    predicted = posture_mean + offset[:, :, None] * slope  # (N, K, D)
    mean = np.einsum("nk,nkd->nd", share, predicted)
    within = mixture.covariances[:, 1:, 1:] - phase_variance[:, None, None] * slope[:, :, None] * slope[:, None, :]
    spread = predicted - mean[:, None, :]
    # Law of total covariance: what components are unsure of, plus what they disagree about.
    covariance = np.einsum("nk,kde->nde", share, within) + np.einsum("nk,nkd,nke->nde", share, spread, spread)
    return Regression(phase, mean, covariance)
