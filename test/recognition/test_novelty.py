"""A reach to where no motion of the library goes is noticed; one like the library's is not."""

from __future__ import annotations

import numpy as np

from humanpred_ros.recognition.novelty import COLUMNS, Novelty
from humanpred_ros.recognition.reach_features import N_FEATURES, REACHED

RNG = np.random.default_rng(0)


def reach_to(goal: np.ndarray, n: int = 25) -> np.ndarray:
    """Return (n, F) features of one straight reach; only the columns that novelty looks at are filled."""
    palm = np.linspace(0.0, 1.0, n)[:, None] * (goal + RNG.normal(0.0, 0.02, 3))
    features = np.zeros((n, N_FEATURES), dtype=np.float32)
    features[:, COLUMNS[:3]], features[:, COLUMNS[3:]] = palm, palm
    features[:, REACHED] = np.linalg.norm(palm, axis=1)
    return features


GOALS = np.array([[0.6, x, 0.0] for x in (-0.4, -0.15, 0.1, 0.35)])


def learned(wild: bool = False) -> Novelty:
    motions = [reach_to(goal) for goal in GOALS for _ in range(8)]
    if wild:  # a mistracked motion of the first class, that goes where no class is
        motions[0] = reach_to(np.array([0.2, 0.9, 0.5]))
    first = np.arange(0, 25 * len(motions) + 1, 25)
    return Novelty.fit(np.vstack(motions), first, np.repeat(np.arange(4), 8))


def test_known_reaches_are_known_and_others_are_not() -> None:
    novelty = learned()
    known = np.array([novelty.log_ratio(reach_to(goal))[-1] for goal in GOALS for _ in range(5)])
    elsewhere = np.array([novelty.log_ratio(reach_to(np.array([0.2, 0.7, 0.4])))[-1] for _ in range(10)])
    assert (known < -1.0).mean() >= 0.9
    assert (elsewhere > 2.0).all()


def test_before_the_reach_begins_nothing_is_known() -> None:
    ratio = learned().log_ratio(reach_to(GOALS[1]))
    assert abs(ratio[0]) < 1.0
    assert ratio[-1] < ratio[0]


def test_one_mistracked_motion_does_not_make_its_place_known() -> None:
    novelty = learned(wild=True)
    assert novelty.log_ratio(reach_to(np.array([0.2, 0.9, 0.5])))[-1] > 2.0


def test_the_distance_is_that_to_the_second_nearest_motion() -> None:
    novelty = learned()
    features = reach_to(np.array([0.5, 0.5, 0.1]))
    x = features[:, COLUMNS]
    nearest = [
        np.linalg.norm(novelty.points[a:b] - x[-1], axis=1).min() / np.sqrt(2.0)
        for a, b in zip(novelty.first[:-1], novelty.first[1:], strict=True)
    ]
    np.testing.assert_allclose(novelty.distance_m(features)[-1], sorted(nearest)[1], rtol=1e-5)
