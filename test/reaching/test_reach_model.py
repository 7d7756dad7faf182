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
from humanpred_ros.reaching.end_postures import HAND, EndPosture, start_and_end
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.futures import ReachFutures, ReachFuturesSettings
from humanpred_ros.reaching.reach_model import N_SHARES, ReachModel, ReachProgress, ReachShape
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


def followed(q: FloatArray) -> ReachProgress:
    progress = ReachProgress(HUMAN)
    for posture in q:
        progress.update(posture)
    return progress


def test_a_reach_goes_from_nothing_to_all_of_the_way() -> None:
    q = small_library(1).motions[0].q
    place = HUMAN.forward(q[-1])[HAND]
    shares = [followed(q[: n + 1]).way_to(place) for n in range(len(q))]
    assert shares[2] < 0.1
    assert shares[-1] > 0.95
    assert np.diff(shares).min() > -0.05
    assert not followed(q).turned
    assert followed(q).way_back == 0.0


def test_a_hand_that_comes_back_has_turned_and_the_apex_is_remembered() -> None:
    q = small_library(1, there_and_back=True).motions[0].q
    progress = followed(q)
    assert progress.turned
    assert progress.way_back > 0.8
    hand = HUMAN.forward(q)[HAND]
    away = np.linalg.norm(hand - progress.start_hand_m, axis=1)
    np.testing.assert_allclose(progress.apex, q[int(np.argmax(away))], atol=0.02)
    assert progress.reached_m == pytest.approx(away.max(), abs=0.01)


def test_noise_is_no_turn_and_a_place_elsewhere_is_not_come_nearer() -> None:
    q = small_library(1).motions[0].q
    progress = followed(q)
    start = progress.start_hand_m
    assert progress.way_to(start - (HUMAN.forward(q[-1])[HAND] - start)) == 0.0
    jitter = np.vstack([q, q[-1] + 0.003, q[-1] - 0.003])
    assert not followed(jitter).turned


def test_angles_follow_without_whole_turns_and_the_start_forgives_one_wild_posture() -> None:
    q = small_library(1).motions[0].q.copy()
    wrapped = q.copy()
    wrapped[20:, 9] -= 2.0 * np.pi
    np.testing.assert_allclose(followed(wrapped).posture, followed(q).posture)
    wild = q.copy()
    wild[1] += 1.0
    np.testing.assert_allclose(followed(wild).start_posture, followed(q).start_posture, atol=0.02)


def test_a_new_start_forgets() -> None:
    q = small_library(1, there_and_back=True).motions[0].q
    progress = followed(q)
    progress.start()
    assert not progress.seen
    progress.update(q[0])
    assert progress.seen
    assert not progress.turned
    np.testing.assert_array_equal(progress.start_posture, q[0])


def bowed(count: int, height: float, seed: int = 0) -> list[np.ndarray]:
    """Return reaches whose torso leans aside on the way, `height` radians in the middle for each metre."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, 60)[:, None]
    reaches = []
    for _ in range(count):
        end = REST.copy()
        end[8] += 0.8 + 0.3 * rng.random()
        way = np.linalg.norm(HUMAN.forward(end)[HAND] - HUMAN.forward(REST)[HAND])
        bow = np.zeros((60, 12))
        bow[:, 6] = (height * way * 4.0 * phase * (1.0 - phase))[:, 0]
        reaches.append(REST + phase * (end - REST) + bow)
    return reaches


def test_a_bow_common_to_all_is_found_and_ends_at_nothing() -> None:
    shape = ReachShape.learn(bowed(8, 0.2), HUMAN)
    bow = shape.bow_at(np.array([0.0, 0.5, 1.0]), 1.0)
    np.testing.assert_allclose(bow[[0, 2]], 0.0, atol=1e-12)
    assert bow[1, 6] == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(shape.bow_at(np.array([0.5]), 2.0), 2.0 * bow[1:2])


def test_variation_is_of_what_varies() -> None:
    same = ReachShape.learn(bowed(8, 0.2), HUMAN).variation
    mixed = ReachShape.learn([*bowed(4, 0.2), *bowed(4, -0.2, seed=1)], HUMAN).variation
    assert mixed[6, 6] > 10.0 * same[6, 6]
    assert (np.linalg.eigvalsh(mixed) > 0.0).all()


def test_somebody_who_leans_more_at_half_the_way_leans_more_at_its_end() -> None:
    shape = ReachShape(np.zeros((N_SHARES, 12)), 1e-4 * np.eye(12))
    start, end = small_library(1).motions[0].q[[0, -1]]
    usual = EndPosture(end, 0.01 * np.eye(12), 0.0)
    half = start + 0.5 * (end - start)
    half[4] += 0.05
    given = shape.given(usual, start, half, 0.5, 0.5)
    assert given.mean[4] - end[4] == pytest.approx(0.1, rel=0.15)
    np.testing.assert_allclose(np.delete(given.mean, 4), np.delete(end, 4), atol=1e-9)
    assert (np.diag(given.covariance) < np.diag(usual.covariance)).all()


def test_nothing_seen_says_nothing_and_all_seen_says_all() -> None:
    shape = ReachShape.learn(bowed(6, 0.1), HUMAN)
    usual = EndPosture(REST + 0.1, 0.01 * np.eye(12), 0.0)
    assert shape.given(usual, REST, REST, 0.0, 0.5) is usual
    done = shape.given(usual, REST, REST + 0.2, 1.0, 0.5)
    np.testing.assert_allclose(done.mean, REST + 0.2, atol=2e-3)


def test_a_hand_that_goes_nowhere_has_no_shape() -> None:
    with pytest.raises(MotionError, match="goes somewhere"):
        ReachShape.learn([np.tile(REST, (30, 1))], HUMAN)
    with pytest.raises(MotionError, match="reach 0"):
        ReachShape.learn([np.zeros((30, 3))], HUMAN)


def test_the_end_is_where_the_hand_is_farthest() -> None:
    q = small_library(1, there_and_back=True).motions[0].q
    start, end = start_and_end(q, HUMAN)
    hand = HUMAN.forward(q)[HAND]
    k = int(np.argmax(np.linalg.norm(hand - HUMAN.forward(start)[HAND], axis=1)))
    np.testing.assert_array_equal(end, q[k])
    assert 10 < k < 30
