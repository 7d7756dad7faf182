"""Places are checked, stay what they are, and come from what most motions of a class show."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import shared_data
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, HumanModelError, HumanPredError, LibraryFormatError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary, placed, turn_and_shift
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.reaching.places import (
    LEAN_M,
    N_PLACES,
    Places,
    UnlistedPlaces,
    evenly_picked,
    places_from_text,
    places_in_world,
    reach_ends,
)
from humanpred_ros.robot.scene import load_scene

HUMAN = HumanModel.kinect12()
PLACES = Places((7, 3), np.array([[0.5, 0.1, 1.0], [0.4, -0.2, 0.9]]))
LIBRARY = small_library(3, 6, 40, there_and_back=True)


def test_places_cannot_be_changed_and_are_found_by_label() -> None:
    np.testing.assert_array_equal(PLACES.by_label["3"], [0.4, -0.2, 0.9])
    assert list(PLACES.by_label) == ["7", "3"]
    with pytest.raises(ValueError, match="read-only"):
        PLACES.places_m[0, 0] = 1.0


@given(st.floats(-3, 3), st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_moving_there_and_back_changes_nothing(yaw: float, shift: list[float]) -> None:
    T = turn_and_shift(yaw, shift)
    moved = PLACES.moved(T)
    np.testing.assert_allclose(moved.places_m, PLACES.places_m @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(moved.moved(np.linalg.inv(T)).places_m, PLACES.places_m, atol=1e-12)


@pytest.mark.parametrize(
    ("labels", "places", "complaint"),
    [
        ((), np.empty((0, 3)), "at least one"),
        ((1, 2, 1), np.zeros((3, 3)), "every label once, got 1"),
        ((1, 2), np.zeros((1, 3)), r"shape \(2, 3\)"),
        ((1,), np.zeros((1, 2)), "shape"),
        ((1,), [[0.0, np.nan, 0.0]], "finite"),
    ],
)
def test_what_cannot_be_places_is_refused(labels: tuple[int, ...], places: object, complaint: str) -> None:
    with pytest.raises(HumanPredError, match=complaint):
        Places(labels, places)  # type: ignore[arg-type]


@pytest.mark.parametrize("T", [np.diag([1.0, 1.0, -1.0, 1.0]), 2 * np.eye(4), np.eye(3), np.full((4, 4), np.nan)])
def test_only_rigid_transforms_move_places(T: np.ndarray) -> None:
    with pytest.raises(ArrayError):
        PLACES.moved(T)


def test_a_class_has_its_place_where_the_hands_of_its_motions_turn() -> None:
    places = Places.of_ends(reach_ends(LIBRARY, HUMAN))
    assert places.labels == ("0", "10", "20")
    for label in places.labels:
        turns = [HUMAN.forward(motion.q[20])["right_palm"] for motion in LIBRARY.of_class(label)]
        assert np.linalg.norm(np.median(turns, axis=0) - places.by_label[label]) < 0.02


def test_a_motion_left_out_has_no_say_in_its_place_and_others_stay() -> None:
    gone = "10/2"
    rest = LIBRARY.select(lambda motion: motion.name != gone)
    found = Places.of_ends(reach_ends(LIBRARY, HUMAN), without_motion=gone)
    np.testing.assert_allclose(found.places_m, Places.of_ends(reach_ends(rest, HUMAN)).places_m, atol=1e-12)
    whole = Places.of_ends(reach_ends(LIBRARY, HUMAN))
    np.testing.assert_array_equal(found.by_label["0"], whole.by_label["0"])
    assert (found.by_label["10"] != whole.by_label["10"]).any()


def test_a_motion_that_runs_off_does_not_move_its_place() -> None:
    motions = list(LIBRARY.motions)
    wild = motions[8]
    motions[8] = wild.with_postures(wild.q + np.linspace(0.0, 60.0, len(wild))[:, None] * np.eye(12)[0])
    spoiled = MotionLibrary("spoiled", tuple(motions))
    assert [end.name for end in reach_ends(spoiled, HUMAN) if not end.tracked] == [wild.name]
    np.testing.assert_allclose(
        Places.of_ends(reach_ends(spoiled, HUMAN)).places_m,
        Places.of_ends(reach_ends(LIBRARY, HUMAN), without_motion=wild.name).places_m,
        atol=1e-12,
    )


def test_a_class_without_a_motion_left_is_an_error_not_a_guess() -> None:
    single = LIBRARY.select(lambda motion: motion.label != "20" or motion.index == 0)
    with pytest.raises(LibraryFormatError, match="place 20"):
        Places.of_ends(reach_ends(single, HUMAN), without_motion="20/0")
    with pytest.raises(HumanModelError):
        Places.of_ends(reach_ends(LIBRARY, HumanModel.mocap23()))


@pytest.mark.parametrize("human", [HumanModel.kinect12(), HumanModel.mocap23()], ids=["kinect12", "mocap23"])
def test_places_out_of_reach_are_named_with_their_distance(human: HumanModel) -> None:
    q = REST if len(human.dof_names) == 12 else np.clip(np.zeros(23), human.lower, human.upper)
    points = human.forward(q)
    shoulder = points["right_shoulder"]
    arm = sum(
        np.linalg.norm(points[a] - points[b])
        for a, b in (("right_shoulder", "right_elbow"), ("right_elbow", "right_palm"))
    )
    limit = float(arm) + LEAN_M
    places = Places((1, 2, 3), shoulder + np.array([[limit + 0.01, 0, 0], [0, limit - 0.01, 0], [0, 0, -5.0]]))
    found = places.out_of_reach(human, q)
    assert list(found) == ["1", "3"]
    assert "place 3 is 5.00 m" in found["3"]
    assert f"gets {limit:.2f} m far" in found["1"]


@pytest.mark.parametrize("name", ["library_a", "library_b"])
def test_every_place_of_the_papers_libraries_is_in_reach_of_everybody(name: str) -> None:
    library = load_library(shared_data(f"iros2013/{name}"))
    places = Places.of_ends(reach_ends(library, HUMAN))
    assert len(places) == 8
    distances = np.linalg.norm(places.places_m[:, None] - places.places_m, axis=2) + np.eye(8)
    assert distances.min() > 0.1
    tracked = {end.name for end in reach_ends(library, HUMAN) if end.tracked}
    for motion in library:
        if motion.name in tracked:
            assert places.out_of_reach(HUMAN, motion.q[0]) == {}
    motion = placed(library.motions[40], turn_and_shift(0.0, (3.0, 0.0, 0.0)))
    assert len(places.out_of_reach(HUMAN, motion.q[0])) == 8


SCENE = load_scene("four_places")


def test_places_are_brought_into_the_trackers_frame() -> None:
    given_m = {"3": np.array([-0.22, -0.67, 0.8]), "12": np.array([0.0, 0.5, 1.0])}
    by_text = places_from_text(["3 -0.22 -0.67 0.80", "  12   0 .5 1e0 "], SCENE.T_world_human)
    for places in (by_text, places_in_world(given_m, SCENE.T_world_human)):
        assert places is not None
        assert places.labels == ("3", "12")
        in_world = places.moved(SCENE.T_world_human).places_m
        np.testing.assert_allclose(in_world, list(given_m.values()), atol=1e-12)


def test_no_places_are_none() -> None:
    assert places_in_world({}, SCENE.T_world_human) is None
    for entries in ([], [""], [" ", ""]):
        assert places_from_text(entries, SCENE.T_world_human) is None


@pytest.mark.parametrize("entry", ["3", "3 0.1 0.2", "a/b 0.1 0.2 0.3", "3 a b c", "3 0.1 nan 0.3", "3 1_0 0.1 0.3"])
def test_an_entry_that_says_something_else_is_refused_with_what_was_wanted(entry: str) -> None:
    with pytest.raises(
        UsageError, match=r"wanted 'label x y z'.* as in 'screws -0\.22 -0\.67 0\.80', got|label: wanted"
    ):
        places_from_text(["1 0 0 1", entry], SCENE.T_world_human)


def test_a_label_stands_for_one_place() -> None:
    with pytest.raises(UsageError, match="every label once, got 3"):
        places_from_text(["3 0 0 1", "3 0 0.5 1"], SCENE.T_world_human)


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
