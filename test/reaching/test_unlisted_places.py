"""Places nobody told lie where hands go as seen from the body, and a few of them stand for all."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import turn_and_shift
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.reaching.unlisted_places import N_PLACES, UnlistedPlaces, evenly_picked

HUMAN = HumanModel.kinect12()


@cache
def ends() -> EndPostures:
    return EndPostures.learn([motion.q for motion in small_library(4)], HUMAN)


def test_they_spread_around_where_reaches_end_and_farther() -> None:
    reached, untold = ends().seen[:, :3], UnlistedPlaces.around_ends(ends())
    places, near = untold.seen_m, untold.share == untold.share.max()
    assert len(places) == len(untold.share) == 2 * N_PLACES
    np.testing.assert_allclose(untold.share @ places, reached.mean(axis=0), atol=0.01)
    assert untold.share[near].sum() == pytest.approx(7 / 8)
    assert (places[near].std(axis=0) > 1.2 * reached.std(axis=0)).all()
    assert (places[near].std(axis=0) < 2.0 * reached.std(axis=0).max()).all()
    # Whatever was reached for has some of them near, so that what was not told is there.
    nearest = np.linalg.norm(reached[:, None] - places, axis=2).min(axis=1)
    assert nearest.max() < 0.1
    # And so has what nobody reached for: a shelf, the floor.
    for height in (-0.6, 0.6):
        there = reached.mean(axis=0) + np.array([0.0, 0.0, height])
        assert np.linalg.norm(places - there, axis=1).min() < 0.3


def test_reaches_to_a_single_place_leave_room_for_others() -> None:
    one = EndPostures.learn([small_library(1, 1).motions[0].q], HUMAN)
    untold = UnlistedPlaces.around_ends(one)
    assert np.isfinite(untold.seen_m).all()
    near = untold.seen_m[untold.share == untold.share.max()]
    np.testing.assert_allclose(near.std(axis=0), 0.05, rtol=0.05)


def test_who_has_seen_nobody_reach_expects_it_all_around_the_shoulder() -> None:
    for human in (HUMAN, HumanModel.mocap23()):
        subject = UnlistedPlaces.around_shoulder(human)
        q = np.clip(np.zeros(len(human.dof_names)), human.lower, human.upper)
        shoulder = human.forward(q)["right_shoulder"]
        np.testing.assert_allclose(np.median(subject.around(q), axis=0), shoulder, atol=0.02)
        np.testing.assert_allclose(subject.around(q).std(axis=0), 0.5, rtol=0.05)


@settings(max_examples=10)
@given(st.floats(-3, 3), st.floats(-2, 2), st.floats(-2, 2))
def test_they_go_where_the_person_goes(yaw: float, x: float, y: float) -> None:
    subject = UnlistedPlaces.around_ends(ends())
    T = turn_and_shift(yaw, (x, y, 0.0))
    there = REST.copy()
    there[:2] = T[:2, :2] @ REST[:2] + T[:2, 3]
    there[3] = REST[3] + yaw
    np.testing.assert_allclose(
        subject.around(there), subject.around(REST) @ T[:3, :3].T + T[:3, 3], atol=1e-6
    )  # fmt: skip


@settings(max_examples=20)
@given(st.lists(st.floats(-3000.0, 0.0), min_size=1, max_size=40), st.integers(1, 32))
def test_each_is_picked_as_often_as_it_is_probable(log_likelihood: list[float], n: int) -> None:
    places = np.arange(3.0 * len(log_likelihood)).reshape(-1, 3)
    log_p = np.array(log_likelihood)
    picked = evenly_picked(places, log_p, n)
    assert picked.shape == (n, 3)
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    for place, probable in zip(places, p.tolist(), strict=True):
        assert abs((picked == place).all(axis=1).sum() - n * probable) < 1.0 + 1e-6
    np.testing.assert_array_equal(picked, evenly_picked(places, log_p, n))


def test_what_is_no_place_is_refused() -> None:
    for places, share in (
        (np.zeros((4, 2)), np.full(4, 0.25)),
        (np.full((4, 3), np.nan), np.full(4, 0.25)),
        (np.zeros((4, 3)), np.full(4, 0.5)),
        (np.zeros((4, 3)), np.array([1.0, 0.5, -0.5, 0.0])),
        (np.zeros((4, 3)), np.full(3, 1.0 / 3.0)),
    ):
        with pytest.raises(ArrayError):
            UnlistedPlaces(HUMAN, places, share)
