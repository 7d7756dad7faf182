"""Onsets and ends in streams of postures, and where and how a body rests."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError, MotionError, SettingsError
from humanpred_ros.recognition.onset import MotionState, OnsetDetector, OnsetSettings, RestModel

REST = np.array([[0.1, -0.25, -0.2], [0.0, -0.3, 0.1], [0.0, 0.0, 0.5]])
GOAL = np.array([[0.6, -0.1, 0.1], [0.3, -0.25, 0.25], [0.05, 0.0, 0.5]])


def stream(
    *, rate_hz: float = 60.0, rest_s: float = 3.0, reach_s: float = 1.6, dwell_s: float = 0.3, noise_m: float = 0.003,
    seed: int = 0, back: bool = True,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return stamps and points (T, 3, 3): rest, reach, dwell, back, rest."""
    half = reach_s / 2
    end = rest_s + half + dwell_s
    t = np.arange(0.0, end + half + rest_s, 1.0 / rate_hz)

    def smooth(x: np.ndarray) -> np.ndarray:
        x = np.clip(x, 0.0, 1.0)
        return x**3 * (10 - 15 * x + 6 * x**2)

    share = smooth((t - rest_s) / half) - (smooth((t - end) / half) if back else 0.0)
    points = REST + share[:, None, None] * (GOAL - REST)
    return t, points + np.random.default_rng(seed).normal(0.0, noise_m, points.shape)


def states(t: np.ndarray, points: np.ndarray, detector: OnsetDetector | None = None) -> list[MotionState]:
    detector = OnsetDetector() if detector is None else detector
    return [detector.update(x, float(stamp)) for x, stamp in zip(points, t, strict=True)]


@settings(max_examples=25)
@given(
    rate_hz=st.sampled_from([30.0, 60.0, 100.0]),
    reach_s=st.floats(1.0, 3.0),
    dwell_s=st.floats(0.0, 0.8),
    seed=st.integers(0, 1000),
)
def test_out_and_back_is_one_motion_found_in_time(rate_hz: float, reach_s: float, dwell_s: float, seed: int) -> None:
    t, points = stream(rate_hz=rate_hz, reach_s=reach_s, dwell_s=dwell_s, seed=seed)
    found = states(t, points)
    moving = np.array([state.moving for state in found])
    assert found[-1].n_motions == 1
    begun = t[np.argmax(moving)]
    # A tenth of the way out is where anybody would say that it has begun.
    tenth = t[np.argmax(np.linalg.norm(points[:, 0] - REST[0], axis=1) > 0.06)]
    assert 3.0 <= begun <= tenth + 0.2
    assert not moving[-1]
    assert t[len(moving) - 1 - np.argmax(moving[::-1])] <= 3.0 + reach_s + dwell_s + 0.8
    assert abs(found[np.argmax(moving)].since_s - 3.0) < 0.25 * reach_s


def test_standing_with_noise_is_no_motion() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 120.0, 1 / 30)
    sway = 0.02 * np.sin(2 * np.pi * t / 20.0)[:, None, None]
    assert states(t, REST + sway + rng.normal(0.0, 0.004, (len(t), 3, 3)))[-1].n_motions == 0


def test_one_mistracked_frame_starts_nothing() -> None:
    t, points = stream()
    points[100] += 3.0
    assert not any(state.moving for state, stamp in zip(states(t, points), t, strict=True) if stamp < 3.0)


def test_who_stays_at_the_goal_rests_there_after_a_while() -> None:
    t, points = stream(rest_s=4.0, back=False)
    found = states(t, points)
    moving = np.array([state.moving for state in found])
    assert found[-1].n_motions == 1
    assert not moving[-1]
    ended = t[len(moving) - 1 - np.argmax(moving[::-1])]
    assert 4.8 + 1.0 < ended < 4.8 + OnsetSettings().far_s + 0.5


def test_a_gap_ends_what_was() -> None:
    t, points = stream()
    k = int(np.argmax(t > 3.6))
    detector = OnsetDetector()
    assert states(t[:k], points[:k], detector)[-1].moving
    assert not detector.update(points[k], float(t[k]) + OnsetSettings().gap_s + 0.1).moving


@pytest.mark.parametrize(
    ("points", "t_s", "error"),
    [
        (np.full((3, 3), np.nan), 5.0, ArrayError),
        (np.zeros((2, 3)), 5.0, ArrayError),
        (REST, float("nan"), MotionError),
        (REST, 0.0, MotionError),
    ],
)
def test_what_cannot_be_used_changes_nothing(points: np.ndarray, t_s: float, error: type[Exception]) -> None:
    t, good = stream()
    with_bad, without = OnsetDetector(), OnsetDetector()
    for k, (x, stamp) in enumerate(zip(good, t, strict=True)):
        assert with_bad.update(x, float(stamp)) == without.update(x, float(stamp))
        if k % 50 == 49:
            with pytest.raises(error):
                with_bad.update(points, t_s if t_s != 5.0 else float(stamp) + 0.001)


USUAL = np.array([0.006, 0.006, 0.006, 0.004, 0.004, 0.004])
PLACE = np.array([0.2, -0.3, 0.1, 0.1, -0.3, 0.3])


def rested(scatter: np.ndarray, *, n: int = 3000, config: OnsetSettings | None = None, seed: int = 0) -> RestModel:
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
    config = OnsetSettings(turn_rad=turn_rad)
    model = rested(np.diag(USUAL) + 0.002 * np.cos(angle), n=300, config=config, seed=seed)
    turned = turn_rad * np.array([-model.place[1], model.place[0], 0.0, -model.place[4], model.place[3], 0.0])
    covariance = model.covariance + config.floor_m**2 * np.eye(6) + np.outer(turned, turned)
    x = PLACE + np.random.default_rng(seed).normal(0.0, 0.03, 6)
    known = model.rested_s / (model.rested_s + 0.1)
    square = known * (x - model.place) @ np.linalg.solve(covariance, x - model.place) / 6
    assert model.distance(x) == pytest.approx(np.sqrt(square), rel=1e-9)


def test_the_scatter_of_this_person_is_learned() -> None:
    wide = np.diag([0.03, 0.001, 0.001, 0.001, 0.001, 0.001])
    model = rested(wide, n=12000, config=OnsetSettings(trusted=100.0))
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
    left = np.exp(-sum(parts) / model.settings.drift_s)
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


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"floor_m": 0.0}, "floor_m"),
        ({"noise_s": float("nan")}, "noise_s"),
        ({"scatter_m": (0.01, 0.0, 0.01)}, "scatter_m"),
        ({"scatter_m": (0.01, 0.01)}, "scatter_m"),
        ({"settle_s": 0.6}, "settle_s"),
        ({"distance": 2.45}, "distance"),
        ({"near_s": 3.0}, "near_s"),
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        OnsetSettings(**changes)
