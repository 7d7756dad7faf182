"""Samples that run into table or partner are told apart from those that do not; a demonstration is always possible."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.solids import Box, Obstacle, cylinder, planar_pose
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.collisions import SLACK_M, ReachCollisions, clearances, packed
from humanpred_ros.reaching.cost_terms import MOVING_BODIES
from humanpred_ros.reaching.demonstrations import Demonstration, demonstration, smooth_noise
from humanpred_ros.reaching.features import ReachFeatures
from humanpred_ros.reaching.surroundings import BodyCapsules, Surroundings

N = 30
FEATURES = ReachFeatures(MODEL, n_waypoints=N)
LOW, HIGH = np.array([0.9, 0.3, 0.6]), np.array([2.6, 2.0, 1.9])


def demo(seed: int = 0) -> Demonstration:
    return demonstration(recording(seed), FEATURES)


def varied(about: Demonstration, count: int, seed: int = 0, deviation: float = 3e-3) -> FloatArray:
    rng = np.random.default_rng(seed)
    return about.q + deviation * smooth_noise(rng, count, N, 23)


def along(ends: FloatArray, count: int = 401) -> FloatArray:
    """Points of bones (..., 2, 3) as (..., count, 3)."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    return ends[..., None, 0, :] * (1.0 - share) + ends[..., None, 1, :] * share


def hand_path(q: FloatArray) -> FloatArray:
    return MODEL.forward(q)["right_palm"]


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_distances_are_those_of_points_along_the_bones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = planar_pose(*rng.normal(scale=0.2, size=3), rng.uniform(0.0, 6.0))
    shape = Box(*rng.uniform(0.02, 0.6, 3)) if rng.random() < 0.5 else cylinder(*rng.uniform(0.02, 0.4, 2))
    thing = Obstacle("thing", shape, T)
    mine, theirs = rng.normal(scale=0.3, size=(2, 2, 3))
    if rng.random() < 0.2:
        mine[1] = mine[0]  # a sphere
    if rng.random() < 0.2:
        theirs = mine + rng.normal(size=3)  # parallel
    found = distances(mine, 0.1, [thing], theirs, 0.05)
    points = along(mine)
    assert found[0] == pytest.approx(thing.distance_m(points).min() - 0.1, abs=2e-3)
    apart = np.linalg.norm(points[:, None] - along(theirs)[None], axis=-1).min()
    assert found[1] == pytest.approx(apart - 0.15, abs=2e-3)


def distances(
    mine: FloatArray, radius: float, obstacles: list[Obstacle], theirs: FloatArray, theirs_radius: float
) -> FloatArray:
    single = np.float32
    out = np.full((1, len(obstacles) + 1), single(1e3))
    capsules = (np.array([[0, 1]]), np.array([radius], single))
    partner = (theirs[None].astype(single), np.array([theirs_radius], single))
    clearances(mine[None].astype(single), capsules, packed(obstacles), partner, out)
    return out[0].astype(np.float64)


@pytest.mark.parametrize("partner", [True, False])
def test_samples_that_collide_are_those_whose_bodies_are_in_something(partner: bool) -> None:
    """Once more in plain words, without lattice, bounds or early ends."""
    about = demo()
    found = ReachCollisions(MODEL).beside(about.q, about.partner if partner else None)
    samples = varied(about, 16, deviation=6e-3)
    scene, moving, beside = Surroundings.of_p2(), BodyCapsules.of(MODEL, MOVING_BODIES), BodyCapsules.of(MODEL)
    assert about.partner is not None
    theirs = along(beside.placed(MODEL, about.partner), 15).reshape(-1, 3)
    thick = np.repeat(beside.radius_m, 15)

    def least(q: FloatArray) -> FloatArray:
        """Least distance of each moving body from each obstacle and from each of the partner's bodies."""
        values = []
        for posture in q:
            points = along(moving.placed(MODEL, posture), 15)
            rows = [obstacle.distance_m(points).min(axis=1) for obstacle in scene.obstacles]
            if partner:
                apart = np.linalg.norm(points[:, :, None] - theirs, axis=-1).min(axis=1) - thick
                rows += list(apart.reshape(len(points), -1, 15).min(axis=2).T)
            values.append(np.stack(rows, axis=1) - moving.radius_m[:, None])
        lowest: FloatArray = np.min(values, axis=0)
        return lowest

    allowed = np.minimum(least(about.q) - SLACK_M, 0.0)
    deeper = np.array([(least(q) - allowed).min() for q in samples])
    got = found.of(samples)
    certain = np.abs(deeper) > 3e-3  # points on bones lie up to 2 cm apart
    assert certain.mean() > 0.8
    np.testing.assert_array_equal(got[certain], (deeper < 0.0)[certain])
    assert 0.05 < got.mean() < 0.95


@settings(max_examples=15)
@given(st.integers(0, 10**6))
def test_what_was_done_is_never_impossible(seed: int) -> None:
    about = demo(seed)
    rng = np.random.default_rng(seed)
    place = hand_path(about.q)[rng.integers(N)] + rng.normal(scale=0.05, size=3)
    inside = Surroundings((Obstacle("crate", Box(*rng.uniform(0.02, 0.4, 3)), planar_pose(*place)),), LOW, HIGH)
    for scene in (None, inside):
        assert not ReachCollisions(MODEL, scene).beside(about.q, about.partner).of(about.q[None]).any()


def crate(about: Demonstration, size_m: float = 0.1) -> Surroundings:
    """A box around where the hand is in the middle of the reach."""
    place = hand_path(about.q)[N // 2]
    return Surroundings((Obstacle("crate", Box(size_m, size_m, size_m), planar_pose(*place)),), LOW, HIGH)


def test_where_a_demonstration_is_in_something_is_told() -> None:
    about = demo()
    found = ReachCollisions(MODEL, crate(about)).beside(about.q, None)
    deepest = found.touches[0]
    assert (deepest.body, deepest.obstacle) == ("right_hand", "crate")
    assert deepest.depth_m > 0.04
    assert str(deepest).startswith("right hand ")
    assert str(deepest).endswith(" cm in crate")
    assert [touch.depth_m for touch in found.touches] == sorted((t.depth_m for t in found.touches), reverse=True)
    assert ReachCollisions(MODEL, Surroundings.empty()).beside(about.q, None).touches == ()


def test_a_sample_may_go_as_deep_as_the_demonstration_and_no_deeper() -> None:
    about = demo()
    height = 2.0 * float(hand_path(about.q)[:, 2].min())  # the palm comes down to its top
    scene = Surroundings((Obstacle("floor", Box(2.0, 2.0, height), planar_pose(1.8, 1.2)),), LOW, HIGH)
    found = ReachCollisions(MODEL, scene).beside(about.q, None)
    up = MODEL.dof_names.index("PelvisTransZ")
    assert found.touches[0].body == "right_hand"
    for shift_m, collides in ((0.02, False), (0.0, False), (-0.004, False), (-0.006, True), (-0.1, True)):
        moved = about.q.copy()
        moved[:, up] += shift_m
        assert found.of(moved[None]).item() is collides


def test_boards_thinner_than_the_planners_lattice_are_seen() -> None:
    about = demo()
    place = hand_path(about.q)[N // 2]
    board = Obstacle("board", Box(0.3, 0.3, 0.01), planar_pose(place[0], place[1], place[2] - 0.2))
    found = ReachCollisions(MODEL, Surroundings((board,), LOW, HIGH)).beside(about.q, None)
    lowered = about.q.copy()
    lowered[:, MODEL.dof_names.index("PelvisTransZ")] -= 0.2
    assert found.of(lowered[None]).all()
    assert "board" in found.most_frequent(lowered[None])


def test_partner_is_where_the_demonstration_begins() -> None:
    about = demo()
    assert about.partner is not None
    np.testing.assert_array_equal(about.partner, recording(0).passive.q[0])
    toward = about.q.copy()
    toward[:, MODEL.dof_names.index("PelvisTransX")] -= 0.5  # into the partner, who is 0.7 m away
    shared = ReachCollisions(MODEL, Surroundings.empty())
    together, alone = (shared.beside(about.q, partner) for partner in (about.partner, None))
    assert together.of(toward[None]).all()
    assert "partner" in together.most_frequent(toward[None])
    assert not alone.of(toward[None]).any()
    assert alone.most_frequent(toward[None]) == ""


def test_obstacles_outside_the_region_of_the_lattice_count() -> None:
    about = demo()
    far = Surroundings(crate(about).obstacles, np.array([0.0, 0.0, 0.0]), np.array([0.5, 0.5, 0.5]))
    found = ReachCollisions(MODEL, far).beside(about.q, None)
    near = ReachCollisions(MODEL, crate(about)).beside(about.q, None)
    samples = varied(about, 40)
    np.testing.assert_array_equal(found.of(samples), near.of(samples))
    assert near.of(samples).any()


def test_p2s_recordings_touch_by_centimetres_only() -> None:
    features = ReachFeatures(MODEL)
    collisions = ReachCollisions(MODEL)
    touching = {}
    for entry in load_reach_recordings(shared_data("icra2015/demos")):
        about = demonstration(entry, features)
        found = collisions.beside(about.q, about.partner)
        assert not found.of(about.q[None]).any()
        touching[entry.name] = max((touch.depth_m for touch in found.touches), default=0.0)
    assert {name for name, depth in touching.items() if depth > 0.005} == {"0446-0578", "1537-1608"}
    assert max(touching.values()) < 0.03
