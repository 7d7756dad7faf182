"""Rest is known by its place and its scatter; both follow slowly, and what the tracker got wrong hardly counts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import UsageError
from humanpred_ros.recognition.rest_model import RestConfig, RestModel

USUAL = np.array([0.006, 0.006, 0.006, 0.004, 0.004, 0.004])
PLACE = np.array([0.2, -0.3, 0.1, 0.1, -0.3, 0.3])


def rested(scatter: np.ndarray, *, n: int = 3000, config: RestConfig | None = None, seed: int = 0) -> RestModel:
    """Return a model that has watched a body at rest at 60 Hz, its points scattered by a factor (6, 6)."""
    rng = np.random.default_rng(seed)
    model = RestModel(USUAL, config)
    model.settle(PLACE[None], 0.0)
    for noise in rng.normal(size=(n, 6)) @ scatter.T:
        model.learn(PLACE + noise, model.distance(PLACE + noise), 1 / 60)
    return model


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), angle=st.floats(0.0, 3.1), turn_rad=st.floats(1e-6, 0.05))
def test_the_distance_is_mahalanobis_with_floor_and_turn(seed: int, angle: float, turn_rad: float) -> None:
    config = RestConfig(turn_rad=turn_rad)
    model = rested(np.diag(USUAL) + 0.002 * np.cos(angle), n=300, config=config, seed=seed)
    turned = turn_rad * np.array([-model.place[1], model.place[0], 0.0, -model.place[4], model.place[3], 0.0])
    covariance = model.covariance + config.floor_m**2 * np.eye(6) + np.outer(turned, turned)
    x = PLACE + np.random.default_rng(seed).normal(0.0, 0.03, 6)
    known = model.rested_s / (model.rested_s + 0.1)
    square = known * (x - model.place) @ np.linalg.solve(covariance, x - model.place) / 6
    assert model.distance(x) == pytest.approx(np.sqrt(square), rel=1e-9)


def test_the_scatter_of_this_person_is_learned() -> None:
    wide = np.diag([0.03, 0.001, 0.001, 0.001, 0.001, 0.001])
    model = rested(wide, n=12000, config=RestConfig(trusted=100.0))
    np.testing.assert_allclose(np.sqrt(np.diag(model.covariance))[0], 0.03, rtol=0.25)
    away = np.zeros(6)
    away[0] = 0.05
    across = np.roll(away, 1)
    assert model.distance(PLACE + across) > 4 * model.distance(PLACE + away)


def test_one_wild_frame_changes_place_and_scatter_little() -> None:
    model = rested(np.diag(USUAL))
    place, covariance = model.place.copy(), model.covariance.copy()
    for wild in (PLACE + 1.0, PLACE + 1e6, PLACE + 1e200):
        model.learn(wild, model.distance(wild), 1 / 30)
    assert np.abs(model.place - place).max() < 0.002
    assert np.abs(model.covariance - covariance).max() < 0.3 * USUAL.max() ** 2


def test_the_place_follows_drift() -> None:
    model = rested(np.diag(USUAL))
    for k in range(600):
        x = PLACE + 0.01 * k / 60
        model.learn(x, model.distance(x), 1 / 60)
    assert np.abs(model.place - x).max() < 0.01


@settings(max_examples=20)
@given(parts=st.lists(st.sampled_from([1 / 100, 1 / 60, 1 / 30]), min_size=200, max_size=300))
def test_time_counts_and_not_frames(parts: list[float]) -> None:
    """A body that lies still somewhere else is followed the same way at any rate."""
    model = RestModel(USUAL)
    model.settle(PLACE[None], 1.0)
    x = PLACE + 0.005
    for step_s in parts:
        model.learn(x, model.distance(x), step_s)
    left = np.exp(-sum(parts) / model.config.drift_s)
    assert abs(float((x - model.place)[0]) / 0.005 - left) < 0.05


def test_settling_takes_the_scatter_of_the_new_rest_but_no_single_bad_frame() -> None:
    rng = np.random.default_rng(3)
    frames = PLACE + rng.normal(0.0, 0.01, (18, 6))
    clean, wild = RestModel(USUAL), RestModel(USUAL)
    clean.settle(frames, 0.3)
    assert clean.covariance[0, 0] > USUAL[0] ** 2  # noisier than usual
    frames[7] += 0.5
    wild.settle(frames, 0.3)
    assert np.abs(wild.place - clean.place).max() < 0.01
    assert np.trace(wild.covariance) < 3 * np.trace(clean.covariance)


def test_a_rest_just_begun_is_uncertain() -> None:
    model = RestModel(USUAL)
    model.settle(PLACE[None], 0.0)
    assert model.distance(PLACE + 1.0) == 0.0
    model.settle(np.tile(PLACE, (5, 1)), 0.1)
    early = model.distance(PLACE + 0.05)
    model.rested_s = 10.0
    assert early < model.distance(PLACE + 0.05)


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(UsageError, match="floor_m"):
        RestConfig(floor_m=0.0)
    with pytest.raises(UsageError, match="noise_s"):
        RestConfig(noise_s=float("nan"))
