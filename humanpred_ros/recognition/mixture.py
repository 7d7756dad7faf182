"""Gaussian mixtures are the model of a class of motions (P1 III): their densities, their fit, and regression.

Notation: N samples, D features, C mixtures of K components; w weights, mu means, S covariances,
L the Cholesky factor S = L L^T. Densities are computed as logarithms throughout, because a posture
far from every component has a density below the smallest float.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import ArrayError, LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen

_log = logging.getLogger(__name__)
#: Lloyd's algorithm ends long before on real motions; EM refines what is left.
_KMEANS_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class GaussianMixtures:
    """C mixtures of K components each, p_c(x) = sum_k w_ck N(x | mu_ck, S_ck): immutable.

    Raises:
        ArrayError: wrong shapes, weights that are no distribution, covariances not positive definite.
    """

    weights: FloatArray  #: (C, K) positive, sum 1 in each mixture
    means: FloatArray  #: (C, K, D)
    covariances: FloatArray  #: (C, K, D, D) symmetric, positive definite

    def __post_init__(self) -> None:
        means = checked("mixture means", self.means, ("C", "K", "D"))
        n_mixtures, n_components, n_features = means.shape
        weights = checked("mixture weights", self.weights, (n_mixtures, n_components))
        shape = (n_mixtures, n_components, n_features, n_features)
        covariances = checked("mixture covariances", self.covariances, shape)
        if not means.size or (weights <= 0).any() or np.abs(weights.sum(axis=1) - 1.0).max() > 1e-9:
            raise ArrayError(f"mixture weights: wanted positive numbers with sum 1, got {weights}")
        # Relative to the trace: a covariance of metres and of frames differ by ten orders of magnitude.
        skew = np.abs(covariances - covariances.swapaxes(2, 3)).max(axis=(2, 3))
        if (skew > 1e-9 * np.trace(covariances, axis1=2, axis2=3)).any():
            raise ArrayError(f"mixture covariances: wanted symmetric matrices, component {np.argmax(skew)} is not")
        factor = _cholesky(covariances)
        log_det = np.log(np.diagonal(factor, axis1=2, axis2=3)).sum(axis=2)
        log_scale = np.log(weights) - 0.5 * n_features * np.log(2.0 * np.pi) - log_det
        # W = L^-1 whitens: the squared Mahalanobis distance of x is |W x - W mu|^2. Features come first, so that one
        # product along one long contiguous axis whitens a sample for all components.
        whitening = np.linalg.inv(factor)
        object.__setattr__(self, "weights", frozen(weights))
        object.__setattr__(self, "means", frozen(means))
        object.__setattr__(self, "covariances", frozen(covariances))
        object.__setattr__(self, "_log_scale", log_scale)
        object.__setattr__(self, "_whitening", np.ascontiguousarray(whitening.reshape(-1, n_features).T))
        object.__setattr__(self, "_offset", np.einsum("ckij,ckj->cki", whitening, means))

    @classmethod
    def joined(cls, parts: Sequence[GaussianMixtures]) -> GaussianMixtures:
        """Return all mixtures of several objects, which must agree on K and D."""
        names = ("weights", "means", "covariances")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def __getitem__(self, c: int) -> GaussianMixtures:
        """Return one mixture (C = 1)."""
        return GaussianMixtures(self.weights[c, None], self.means[c, None], self.covariances[c, None])

    @property
    def n_features(self) -> int:
        """D."""
        return int(self.means.shape[2])

    def log_density(self, x: FloatArray) -> FloatArray:
        """Return (C,) ln p_c(x) of one sample (D,); not finite where squares overflow.

        einsum keeps the product on this thread: handing so small a one to a pool costs more than it saves, and
        its summation order must not depend on the number of cores.
        """
        log_scale, whitening, offset = (getattr(self, name) for name in ("_log_scale", "_whitening", "_offset"))
        with np.errstate(over="ignore", invalid="ignore"):
            white = np.einsum("f,fr->r", x, whitening).reshape(offset.shape) - offset
            return log_sum_exp(log_scale - 0.5 * np.einsum("mkf,mkf->mk", white, white))


def log_sum_exp(values: FloatArray) -> FloatArray:
    """Return ln sum exp over the last axis, the largest exponent subtracted first."""
    largest = values.max(axis=-1)
    total: FloatArray = largest + np.log(np.exp(values - largest[..., None]).sum(axis=-1))
    return total


def fit_mixture(
    x: FloatArray,
    n_components: int,
    rng: np.random.Generator,
    *,
    covariance_floor: float = 1e-5,
    tolerance: float = 1e-4,
    max_iterations: int = 200,
) -> GaussianMixtures:
    """Fit one mixture (C = 1) with full covariances: k-means from samples drawn at random, then EM (P1 III).

    Args:
        x: (N, D) samples; features are used as they are, unscaled.
        n_components: K.
        rng: draws the samples that k-means starts from.
        covariance_floor: added to the diagonal of every covariance in every M step.
        tolerance: EM ends when the mean log density of a sample changes by less,
        max_iterations: or after so many iterations.

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
    if n_distinct < n_components:
        raise LibraryFormatError(
            f"mixture: wanted at least as many distinct samples as components ({n_components}), "
            f"got {n_distinct}; use fewer components or more motions"
        )
    # Takes seconds and 100 MB to import; only training needs it.
    from sklearn import cluster, exceptions, mixture
    from threadpoolctl import threadpool_limits

    centred = x - x.mean(axis=0)
    seeds = centred[rng.choice(len(x), n_components, replace=False)]
    clusters = cluster.KMeans(n_components, init=seeds, n_init=1, max_iter=_KMEANS_ITERATIONS, tol=0.0)
    # One thread: so small products are slower on many, and rounding must not depend on the number of cores.
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", exceptions.ConvergenceWarning)
        labels = clusters.fit_predict(centred)
        try:
            weights, means, covariances = _of_clusters(x, labels, n_components, covariance_floor)
            em = mixture.GaussianMixture(
                n_components,
                reg_covar=covariance_floor,
                tol=tolerance,
                max_iter=max_iterations,
                weights_init=weights,
                means_init=means,
                precisions_init=np.linalg.inv(covariances),
            ).fit(x)
            # A constant feature's variance is rounding, not always 0; an honest 0 is what must be refused.
            rounding = np.square(16.0 * np.finfo(np.float64).eps * np.abs(x).max(axis=0))
            constant = np.diagonal(em.covariances_, axis1=1, axis2=2) <= rounding
            covariances = np.where(constant[:, None], 0.0, em.covariances_)
            # Sums of rounded numbers make a matrix a little unsymmetric.
            covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
            weights = em.weights_ / em.weights_.sum()
            fitted = GaussianMixtures(weights[None], em.means_[None], covariances[None])
        except (ValueError, np.linalg.LinAlgError, ArrayError) as trouble:
            raise LibraryFormatError(
                f"mixture: with {n_components} components and a covariance floor of {covariance_floor:g} "
                "a covariance became singular (a degree of freedom does not vary among a component's samples); "
                "raise the floor, use fewer components or more motions"
            ) from trouble
    if not em.converged_:
        _log.info("EM stopped after %d iterations without reaching %g", max_iterations, tolerance)
    return fitted


def regress(mixtures: GaussianMixtures, phase: FloatArray) -> FloatArray:
    """Return the (C, N, D) postures expected at phases: Gaussian mixture regression (P1 III; docs/papers.md).

    Given the phase, every component predicts a posture linearly; they are averaged by each one's share of the phase's
    density.

    Args:
        mixtures: over 1 + D features of which the first is the phase.
        phase: (N,) phases in the unit the mixtures were fitted with (P1: frames 0 to 99).

    Raises:
        ArrayError: mixtures without postures, or phases that are not finite numbers.
    """
    if mixtures.n_features < 2:
        raise ArrayError(f"regression: wanted a mixture over phase and posture, got {mixtures.n_features} feature")
    phase = checked("phase", phase, ("N",))
    expected = []
    for weights, means, covariances in zip(mixtures.weights, mixtures.means, mixtures.covariances, strict=True):
        variance = covariances[:, 0, 0]
        slope = covariances[:, 1:, 0] / variance[:, None]
        offset = phase[:, None] - means[:, 0]
        log_share = np.log(weights) - 0.5 * np.log(variance) - 0.5 * offset**2 / variance
        share = np.exp(log_share - log_sum_exp(log_share)[:, None])
        predicted = means[:, 1:] + offset[:, :, None] * slope  # (N, K, D)
        expected.append(np.einsum("nk,nkd->nd", share, predicted))
    return np.stack(expected)


def _of_clusters(
    x: FloatArray, labels: np.ndarray[tuple[int], np.dtype[np.int32]], n_components: int, covariance_floor: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return weights (K,), means (K, D) and covariances (K, D, D) of the samples in each cluster."""
    weights, means = np.empty(n_components), np.empty((n_components, x.shape[1]))
    covariances = np.empty((n_components, x.shape[1], x.shape[1]))
    for k in range(n_components):
        members = x[labels == k]
        weights[k], means[k] = len(members) / len(x), members.mean(axis=0)
        centred = members - means[k]
        covariances[k] = centred.T @ centred / len(members) + covariance_floor * np.eye(x.shape[1])
    return weights, means, covariances


def _cholesky(covariances: FloatArray) -> FloatArray:
    """Return (C, K, D, D) Cholesky factors; ArrayError where a covariance is singular to working precision."""
    message = "mixture covariances: wanted positive definite matrices, got a singular one; raise the covariance floor"
    try:
        factor = np.asarray(np.linalg.cholesky(covariances), dtype=np.float64)
    except np.linalg.LinAlgError as trouble:
        raise ArrayError(message) from trouble
    # Rounding can leave a tiny positive pivot where the exact one is 0.
    pivot = np.square(np.diagonal(factor, axis1=2, axis2=3))
    if (pivot < 1e-14 * np.diagonal(covariances, axis1=2, axis2=3)).any():
        raise ArrayError(message)
    return factor
