"""Futures begin where the body is, lead to the places they are made for, and return if people do."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from small_library import REST, small_library

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import HAND
from humanpred_ros.reaching.futures import ReachFutures, ReachFuturesSettings
from humanpred_ros.reaching.reach_model import ReachModel, ReachProgress

HUMAN = HumanModel.kinect12()
PLACES = np.array([[0.62, -0.35, 0.66], [0.62, -0.12, 0.7], [0.48, -0.55, 0.7], [0.65, -0.3, 0.45]])


@cache
def futures(there_and_back: bool = False) -> ReachFutures:
    model = ReachModel.learn(small_library(4, there_and_back=there_and_back).motions, HUMAN)
    return ReachFutures(model, np.ones(24), settings=ReachFuturesSettings(planned=False))


def under_way(place: FloatArray, done: float = 0.3) -> ReachProgress:
    """Return somebody who has done a share of the way to a place."""
    progress = ReachProgress(HUMAN)
    end = futures().model.ends.mean(REST, place)
    for share in np.concatenate([np.zeros(5), np.linspace(0.0, done, 10)]):
        progress.update(REST + share * (end - REST))
    return progress


def hands(q: FloatArray) -> FloatArray:
    return np.asarray(HUMAN.forward(q.reshape(-1, 12))[HAND]).reshape(*q.shape[:2], 3)


@pytest.mark.parametrize("there_and_back", [False, True])
def test_one_future_to_each_place_is_what_all_to_one_place_are_made_of(there_and_back: bool) -> None:
    subject, progress = futures(there_and_back), under_way(PLACES[0])
    for place in PLACES[:2]:
        all_there = subject.towards(progress, place)
        np.testing.assert_allclose(subject.towards_each(progress, np.tile(place, (16, 1))), all_there, atol=1e-9)
        few = subject.towards_each(progress, np.tile(place, (5, 1)))
        np.testing.assert_allclose(few, all_there[:5], atol=1e-9)


def test_each_future_leads_from_here_to_its_own_place() -> None:
    progress = under_way(PLACES[0], 0.1)
    q = futures().towards_each(progress, PLACES)
    assert q.shape[0] == len(PLACES)
    np.testing.assert_allclose(q[:, 0], np.tile(progress.posture, (len(PLACES), 1)), atol=1e-9)
    miss = np.linalg.norm(hands(q)[:, None, -1] - PLACES, axis=2)
    assert np.diag(miss).max() < 0.2
    assert np.diag(miss).mean() < 0.5 * miss.mean()


def test_who_comes_back_comes_back_from_each_place() -> None:
    q = futures(True).towards_each(under_way(PLACES[0], 0.1), PLACES)
    hand, rest = hands(q), HUMAN.forward(REST)[HAND]
    nearest = np.linalg.norm(hand - PLACES[:, None], axis=2).min(axis=1)
    assert nearest.max() < 0.15
    assert np.linalg.norm(hand[:, -1] - rest, axis=1).max() < 0.15
