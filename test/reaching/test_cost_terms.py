"""The cost terms of a reach are the features times their weights, and the obstacle potential of docs/papers.md."""

from __future__ import annotations

import numpy as np
import pytest
from reaching_people import GOAL, MODEL, PARTNER, START, reach

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.reaching.cost_terms import BodyCost, PostureSmoothness, ReachBody
from humanpred_ros.reaching.features import LINK_POINTS, N_FEATURES, ReachFeatures, ReachSituation
from humanpred_ros.reaching.surroundings import Surroundings

N = 100
FEATURES = ReachFeatures(MODEL)
BODY = ReachBody(MODEL)
SCENE = Surroundings.of_p2()
NO_WEIGHTS = np.zeros(N_FEATURES)
#: The features of the wrist.
WRIST = np.arange(N_FEATURES) < 8
#: Weights under which every feature matters about as much.
EVEN = 1.0 / np.array([0.1, 0.1, 3e-3, 1e-3, 0.1, 0.05, 2e-5, 5e-5, *([0.3] * 16)])


def reaches(count: int = 3) -> FloatArray:
    q = np.stack([reach(seed)[1] for seed in range(count)])
    q[:, 0] = START
    return np.ascontiguousarray(q.astype(np.float32)).astype(np.float64)  # what float32 can say


def history(q: FloatArray) -> FloatArray:
    rng = np.random.default_rng(5)
    return (q[0, 0] + 0.01 * np.arange(-6, 0)[:, None] * rng.normal(size=23)).astype(np.float32).astype(np.float64)


def situation(past: FloatArray | None = None, duration_s: float = 1.3) -> ReachSituation:
    return ReachSituation(duration_s, FEATURES.link_points(PARTNER), past)


def terms(weights: FloatArray, around: ReachSituation, first: FloatArray) -> tuple[PostureSmoothness, BodyCost]:
    posture = PostureSmoothness(weights[:4], around.duration_s, N, first, around.history)
    return posture, BodyCost(BODY, weights, around, N, first)


@pytest.mark.parametrize("with_history", [False, True])
def test_terms_add_up_to_the_features(with_history: bool) -> None:
    q = reaches()
    around = situation(history(q) if with_history else None)
    posture, body = terms(EVEN, around, START)
    wanted = FEATURES.waypoint_values(q, around) * EVEN
    np.testing.assert_allclose(posture.costs(q), wanted[..., :4].sum(axis=2), rtol=2e-4, atol=1e-6)
    smooth, close = (terms(np.where(mask, EVEN, 0.0), around, START)[1].costs(q) for mask in (WRIST, ~WRIST))
    np.testing.assert_allclose(smooth.sum(axis=1), wanted[..., 4:8].sum(axis=(1, 2)), rtol=2e-3)
    np.testing.assert_allclose(close, wanted[..., 8:].sum(axis=2), rtol=2e-5, atol=1e-6)
    np.testing.assert_allclose(body.costs(q), smooth + close, rtol=1e-5)


@pytest.mark.parametrize("k", range(N_FEATURES))
def test_each_feature_alone(k: int) -> None:
    q, around = reaches(), situation()
    weights = NO_WEIGHTS.copy()
    weights[k] = 100.0
    posture, body = terms(weights, around, START)
    total = posture.costs(q).sum(axis=1, dtype=np.float64) + body.costs(q).sum(axis=1, dtype=np.float64)
    # Third differences of places cancel almost all digits of float32.
    rtol = {6: 1e-3, 7: 1e-2}.get(k, 1e-4)
    np.testing.assert_allclose(total, 100.0 * FEATURES.values(q, around)[:, k], rtol=rtol, atol=1e-7)


def test_history_changes_the_first_waypoints_only() -> None:
    q = reaches(1)
    alone = PostureSmoothness(EVEN[:4], 1.3, N, START).costs(q)
    moving = PostureSmoothness(EVEN[:4], 1.3, N, START, history(q)).costs(q)
    assert (alone[:, 0] != moving[:, 0]).any()
    np.testing.assert_array_equal(alone[:, 2:], moving[:, 2:])


def obstacle_oracle(q: FloatArray, field: SignedDistanceField, weight: float, clearance_m: float) -> FloatArray:
    points = BODY.points(q.reshape(-1, 23).astype(np.float32), with_body=True).astype(np.float64)
    points = points.reshape(*q.shape[:2], -1, 3)
    total = np.zeros(q.shape[:2])
    for a, b, begin, end in BODY.capsules:
        for share, radius in BODY.spheres[begin:end].astype(np.float64):
            place = points[..., a, :] + share * (points[..., b, :] - points[..., a, :])
            continued = np.concatenate([place[:, :1], place, place[:, -1:]], axis=1)
            way = 0.5 * np.linalg.norm(continued[:, 2:] - continued[:, :-2], axis=2)
            d = field.distance(place) - radius
            near = np.minimum(d - clearance_m, 0.0) ** 2 / (2.0 * clearance_m)
            total += weight * np.where(d < 0.0, 0.5 * clearance_m - d, near) * way
    return total


@pytest.mark.parametrize("clearance_m", [0.05, 0.2])
def test_obstacle_cost_equals_its_formula(clearance_m: float) -> None:
    q = reaches()
    q[1, :, 2] -= 0.35  # a body that goes through the table
    q[2, :, 0] -= 0.5  # and one through the partner
    ends = np.array([[[1.4, 0.75, 1.1], [1.4, 0.75, 1.5]]])
    field = SCENE.field_with(ends, [0.15])
    body = BodyCost(BODY, NO_WEIGHTS, situation(), N, START, field, obstacle_weight=4.0, clearance_m=clearance_m)
    wanted = obstacle_oracle(q, field, 4.0, clearance_m)
    assert (wanted[1:].sum(axis=1) > 0.01).all()
    np.testing.assert_allclose(body.costs(q), wanted, rtol=2e-3, atol=2e-5)


def test_body_points_are_where_the_model_has_them() -> None:
    points = BODY.points(GOAL.astype(np.float32)[None], with_body=True)[0]
    places = MODEL.forward(GOAL)
    for row, link in zip(BODY.all_points, LINK_POINTS, strict=True):
        np.testing.assert_allclose(points[row], places[link], atol=5e-6)
    alone = BODY.points(GOAL.astype(np.float32)[None], with_body=False)[0]
    np.testing.assert_allclose(alone[BODY.feature_points], points[BODY.all_points], atol=1e-6)


def test_obstacles_are_added_to_wrist_and_partner() -> None:
    q = reaches()
    field = SCENE.field_with(np.zeros((0, 2, 3)), [])
    without = BodyCost(BODY, EVEN, situation(), N, START).costs(q)
    alone = BodyCost(BODY, NO_WEIGHTS, situation(), N, START, field).costs(q)
    together = BodyCost(BODY, EVEN, situation(), N, START, field).costs(q)
    np.testing.assert_allclose(together, without + alone, rtol=1e-2, atol=1e-4)


def test_impossible_settings_are_refused() -> None:
    around = situation()
    with pytest.raises(PlanningError, match="weights >= 0"):
        PostureSmoothness([-1.0, 0.0, 0.0, 0.0], 1.3, N, START)
    with pytest.raises(PlanningError, match="duration"):
        PostureSmoothness(np.ones(4), 0.0, N, START)
    with pytest.raises(PlanningError, match="100 waypoints"):
        PostureSmoothness(np.ones(4), 1.3, N, START).costs(reaches()[:, :50])
    with pytest.raises(PlanningError, match="100 waypoints"):
        BodyCost(BODY, EVEN, around, N, START).costs(reaches()[:, :50])
    with pytest.raises(PlanningError, match="clearance"):
        BodyCost(BODY, EVEN, around, N, START, SCENE.field, clearance_m=0.0)
    with pytest.raises(PlanningError, match="closeness"):
        BodyCost(BODY, -EVEN * (np.arange(24) > 7), around, N, START)
