"""One posture has to be judged by all classes within a fraction of a millisecond; this evaluates them at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.recognition.mixture import GaussianMixture, log_sum_exp


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
