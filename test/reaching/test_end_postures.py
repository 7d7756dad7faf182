"""Where a reach to a place ends, for places nobody was seen to reach for."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import shared_data
from small_library import REST, small_library

from humanpred_ros.errors import HumanModelError, MotionError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.end_postures import (
    HAND,
    EndPostures,
    continuous,
    start_and_end,
)
from humanpred_ros.reaching.places import reach_ends

HUMAN = HumanModel.kinect12()
CENTRES = ("pelvis", "torso", "right_shoulder", "right_elbow", "right_palm")


@cache
def learned() -> EndPostures:
    return EndPostures.learn([motion.q for motion in small_library(4)], HUMAN)


def centres(q: FloatArray, human: HumanModel = HUMAN) -> FloatArray:
    places = human.forward(q)
    return np.stack([places[name] for name in CENTRES])


def left_out_errors(reaches: dict[object, list[FloatArray]], human: HumanModel) -> FloatArray:
    """Return (N, 5) errors of joint centres at the end, every group left out in turn, its typical place given."""
    errors = []
    for left_out, tested in reaches.items():
        ends = EndPostures.learn([q for key, group in reaches.items() if key != left_out for q in group], human)
        known = [start_and_end(continuous(q, human), human) for q in tested]
        place = np.median([human.forward(end)[HAND] for _, end in known], axis=0)
        for start, end in known:
            expected = ends.mean(start, place)
            errors.append(np.linalg.norm(centres(expected, human) - centres(end, human), axis=1))
    return np.array(errors)


@pytest.mark.parametrize("name", ["library_a", "library_b"])
def test_bodies_end_within_centimetres_where_no_class_to_that_place_was_learned(name: str) -> None:
    # Every other motion, so that the test is a fast one.
    library = load_library(shared_data(f"iros2013/{name}")).select(lambda motion: motion.index % 2 == 0)
    wrong = {end.name for end in reach_ends(library, HUMAN) if not end.tracked}
    reaches: dict[object, list[FloatArray]] = {
        label: [motion.q for motion in library.of_class(label) if motion.name not in wrong] for label in library.labels
    }
    assert np.median(left_out_errors(reaches, HUMAN), axis=0).max() < 0.06


def test_so_do_those_of_the_23_dof_human_each_recording_left_out() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    reaches: dict[object, list[FloatArray]] = {r.name: [r.active.q] for r in recordings if not r.unfit}
    assert np.median(left_out_errors(reaches, HumanModel.mocap23()), axis=0).max() < 0.06


@settings(max_examples=20)
@given(st.lists(st.floats(-0.15, 0.15), min_size=3, max_size=3))
def test_the_hand_ends_at_places_near_those_seen(offset: list[float]) -> None:
    seen = [start_and_end(motion.q, HUMAN)[1] for motion in small_library(4)]
    place = np.mean([HUMAN.forward(q)[HAND] for q in seen], axis=0) + offset
    end = learned().at(REST, place)
    np.testing.assert_allclose(end.miss_m, np.linalg.norm(HUMAN.forward(end.mean)[HAND] - place), atol=1e-9)
    assert end.miss_m < 0.06
    assert (end.mean >= HUMAN.lower).all()
    assert (end.mean <= HUMAN.upper).all()


@settings(max_examples=15)
@given(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_where_the_room_is_and_how_it_is_turned_does_not_matter(yaw: float, x: float, y: float) -> None:
    place = HUMAN.forward(start_and_end(small_library(4).motions[0].q, HUMAN)[1])[HAND]
    here = learned().at(REST, place)
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    start = REST.copy()
    start[:3] = T[:3, :3] @ REST[:3] + T[:3, 3]
    start[3] += yaw
    there = learned().at(start, T[:3, :3] @ place + T[:3, 3])
    moved = centres(here.mean) @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(centres(there.mean), moved, atol=1e-6)


def test_postures_drawn_from_it_have_the_hand_at_the_place() -> None:
    place = HUMAN.forward(start_and_end(small_library(4).motions[0].q, HUMAN)[1])[HAND]
    end = learned().at(REST, place)
    drawn = np.random.default_rng(0).multivariate_normal(end.mean, end.covariance, 2000)
    off = np.linalg.norm(HUMAN.forward(drawn)[HAND] - place, axis=1)
    assert np.median(off) < 3.0 * 0.03


@pytest.mark.parametrize("dof", [4, 5, 6])
def test_an_angle_counted_a_turn_further_ends_at_the_same_place(dof: int) -> None:
    place = HUMAN.forward(start_and_end(small_library(4).motions[0].q, HUMAN)[1])[HAND]
    turned = REST + 2.0 * np.pi * (np.arange(12) == dof)
    np.testing.assert_allclose(centres(learned().mean(turned, place)), centres(learned().mean(REST, place)), atol=1e-6)


def test_people_are_less_predictable_where_nobody_reached() -> None:
    seen = HUMAN.forward(start_and_end(small_library(4).motions[0].q, HUMAN)[1])[HAND]
    near, far = (learned().at(REST, seen + offset).covariance[:7, :7].trace() for offset in (0.0, [0.3, -0.6, 0.3]))
    assert far > 1.2 * near


def test_a_place_out_of_reach_is_missed_and_says_so() -> None:
    assert learned().at(REST, [6.0, 0.0, 1.0]).miss_m > 1.0


def test_whole_turns_of_an_angle_change_nothing_but_themselves() -> None:
    place = HUMAN.forward(start_and_end(small_library(4).motions[0].q, HUMAN)[1])[HAND]
    turned = [motion.q + 2.0 * np.pi * (np.arange(12) == 9) for motion in small_library(4)]
    both = EndPostures.learn([*turned[::2], *[motion.q for motion in small_library(4)][1::2]], HUMAN)
    np.testing.assert_allclose(both.mean(REST, place), learned().mean(REST, place), atol=1e-6)


def test_one_reach_is_enough_to_say_something() -> None:
    motion = small_library(1).motions[0]
    start, end = start_and_end(motion.q, HUMAN)
    place = HUMAN.forward(end)[HAND]
    found = EndPostures.learn([motion.q], HUMAN).at(start, place)
    np.testing.assert_allclose(centres(found.mean), centres(end), atol=0.01)
    elsewhere = EndPostures.learn([motion.q], HUMAN).at(start, place - [0.05, -0.15, -0.1])
    assert elsewhere.miss_m < 0.1


def test_what_cannot_be_learned_from_is_refused_in_words() -> None:
    with pytest.raises(MotionError, match="at least one reach"):
        EndPostures.learn([], HUMAN)
    with pytest.raises(MotionError, match="reach 0"):
        EndPostures.learn([np.zeros((5, 11))], HUMAN)
    with pytest.raises(MotionError, match="finite"):
        EndPostures.learn([np.full((5, 12), np.nan)], HUMAN)
    with pytest.raises(MotionError, match="place"):
        learned().at(REST, [np.nan, 0.0, 0.0])
    arm = HumanModel(
        '<robot name="arm"><link name="a"/><link name="right_palm"/><joint name="j" type="revolute"><parent link="a"/>'
        '<child link="right_palm"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="0" velocity="1"/></joint>'
        "</robot>"
    )
    with pytest.raises(HumanModelError, match="neck"):
        EndPostures(arm, np.zeros((1, 6)), np.zeros((1, 1)))
