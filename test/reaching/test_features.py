"""The 24 features are those of P2's pipeline, and follow from their definition."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import shared_data
from reaching_people import MODEL, START, recording

from humanpred_ros.errors import ArrayError, HumanPredError, MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.demonstrations import demonstration
from humanpred_ros.reaching.features import (
    N_FEATURES,
    PADDING,
    REACH,
    RULES,
    SCALES,
    ReachFeatures,
    ReachSituation,
)

pytestmark = pytest.mark.core

FEATURES = ReachFeatures(MODEL)
#: Features of accelerations and jerks. Stamps in the files are rounded to 1e-6 s, which moves postures resampled in
#: time by up to 1e-6 of a step; differences of higher order enlarge that to some 1e-4 (measured by jittering stamps).
ROUNDED = (2, 3, 6, 7)


def example(history: bool) -> tuple[FloatArray, ReachSituation]:
    demo = demonstration(recording(3), FEATURES)
    before = demo.q[0] + 0.02 * np.random.default_rng(0).normal(size=(PADDING, 23)) if history else None
    return demo.q, ReachSituation(1.3, demo.situation.partner_m, before)


def plain(q: FloatArray, situation: ReachSituation) -> FloatArray:
    """Say the features once more, in as few words as possible."""
    links = ("pelvis", "right_wrist", "right_elbow", "right_shoulder")
    before = np.repeat(q[:1], PADDING, axis=0) if situation.history is None else situation.history
    padded = np.concatenate([before, q, np.repeat(q[-1:], PADDING, axis=0)])
    wrist = MODEL.forward(padded)["right_wrist"]
    n, dt_s = len(q), situation.duration_s / (len(q) - 1)
    values = []
    for signal in (padded, wrist):
        values.append((np.diff(signal[PADDING:-PADDING], axis=0) ** 2).sum())
        for order, rule in enumerate(RULES, start=1):
            rows = sum(rule[3 + o] * signal[PADDING + o : PADDING + o + n] for o in range(-3, 4)) / dt_s**order
            values.append((rows**2).sum())
    places = MODEL.forward(q)
    for link in links:
        for other in situation.partner_m:
            d = np.linalg.norm(places[link] - other, axis=1)
            values.append(dt_s * np.where(d < 0.8, 5.0 * 6.0 ** (-d / 0.16), 0.0).sum())
    return np.array(values) * SCALES


def test_features_are_those_of_the_papers_pipeline() -> None:
    recordings = {entry.name: entry for entry in load_reach_recordings(shared_data("icra2015/demos"))}
    with shared_data("icra2015/feature_reference.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 7
    for row in rows:
        demo = demonstration(recordings[row.pop("demo")], FEATURES)
        wanted = np.array([float(value) for value in row.values()])
        got = FEATURES.values(demo.q, demo.situation)
        off = np.abs(got - wanted) / np.maximum(wanted, 1e-12)
        assert np.delete(off, ROUNDED).max() < 1e-5
        assert off[list(ROUNDED)].max() < 3e-4


@pytest.mark.parametrize("history", [False, True])
def test_features_are_what_their_definition_says(history: bool) -> None:
    q, situation = example(history)
    np.testing.assert_allclose(FEATURES.values(q, situation), plain(q, situation), rtol=1e-9)


def test_a_batch_gives_what_each_reach_gives_alone() -> None:
    q, situation = example(True)
    batch = q + 0.01 * np.random.default_rng(1).normal(size=(5, 1, 23))
    together = FEATURES.values(batch, situation)
    assert together.shape == (5, N_FEATURES)
    np.testing.assert_allclose(together, [FEATURES.values(one, situation) for one in batch], rtol=1e-12)
    np.testing.assert_allclose(FEATURES.waypoint_values(batch, situation).sum(axis=1), together, rtol=1e-12)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.2, 5.0))
def test_features_follow_from_the_way_and_not_from_where_it_happens(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    small = ReachFeatures(MODEL, n_waypoints=12)
    q = START + np.cumsum(0.05 * rng.normal(size=(12, 23)), axis=0)
    partner = small.link_points(q[6]) + 0.3 * rng.normal(size=(4, 3))
    values = small.values(q, ReachSituation(1.0, partner))
    assert (values >= 0.0).all()
    # Somewhere else in the room, with the partner.
    step = rng.normal(size=3)
    np.testing.assert_allclose(
        small.values(q + np.concatenate([step, np.zeros(20)]), ReachSituation(1.0, partner + step)), values, rtol=1e-6
    )
    # In another time: velocity, acceleration and jerk squared, and the time spent near the partner.
    slower = small.values(q, ReachSituation(factor, partner))
    powers = np.array([0, -2, -4, -6] * 2 + [1] * 16)
    np.testing.assert_allclose(slower, values * factor**powers, rtol=1e-9)


def test_a_person_who_was_moving_already_is_not_charged_for_starting() -> None:
    line = np.linspace(0.0, 0.5, 100 + PADDING)[:, None] * np.ones(23) + recording(0).active.q[0]
    partner = np.full((4, 3), 9.0)
    rest = FEATURES.values(line[PADDING:], ReachSituation(1.0, partner))
    moving = FEATURES.values(line[PADDING:], ReachSituation(1.0, partner, line[:PADDING]))
    assert moving[3] < 0.7 * rest[3]  # the jerk of starting is gone, that of stopping is not
    assert moving[0] == rest[0]


def test_far_partners_do_not_count() -> None:
    q, situation = example(False)
    away = ReachSituation(1.3, situation.partner_m + np.array([0.0, 0.0, 5.0]))
    assert (FEATURES.values(q, away)[8:] == 0.0).all()
    assert (FEATURES.values(q, situation)[8:] > 0.0).any()


def test_the_human_of_the_kinect_has_the_same_features() -> None:
    model = HumanModel.kinect12()
    features = ReachFeatures(model, n_waypoints=20)
    q = np.linspace(np.zeros(12), np.full(12, 0.3), 20)
    values = features.values(q, ReachSituation(1.0, features.link_points(q[0])))
    assert values.shape == (N_FEATURES,)
    assert np.isfinite(values).all()


@pytest.mark.parametrize(
    ("error", "text", "make"),
    [
        (MotionError, "positive duration", lambda: ReachSituation(0.0, np.zeros((4, 3)))),
        (MotionError, "partner_m", lambda: ReachSituation(1.0, np.zeros((3, 3)))),
        (ArrayError, "history", lambda: ReachSituation(1.0, np.zeros((4, 3)), np.zeros((5, 23)))),
        (SettingsError, "n_waypoints.*7.*6", lambda: ReachFeatures(MODEL, n_waypoints=6)),
        (ArrayError, "reaches", lambda: FEATURES.values(np.zeros((99, 23)), ReachSituation(1.0, np.zeros((4, 3))))),
        (
            ArrayError,
            "history: wanted 23",
            lambda: FEATURES.values(np.zeros((100, 23)), ReachSituation(1.0, np.zeros((4, 3)), np.zeros((6, 12)))),
        ),
    ],
)
def test_what_does_not_fit_is_refused(error: type[HumanPredError], text: str, make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(error, match=text):
        make()


@pytest.mark.parametrize("order", [1, 2, 3])
def test_each_rule_is_the_derivative_of_its_order(order: int) -> None:
    offsets = np.arange(-REACH, REACH + 1)
    rule = RULES[order - 1]
    factorial = (1.0, 1.0, 2.0, 6.0)[order]
    for power in range(order):
        assert rule @ offsets.astype(float) ** power == pytest.approx(0.0, abs=1e-12)
    assert rule @ offsets.astype(float) ** order == pytest.approx(factorial)
