"""The stacked evaluation gives what each mixture gives on its own."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import ArrayError
from humanpred_ros.recognition.mixture import MixtureConfig, fit_mixture
from humanpred_ros.recognition.mixture_bank import MixtureBank


def fitted(seed: int, n_components: int, n_features: int = 5):
    rng = np.random.default_rng(seed)
    return fit_mixture(rng.normal(size=(200, n_features)), MixtureConfig(n_components), rng)


def test_classes_may_differ_in_size_and_agree_with_their_mixtures() -> None:
    mixtures = [fitted(0, 4), fitted(1, 1), fitted(2, 7)]
    bank = MixtureBank(mixtures)
    for x in np.random.default_rng(9).normal(size=(20, 5)) * 3:
        np.testing.assert_allclose(bank.log_density(x), [m.log_density(x[None])[0] for m in mixtures], rtol=1e-10)


def test_squares_that_overflow_are_reported_as_not_finite() -> None:
    assert not np.isfinite(MixtureBank([fitted(0, 3)]).log_density(np.full(5, 1e200))).any()


def test_mixtures_over_different_features_do_not_stack() -> None:
    with pytest.raises(ArrayError):
        MixtureBank([fitted(0, 2), fitted(0, 2, 6)])
    with pytest.raises(ArrayError):
        MixtureBank([])
