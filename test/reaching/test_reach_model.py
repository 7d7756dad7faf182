"""What is learned about reaches, and how one under way may go on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from small_library import REST, small_library

from humanpred_ros.errors import HumanModelError, MotionError, PlanningError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.solids import Box, Obstacle, planar_pose
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import HAND
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.futures import ReachFutures, ReachFuturesSettings
from humanpred_ros.reaching.progress import ReachProgress
from humanpred_ros.reaching.reach_model import ReachModel
from humanpred_ros.reaching.surroundings import Surroundings

HUMAN = HumanModel.kinect12()
WEIGHTS = NAMED_WEIGHTS["authors_dynamic"]


@cache
def learned(there_and_back: bool = False) -> ReachModel:
    return ReachModel.learn(small_library(4, there_and_back=there_and_back).motions, HUMAN)


def place_of(label: int) -> FloatArray:
    q = small_library(4).of_class(label)[0].q
    return np.asarray(HUMAN.forward(q[-1])[HAND])


def seen(n: int, label: int = 0, there_and_back: bool = False) -> ReachProgress:
    progress = ReachProgress(HUMAN)
    for q in small_library(4, there_and_back=there_and_back, seed=3).of_class(label)[0].q[:n]:
        progress.update(q)
    return progress


def hands(futures: FloatArray) -> FloatArray:
    flat = HUMAN.forward(futures.reshape(-1, futures.shape[2]))[HAND]
    return np.asarray(flat.reshape(*futures.shape[:2], 3))


def test_whether_people_come_back_is_learned() -> None:
    assert learned(False).returning == 0.0
    assert learned(True).returning == 1.0
    assert 0.2 < learned(False).pace_s_m < 10.0
    assert learned(True).rest_deviation[0] == pytest.approx(learned(True).rest_deviation[1])


@pytest.mark.parametrize("planned", [False, True])
@pytest.mark.parametrize("n", [1, 15, 25])
def test_futures_begin_now_and_end_at_the_place(n: int, planned: bool) -> None:
    progress = seen(n, label=10)
    futures = ReachFutures(learned(), WEIGHTS, settings=ReachFuturesSettings(planned=planned)).towards(
        progress, place_of(10)
    )
    assert futures.shape[0] == 16
    np.testing.assert_allclose(futures[:, 0], np.tile(progress.posture, (16, 1)), atol=1e-9)
    off = np.linalg.norm(hands(futures)[:, -1] - place_of(10), axis=1)
    assert np.median(off) < 0.1


def test_futures_towards_another_place_go_elsewhere() -> None:
    progress = seen(8)
    futures = ReachFutures(learned(), WEIGHTS)
    places = [place_of(0) + offset for offset in ([0.0, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2])]
    ends = [hands(futures.towards(progress, place))[:, -1].mean(axis=0) for place in places]
    assert ends[1][1] - ends[0][1] > 0.12
    assert ends[2][2] - ends[0][2] > 0.12


def test_the_more_is_seen_the_less_the_futures_differ() -> None:
    futures = ReachFutures(learned(), WEIGHTS)
    spread = [futures.towards(seen(n), place_of(0))[:, -1].std(axis=0)[:7].sum() for n in (2, 20, 32)]
    assert spread[0] > spread[1] > spread[2]


def test_who_comes_back_is_predicted_to() -> None:
    futures = ReachFutures(learned(True), WEIGHTS).towards(seen(10, there_and_back=True), place_of(0))
    way = hands(futures)
    start = HUMAN.forward(REST)[HAND]
    assert np.linalg.norm(way[:, -1] - start, axis=1).max() < 0.25
    assert np.linalg.norm(way - place_of(0), axis=2).min(axis=1).max() < 0.15


def test_a_hand_that_has_turned_goes_back_wherever_it_comes_from() -> None:
    progress = seen(30, there_and_back=True)
    assert progress.turned
    futures = ReachFutures(learned(True), WEIGHTS)
    back = futures.towards(progress, place_of(0))
    np.testing.assert_array_equal(back, futures.towards(progress, place_of(10)))
    np.testing.assert_allclose(back[:, 0], np.tile(progress.posture, (16, 1)), atol=1e-9)
    assert np.linalg.norm(hands(back)[:, -1] - HUMAN.forward(REST)[HAND], axis=1).max() < 0.25


def test_some_come_back_and_others_stay() -> None:
    half = replace(learned(True), returning=0.5)
    way = hands(ReachFutures(half, WEIGHTS).towards(seen(10, there_and_back=True), place_of(0)))
    stays = np.linalg.norm(way[:, -1] - HUMAN.forward(REST)[HAND], axis=1) > 0.3
    assert stays.sum() == 8


def test_what_stands_in_the_way_is_avoided_by_the_planner() -> None:
    progress, place = seen(1, label=20), place_of(20)
    clear = ReachFutures(learned(), WEIGHTS)
    middle = hands(clear.towards(progress, place)).mean(axis=0)
    middle = middle[len(middle) // 2]
    # A post just beside the way, narrower than the way is long.
    post = Obstacle("post", Box(0.1, 0.1, 0.3), planar_pose(middle[0], middle[1] - 0.06, middle[2]))
    scene = Surroundings((post,), middle - 1.0, middle + 1.0)
    config = ReachFuturesSettings(n_samples=32)
    avoided = hands(ReachFutures(learned(), WEIGHTS, scene, config).towards(progress, place))
    free = hands(ReachFutures(learned(), WEIGHTS, None, config).towards(progress, place))
    centre = np.array([middle[0], middle[1] - 0.06])
    least = [np.linalg.norm(way.mean(axis=0)[:, :2] - centre, axis=1).min() for way in (avoided, free)]
    assert least[0] > least[1] + 0.04


@pytest.mark.parametrize("yaw", [1.5, -2.9])
def test_futures_turn_with_the_person(yaw: float) -> None:
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    here, there = ReachProgress(HUMAN), ReachProgress(HUMAN)
    for q in small_library(4, there_and_back=True, seed=3).of_class(0)[0].q[:12]:
        here.update(q)
        moved = q.copy()
        moved[:3] = R @ q[:3]
        moved[3] += yaw
        there.update(moved)
    model = replace(learned(True), rest_deviation=np.full(12, 1e-9))
    futures = ReachFutures(model, WEIGHTS, settings=ReachFuturesSettings(planned=False))
    ways = [hands(futures.towards(p, place)) for p, place in ((here, place_of(0)), (there, R @ place_of(0)))]
    np.testing.assert_allclose(ways[1].mean(axis=0), ways[0].mean(axis=0) @ R.T, atol=2e-3)


def test_one_wild_posture_neither_turns_the_hand_back_nor_winds_the_arm_up() -> None:
    q = small_library(4, seed=3).of_class(0)[0].q.copy()
    q[14, 7:10] += [1.5, 0.0, 3.0]
    q[14, 11] *= 0.2
    progress = ReachProgress(HUMAN)
    for posture in q[:20]:
        progress.update(posture)
    assert not progress.turned
    np.testing.assert_allclose(progress.posture, q[19])
    assert progress.reached_m < 1.05 * seen(20).reached_m


def test_the_same_is_predicted_of_the_same() -> None:
    one, other = (ReachFutures(learned(), WEIGHTS).towards(seen(12), place_of(0)) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    different = ReachFutures(learned(), WEIGHTS, settings=ReachFuturesSettings(seed=5)).towards(seen(12), place_of(0))
    assert np.abs(different - one).max() > 1e-3


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(MotionError, match="at least one motion"):
        ReachModel.learn([], HUMAN)
    with pytest.raises(HumanModelError, match="DoF"):
        ReachModel.learn(small_library(1).motions, HumanModel.mocap23())
    with pytest.raises(MotionError, match="share"):
        replace(learned(), returning=1.5)
    with pytest.raises(SettingsError, match="even number"):
        ReachFuturesSettings(n_samples=7)
    with pytest.raises(PlanningError):
        ReachFutures(learned(), -WEIGHTS)
