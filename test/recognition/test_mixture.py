"""Gaussian mixtures: right densities, EM that climbs and agrees with scikit-learn, and clear refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture as Oracle

from humanpred_ros.errors import ArrayError, LibraryFormatError, UsageError
from humanpred_ros.recognition.mixture import GaussianMixture, MixtureConfig, fit_mixture, refine_mixture


def random_mixture(seed: int, n_components: int = 3, n_features: int = 4) -> GaussianMixture:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n_components, n_features, n_features))
    weights = rng.uniform(0.5, 1.5, n_components)
    return GaussianMixture(
        weights / weights.sum(),
        rng.normal(size=(n_components, n_features)),
        root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n_features),
    )


def blobs(seed: int = 0, n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(seed)
    centre = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0], [0.0, 4.0, -2.0]])[rng.integers(3, size=n)]
    return centre + rng.normal(size=(n, 3)) * [1.0, 0.4, 0.2]


def test_log_density_is_scipys() -> None:
    mixture, x = random_mixture(1), np.random.default_rng(2).normal(size=(50, 4))
    parts = [
        np.log(w) + multivariate_normal(m, S).logpdf(x)
        for w, m, S in zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    ]
    np.testing.assert_allclose(mixture.log_density(x), logsumexp(parts, axis=0), rtol=1e-11)


def test_density_integrates_to_one() -> None:
    mixture = random_mixture(4, n_components=2, n_features=1)
    x = np.linspace(-40, 40, 20_001)
    assert np.trapezoid(np.exp(mixture.log_density(x[:, None])), x) == pytest.approx(1.0, abs=1e-9)


def test_log_density_far_away_is_finite() -> None:
    assert np.isfinite(random_mixture(1).log_density(np.full((1, 4), 1e6))).all()


@pytest.mark.parametrize("n_components", [1, 3, 5])
def test_em_ends_where_scikit_learn_ends(n_components: int) -> None:
    x = blobs()
    config = MixtureConfig(n_components, tolerance=1e-6)
    start = fit_mixture(x, MixtureConfig(n_components, max_iterations=1), np.random.default_rng(0))
    ours = refine_mixture(x, start, config)
    oracle = Oracle(
        n_components,
        reg_covar=config.covariance_floor,
        tol=config.tolerance,
        max_iter=config.max_iterations,
        weights_init=start.weights,
        means_init=start.means,
        precisions_init=np.linalg.inv(start.covariances),
    ).fit(x)
    assert ours.log_density(x).mean() == pytest.approx(oracle.score(x), abs=1e-9)
    np.testing.assert_allclose(ours.means, oracle.means_, atol=1e-6)
    np.testing.assert_allclose(ours.covariances, oracle.covariances_, atol=1e-6)


def test_em_never_loses_likelihood() -> None:
    x = blobs(3)
    config = MixtureConfig(4, covariance_floor=0.0, max_iterations=1)
    mixture = fit_mixture(x, config, np.random.default_rng(1))
    likelihood = []
    for _ in range(40):
        likelihood.append(mixture.log_density(x).mean())
        mixture = refine_mixture(x, mixture, config)
    assert (np.diff(likelihood) > -1e-12).all()
    assert likelihood[-1] > likelihood[0] + 1e-4


def test_fit_finds_the_mixture_that_made_the_samples() -> None:
    x = blobs(5, 4000)
    fitted = fit_mixture(x, MixtureConfig(3), np.random.default_rng(0))
    order = np.lexsort(fitted.means.T[::-1].round())
    np.testing.assert_allclose(fitted.weights[order], 1 / 3, atol=0.03)
    np.testing.assert_allclose(fitted.means[order], [[0.0, 0.0, 0.0], [0.0, 4.0, -2.0], [3.0, 1.0, 0.0]], atol=0.1)
    np.testing.assert_allclose(
        np.diagonal(fitted.covariances[order], axis1=1, axis2=2), [[1.0, 0.16, 0.04]] * 3, rtol=0.15
    )


def test_constant_feature_is_harmless_above_a_floor() -> None:
    x = np.column_stack([blobs(), np.full(400, 7.0)])
    mixture = fit_mixture(x, MixtureConfig(3), np.random.default_rng(0))
    np.testing.assert_allclose(mixture.covariances[:, 3, 3], 1e-5, rtol=1e-6)
    assert np.isfinite(mixture.log_density(x)).all()


@pytest.mark.parametrize("value", [0.0, 7.3, -1e5])
def test_constant_feature_without_floor_is_refused(value: float) -> None:
    x = np.column_stack([blobs(), np.full(400, value)])
    with pytest.raises(LibraryFormatError, match="raise the floor"):
        fit_mixture(x, MixtureConfig(3, covariance_floor=0.0), np.random.default_rng(0))


def test_features_that_determine_each_other_are_refused_without_floor() -> None:
    x = blobs()
    with pytest.raises(LibraryFormatError, match="raise the floor"):
        fit_mixture(
            np.column_stack([x, x[:, 0] - 2 * x[:, 1]]),
            MixtureConfig(2, covariance_floor=0.0),
            np.random.default_rng(0),
        )


@pytest.mark.parametrize(
    ("x", "message"),
    [
        (np.ones((30, 2)), "samples that differ"),
        (np.zeros((0, 2)), "samples that differ"),
        (np.repeat(np.eye(2), 10, axis=0), "as many distinct samples"),
        (np.array([[0.0, 1.0], [np.nan, 2.0]] * 10), "finite"),
        (np.arange(5.0), "shape"),
    ],
)
def test_samples_that_say_too_little_are_refused(x: np.ndarray, message: str) -> None:
    with pytest.raises(LibraryFormatError, match=message):
        fit_mixture(x, MixtureConfig(4), np.random.default_rng(0))


@pytest.mark.parametrize(
    "change",
    [
        {"weights": [0.5, 0.6, 0.2]},
        {"weights": [1.0, 0.0, 0.0]},
        {"weights": [1.0]},
        {"means": np.zeros((2, 4))},
        {"covariances": np.zeros((3, 4, 4))},
        {"covariances": np.stack([np.diag([1.0, 1.0, 1.0, -1.0])] * 3)},
        {"covariances": np.stack([np.eye(4) + np.eye(4, k=1)] * 3)},
        {"covariances": np.full((3, 4, 4), np.nan)},
    ],
)
def test_what_is_no_mixture_is_refused(change: dict[str, np.ndarray]) -> None:
    good = random_mixture(0)
    parts = {"weights": good.weights, "means": good.means, "covariances": good.covariances} | change
    with pytest.raises(ArrayError):
        GaussianMixture(**parts)


@pytest.mark.parametrize(
    "settings",
    [{"n_components": 0}, {"covariance_floor": -1.0}, {"tolerance": float("nan")}, {"max_iterations": 0}],
)
def test_impossible_settings_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        MixtureConfig(**settings)


def test_a_mixture_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        random_mixture(0).means[0, 0] = 1.0
