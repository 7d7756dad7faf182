"""Gaussian mixtures are the model of a class of motions (P1 III): densities, and their fit by EM.

Notation: N samples, D features, K components; w_k weights, mu_k means, S_k covariances,
L_k the Cholesky factor S_k = L_k L_k^T. Densities are computed as logarithms throughout, because a posture
far from every component has a density below the smallest float.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError, LibraryFormatError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.recognition.kmeans import kmeans

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class MixtureConfig:
    """How a mixture is fitted.

    Attributes:
        n_components: K; the published models have 40 (facts 3), P1 III states 20.
        covariance_floor: added to the diagonal of every covariance at every M step (facts 3: 1e-5).
        tolerance: EM ends when the mean log density of a sample changes by less.
        max_iterations: EM ends after so many iterations at the latest (facts 3: 200).
    """

    n_components: int = 40
    covariance_floor: float = 1e-5
    tolerance: float = 1e-4
    max_iterations: int = 200

    def __post_init__(self) -> None:
        if self.n_components < 1 or self.max_iterations < 1:
            raise UsageError(
                "mixture: wanted at least one component and one iteration, "
                f"got n_components={self.n_components}, max_iterations={self.max_iterations}"
            )
        if not (0 <= self.covariance_floor < np.inf and 0 <= self.tolerance < np.inf):
            raise UsageError(
                "mixture: wanted a covariance floor and a tolerance of at least 0, "
                f"got {self.covariance_floor} and {self.tolerance}"
            )


@dataclass(frozen=True, eq=False)
class GaussianMixture:
    """p(x) = sum_k w_k N(x | mu_k, S_k): immutable.

    Attributes:
        weights: (K,) positive, sum 1.
        means: (K, D).
        covariances: (K, D, D) symmetric, positive definite.
        whitening: (K, D, D) inverse Cholesky factors, L_k^-1; derived.
        log_scale: (K,) ln w_k - D/2 ln 2 pi - ln det L_k; derived.

    Raises:
        ArrayError: wrong shapes, weights that are no distribution, covariances not positive definite.
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray
    whitening: FloatArray = field(init=False, repr=False, compare=False)
    log_scale: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        means = checked("mixture means", self.means, ("K", "D"))
        n_components, n_features = means.shape
        weights = checked("mixture weights", self.weights, (n_components,))
        covariances = checked("mixture covariances", self.covariances, (n_components, n_features, n_features))
        if (weights <= 0).any() or abs(float(weights.sum()) - 1.0) > 1e-9:
            raise ArrayError(f"mixture weights: wanted positive numbers with sum 1, got {weights}")
        # Relative to the trace: a covariance of metres and of frames differ by ten orders of magnitude.
        skew = np.abs(covariances - covariances.transpose(0, 2, 1)).max(axis=(1, 2))
        if (skew > 1e-9 * np.trace(covariances, axis1=1, axis2=2)).any():
            raise ArrayError(f"mixture covariances: wanted symmetric matrices, component {np.argmax(skew)} is not")
        factor = _cholesky(covariances)
        log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        object.__setattr__(self, "weights", frozen(weights))
        object.__setattr__(self, "means", frozen(means))
        object.__setattr__(self, "covariances", frozen(covariances))
        object.__setattr__(self, "whitening", frozen(np.linalg.solve(factor, np.eye(n_features))))
        object.__setattr__(
            self, "log_scale", frozen(np.log(weights) - 0.5 * n_features * np.log(2.0 * np.pi) - log_det)
        )

    @property
    def n_components(self) -> int:
        """K."""
        return len(self.means)

    @property
    def n_features(self) -> int:
        """D."""
        return int(self.means.shape[1])

    def component_log_density(self, x: FloatArray) -> FloatArray:
        """Return (N, K) ln w_k N(x_n | mu_k, S_k) for samples (N, D)."""
        x = checked("samples", x, ("N", self.n_features))
        joint = np.empty((len(x), self.n_components))
        for k in range(self.n_components):
            white = (x - self.means[k]) @ self.whitening[k].T
            joint[:, k] = self.log_scale[k] - 0.5 * np.einsum("nd,nd->n", white, white)
        return joint

    def log_density(self, x: FloatArray) -> FloatArray:
        """Return (N,) ln p(x_n) for samples (N, D); finite for every finite sample."""
        return log_sum_exp(self.component_log_density(x))


def log_sum_exp(values: FloatArray) -> FloatArray:
    """Return ln sum exp over the last axis, the largest exponent subtracted first."""
    largest = values.max(axis=-1)
    total: FloatArray = largest + np.log(np.exp(values - largest[..., None]).sum(axis=-1))
    return total


def fit_mixture(x: FloatArray, config: MixtureConfig, rng: np.random.Generator) -> GaussianMixture:
    """Fit a mixture with full covariances: k-means, then EM (P1 III; facts 3).

    Args:
        x: (N, D) samples.
        config: number of components and when to stop.
        rng: source of the k-means seeds.

    Raises:
        LibraryFormatError: values not finite, no variation at all, fewer distinct samples than components,
            or a singular covariance (only where the covariance floor is too small for the data).
    """
    x = checked("mixture samples", x, ("N", "D"), error=LibraryFormatError)
    if len(x) == 0 or not np.ptp(x, axis=0).any():
        raise LibraryFormatError(
            f"mixture: wanted samples that differ, got {len(x)} equal ones; a mixture of them says nothing"
        )
    n_distinct = len(np.unique(x, axis=0))
    if n_distinct < config.n_components:
        raise LibraryFormatError(
            f"mixture: wanted at least as many distinct samples as components ({config.n_components}), "
            f"got {n_distinct}; use fewer components or more motions"
        )
    labels = kmeans(x, config.n_components, rng)
    member = np.zeros((len(x), config.n_components))
    member[np.arange(len(x)), labels] = 1.0
    return refine_mixture(x, _maximise(x, member, config), config)


def refine_mixture(x: FloatArray, start: GaussianMixture, config: MixtureConfig) -> GaussianMixture:
    """Run EM on samples (N, D) from a given mixture until it converges; raises as `fit_mixture`."""
    x = checked("mixture samples", x, ("N", start.n_features), error=LibraryFormatError)
    mixture, previous = start, -np.inf
    for _ in range(config.max_iterations):
        joint = mixture.component_log_density(x)
        log_density = log_sum_exp(joint)
        mixture = _maximise(x, np.exp(joint - log_density[:, None]), config)
        mean = float(log_density.mean())
        if abs(mean - previous) < config.tolerance:
            break
        previous = mean
    else:
        _log.info("EM stopped after %d iterations without reaching %g", config.max_iterations, config.tolerance)
    return mixture


def _cholesky(covariances: FloatArray) -> FloatArray:
    """Return (K, D, D) Cholesky factors; ArrayError where a covariance is singular to working precision."""
    message = "mixture covariances: wanted positive definite matrices, got a singular one; raise the covariance floor"
    try:
        factor = np.asarray(np.linalg.cholesky(covariances), dtype=np.float64)
    except np.linalg.LinAlgError as trouble:
        raise ArrayError(message) from trouble
    # Rounding can leave a tiny positive pivot where the exact one is 0.
    pivot = np.square(np.diagonal(factor, axis1=1, axis2=2))
    if (pivot < 1e-14 * np.diagonal(covariances, axis1=1, axis2=2)).any():
        raise ArrayError(message)
    return factor


def _maximise(x: FloatArray, responsibility: NDArray[np.float64], config: MixtureConfig) -> GaussianMixture:
    """M step: the mixture that fits samples (N, D) best under responsibilities (N, K)."""
    n_features = x.shape[1]
    # A component that lost all its samples keeps a vanishing weight instead of a division by zero.
    mass = responsibility.sum(axis=0) + 10.0 * np.finfo(np.float64).eps
    means = responsibility.T @ x / mass[:, None]
    covariances = np.empty((len(mass), n_features, n_features))
    for k in range(len(mass)):
        centred = x - means[k]
        covariances[k] = (responsibility[:, k, None] * centred).T @ centred / mass[k]
    covariances += covariances.transpose(0, 2, 1).copy()
    covariances *= 0.5
    covariances[:, np.arange(n_features), np.arange(n_features)] += config.covariance_floor
    try:
        # The variance of a constant feature is rounding, not always 0; an honest 0 is what must be refused.
        rounding = np.square(16.0 * np.finfo(np.float64).eps * np.abs(x).max(axis=0))
        diagonal = np.diagonal(covariances, axis1=1, axis2=2)
        return GaussianMixture(mass / mass.sum(), means, np.where((diagonal <= rounding)[:, None], 0.0, covariances))
    except ArrayError as trouble:
        raise LibraryFormatError(
            f"mixture: with {config.n_components} components and a covariance floor of {config.covariance_floor:g} "
            "a covariance became singular (a degree of freedom does not vary among a component's samples); "
            "raise the floor, use fewer components or more motions"
        ) from trouble
