"""Gaussian mixtures are the model of a class of motions (P1 III): their densities, their fit, and regression.

Notation: N samples, D features, K components; w_k weights, mu_k means, S_k covariances,
L_k the Cholesky factor S_k = L_k L_k^T. Densities are computed as logarithms throughout, because a posture
far from every component has a density below the smallest float.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from humanpred_ros.errors import ArrayError, LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen

_log = logging.getLogger(__name__)
#: Lloyd's algorithm ends long before on real motions; EM refines what is left.
_KMEANS_ITERATIONS = 100


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
        log_scale = np.log(weights) - 0.5 * n_features * np.log(2.0 * np.pi) - log_det
        object.__setattr__(self, "weights", frozen(weights))
        object.__setattr__(self, "means", frozen(means))
        object.__setattr__(self, "covariances", frozen(covariances))
        object.__setattr__(self, "whitening", frozen(np.linalg.inv(factor)))
        object.__setattr__(self, "log_scale", frozen(log_scale))

    @property
    def n_components(self) -> int:
        """K."""
        return len(self.means)

    @property
    def n_features(self) -> int:
        """D."""
        return int(self.means.shape[1])

    def log_density(self, x: FloatArray) -> FloatArray:
        """Return (N,) ln p(x_n) for samples (N, D); finite for every finite sample."""
        x = checked("samples", x, ("N", self.n_features))
        joint = np.empty((len(x), self.n_components))
        for k in range(self.n_components):
            white = (x - self.means[k]) @ self.whitening[k].T
            joint[:, k] = self.log_scale[k] - 0.5 * np.einsum("nd,nd->n", white, white)
        return log_sum_exp(joint)


class MixtureBank:
    """The components of several mixtures, stacked so that one product whitens a sample for all of them.

    With W_k = L_k^-1 the squared Mahalanobis distance of x to component k is |W_k x - W_k mu_k|^2; both W_k and
    W_k mu_k are constants.
    """

    def __init__(self, mixtures: Sequence[GaussianMixture]) -> None:
        """Stack mixtures over the same features; they may differ in their number of components."""
        if not mixtures or len({mixture.n_features for mixture in mixtures}) != 1:
            raise ArrayError("mixture bank: wanted at least one mixture, all over the same features")
        self.n_classes = len(mixtures)
        self.n_features = mixtures[0].n_features
        self._n_components = max(mixture.n_components for mixture in mixtures)
        # Missing components have weight 0: an infinitely negative log scale and nothing to whiten.
        whitening = np.zeros((self.n_classes, self._n_components, self.n_features, self.n_features))
        offset = np.zeros((self.n_classes, self._n_components, self.n_features))
        self._log_scale = np.full((self.n_classes, self._n_components), -np.inf)
        for m, mixture in enumerate(mixtures):
            k = mixture.n_components
            whitening[m, :k] = mixture.whitening
            offset[m, :k] = np.einsum("kij,kj->ki", mixture.whitening, mixture.means)
            self._log_scale[m, :k] = mixture.log_scale
        # Features first: the product below then runs along one long contiguous axis.
        self._whitening = np.ascontiguousarray(whitening.reshape(-1, self.n_features).T)
        self._offset = offset.ravel()

    def log_density(self, x: FloatArray) -> FloatArray:
        """Return (C,) ln p(x | class) of one sample (F,); not finite where squares overflow.

        einsum keeps the product on this thread: handing so small a one to a pool costs more than it saves, and
        its summation order must not depend on the number of cores.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            white = np.einsum("f,fr->r", x, self._whitening)
            white -= self._offset
            white = white.reshape(self.n_classes, self._n_components, self.n_features)
            joint = self._log_scale - 0.5 * np.einsum("mkf,mkf->mk", white, white)
            return log_sum_exp(joint)


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
) -> GaussianMixture:
    """Fit a mixture with full covariances: k-means from samples drawn at random, then EM (P1 III).

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
            fitted = GaussianMixture(em.weights_ / em.weights_.sum(), em.means_, covariances)
        except (ValueError, np.linalg.LinAlgError, ArrayError) as trouble:
            raise LibraryFormatError(
                f"mixture: with {n_components} components and a covariance floor of {covariance_floor:g} "
                "a covariance became singular (a degree of freedom does not vary among a component's samples); "
                "raise the floor, use fewer components or more motions"
            ) from trouble
    if not em.converged_:
        _log.info("EM stopped after %d iterations without reaching %g", max_iterations, tolerance)
    return fitted


def regress(mixture: GaussianMixture, phase: FloatArray) -> FloatArray:
    """Return the (N, D) postures expected at phases: Gaussian mixture regression (P1 III; docs/papers.md).

    Given the phase, every component predicts a posture linearly; they are averaged by each one's share of the phase's
    density.

    Args:
        mixture: over 1 + D features of which the first is the phase.
        phase: (N,) phases in the unit the mixture was fitted with (P1: frames 0 to 99).

    Raises:
        ArrayError: a mixture without postures, or phases that are not finite numbers.
    """
    if mixture.n_features < 2:
        raise ArrayError(f"regression: wanted a mixture over phase and posture, got {mixture.n_features} feature")
    phase = checked("phase", phase, ("N",))
    variance = mixture.covariances[:, 0, 0]
    slope = mixture.covariances[:, 1:, 0] / variance[:, None]
    offset = phase[:, None] - mixture.means[:, 0]
    log_share = np.log(mixture.weights) - 0.5 * np.log(variance) - 0.5 * offset**2 / variance
    share = np.exp(log_share - log_sum_exp(log_share)[:, None])
    predicted = mixture.means[:, 1:] + offset[:, :, None] * slope  # (N, K, D)
    mean: FloatArray = np.einsum("nk,nkd->nd", share, predicted)
    return mean


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
