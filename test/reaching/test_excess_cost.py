"""Excess costs are what they are called: none for the best reach, more for a worse one, the same in any room."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reaching_people import MODEL as MOCAP
from reaching_people import reach
from small_library import DOF_NAMES, REST, small_library

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.reaching.excess_cost import (
    ARRIVED,
    FASTEST_M_S,
    HAND,
    MOST_M,
    N_ALONG,
    N_COLUMNS,
    N_PARTS,
    N_STEADY,
    OUTLIER,
    PART,
    PARTS,
    REACHED_M,
    RECOVERED,
    RESTARTED,
    START,
    HandFollower,
    LostHand,
    best_reach,
    chosen_postures,
    distances_from,
    excess_costs,
    reach_so_far,
)

HUMAN = HumanModel.kinect12()


def seen(path: FloatArray, period_s: float = 1 / 60) -> FloatArray:
    """Return the rows (T, N_COLUMNS) of a body that moves as a whole along a path (T, 3)."""
    return seen_at(path, period_s * np.arange(len(path)))


def seen_at(path: FloatArray, t_s: FloatArray) -> FloatArray:
    hand, rows = HandFollower(), []
    for place, t in zip(path, t_s.tolist(), strict=True):
        hand.observe(np.tile(place, (4, 1)), t)
        rows.append(hand.row.copy())
    return np.array(rows)


def straight(to: FloatArray, n: int = 60) -> FloatArray:
    """Return a minimum-jerk path (n + 10, 3) from the origin, with a rest before it."""
    s = np.concatenate([np.zeros(10), np.linspace(0.0, 1.0, n)])[:, None]
    return (s**3 * (10 - 15 * s + 6 * s * s)) * to


AHEAD, BESIDE = np.array([0.5, 0.0, 0.0]), np.array([0.3, 0.4, 0.0])


def part(costs: FloatArray, name: str) -> FloatArray:
    return costs[..., PARTS.index(name)]


def test_the_best_reach_costs_nothing_and_another_goal_does() -> None:
    costs = excess_costs(seen(straight(AHEAD)), np.stack([AHEAD, BESIDE]))
    assert costs.shape == (70, 2, N_PARTS)
    assert np.delete(costs[:, 0], PARTS.index("stopping"), axis=-1).max() < 1e-9
    assert part(costs, "stopping")[:, 0].max() < 0.02  # it slows down as it arrives, in the last centimetres
    for name in ("detour", "aside", "heading_5cm", "heading_15cm"):
        assert part(costs, name)[45, 1] > 0.1, name
    assert part(costs, "stopping")[-1, 1] > 0.25
    assert not costs[:5].any()


def test_past_the_goal_is_beyond_it() -> None:
    costs = excess_costs(seen(straight(AHEAD)), 0.6 * AHEAD[None])
    np.testing.assert_allclose(part(costs, "beyond")[-1], 0.2, atol=1e-3)
    assert part(costs, "beyond")[30, 0] == 0.0


def test_a_hand_on_its_way_back_speaks_for_where_it_turned() -> None:
    out = straight(AHEAD)
    rows = seen(np.vstack([out, out[::-1]]))
    costs = excess_costs(rows, np.stack([AHEAD, 0.2 * AHEAD, np.zeros(3)]))
    at_home = costs[-1]
    np.testing.assert_allclose(at_home[0], 0.0, atol=2e-3)
    assert at_home[1:, PARTS.index("stopping")].min() > 0.25
    np.testing.assert_allclose(rows[-1, HAND : HAND + 3], AHEAD, atol=1e-3)
    assert rows[-1, ARRIVED] == 1.0


@settings(max_examples=50)
@given(st.integers(0, 10_000))
def test_costs_are_never_negative_and_bounded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(0.0, rng.choice([0.001, 0.05, 5.0]), (30, 3)), axis=0)
    costs = excess_costs(seen(path), rng.normal(0.0, 0.5, (5, 3)))
    assert np.isfinite(costs).all()
    assert (costs >= 0).all()
    assert costs.max() <= 2.0
    assert part(costs, "detour").max() <= MOST_M


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_any_rigid_motion_of_the_room_changes_nothing(seed: int) -> None:
    """Medians are taken axis by axis: of a steady path that makes no difference, nor of any if axes change places."""
    rng = np.random.default_rng(seed)
    shift, places = rng.normal(0.0, 2.0, 3), rng.normal(0.0, 0.5, (4, 3))
    any_turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    swap = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    noisy = straight(AHEAD) + np.cumsum(rng.normal(0.0, 0.002, (70, 3)), axis=0)
    for path, R in ((straight(AHEAD), any_turn), (noisy, swap)):
        moved = excess_costs(seen(path @ R.T + shift), places @ R.T + shift)
        np.testing.assert_allclose(moved, excess_costs(seen(path), places), atol=1e-6)


@pytest.mark.parametrize("speed", [0.5, 0.7, 1.4, 2.0])
def test_the_same_path_at_another_speed_costs_nearly_the_same(speed: float) -> None:
    places = np.stack([AHEAD, BESIDE])
    usual, other = (excess_costs(seen(straight(AHEAD, n)), places) for n in (60, round(60 / speed)))
    at = np.linspace(0.2, 0.98, 25)
    a, b = (costs[10 + (at * (len(costs) - 10)).astype(int)] for costs in (usual, other))
    assert np.abs(a - b).mean() < 0.02


def test_half_the_frames_and_jittered_stamps_make_little_difference() -> None:
    rng = np.random.default_rng(0)
    path = straight(AHEAD)
    t_s = np.arange(70) / 60
    jittered = t_s + rng.uniform(-0.006, 0.006, 70)
    places = np.stack([AHEAD, BESIDE])
    whole = excess_costs(seen_at(path, t_s), places)
    at_jittered = np.stack([np.interp(jittered, t_s, column) for column in path.T], axis=1)
    assert np.abs(excess_costs(seen_at(at_jittered, jittered), places) - whole).mean() < 0.01
    assert np.abs(excess_costs(seen_at(path[::2], t_s[::2]), places) - whole[::2]).mean() < 0.012


def test_one_wild_frame_is_forgiven() -> None:
    path = straight(AHEAD)
    wild = path.copy()
    wild[30] += [0.0, 3.0, 0.0]
    places = np.stack([AHEAD, BESIDE])
    difference = excess_costs(seen(wild), places) - excess_costs(seen(path), places)
    np.testing.assert_array_equal(seen(wild)[30:35], np.tile(seen(path)[29], (5, 1)))  # nothing is added to it
    assert np.abs(difference[36:]).max() < 0.02


def test_a_motion_gives_the_same_rows_as_its_postures_one_by_one() -> None:
    motion = small_library(1, 1, 30, there_and_back=True).motions[0]
    rows = reach_so_far(motion, HUMAN)
    assert rows.shape == (30, N_COLUMNS)
    palm = HUMAN.forward(motion.q)["right_palm"]
    np.testing.assert_allclose(rows[-1, START : START + 3], np.median(palm[:5], axis=0), atol=1e-12)
    assert rows[-1, REACHED_M] == pytest.approx(
        np.linalg.norm(palm - np.median(palm[:5], axis=0), axis=1).max(), abs=0.01
    )
    with pytest.raises(HumanModelError):
        reach_so_far(motion, MOCAP)


@given(st.integers(1, 300), st.integers(2, 40))
def test_chosen_postures_are_of_the_motion_and_end_with_its_last(n_frames: int, n: int) -> None:
    chosen = chosen_postures(n_frames, n)
    assert len(chosen) == n
    assert chosen[-1] == n_frames - 1
    assert (np.diff(chosen) >= 0).all()
    assert chosen[0] >= 0


def test_a_best_reach_leads_from_the_start_to_the_place() -> None:
    library = small_library(3, 4, 40)
    ends = EndPostures.learn([motion.q for motion in library], HUMAN)
    place = HUMAN.forward(library.motions[0].q[-1])["right_palm"]
    path = best_reach(HUMAN, ends, REST, place)
    assert path.shape == (N_ALONG, 12)
    start = HUMAN.forward(REST)
    links = ("right_palm", "right_elbow", "right_shoulder", "neck")
    np.testing.assert_allclose(path[0], np.concatenate([start[link] for link in links]), atol=1e-12)
    assert np.linalg.norm(path[-1, :3] - place) < 0.06


def test_distances_from_a_best_reach_sum_over_the_points() -> None:
    line = np.linspace(0.0, 1.0, N_ALONG)[:, None] * np.tile([1.0, 0.0, 0.0], 4)
    on_it = 0.43 * np.tile([1.0, 0.0, 0.0], 4)
    off = on_it + np.concatenate([[0, 0.1, 0], [0, 0, 0.2], np.zeros(6)])
    np.testing.assert_allclose(distances_from(line, np.stack([on_it, off])), [0.0, 0.3], atol=1e-12)
    standing = np.zeros((N_ALONG, 12))
    np.testing.assert_allclose(distances_from(standing, off[None] - on_it), [0.3], atol=1e-12)


def test_a_body_off_its_best_reach_costs_though_the_hand_is_on_it() -> None:
    library = small_library(3, 4, 40)
    ends = EndPostures.learn([motion.q for motion in library], HUMAN)
    motion = library.motions[0]
    place = HUMAN.forward(motion.q[-1])["right_palm"]
    rows = reach_so_far(motion, HUMAN)
    best = best_reach(HUMAN, ends, np.median(motion.q[:5], axis=0), place)
    costs = excess_costs(rows, place[None], [best])
    np.testing.assert_array_equal(costs[..., :-1], excess_costs(rows, place[None])[..., :-1])
    moved = rows.copy()
    moved[:, 3:START] += 0.1  # elbow, shoulder and neck
    off = excess_costs(moved, place[None], [best])
    assert (part(off, "body") > part(costs, "body") + 0.1)[20:].all()


def test_people_seen_by_motion_capture_are_judged_alike() -> None:
    t_s, q, _ = reach(3)
    rows = reach_so_far(Motion(t_s, q, MOCAP.dof_names, frame_id="mocap"), MOCAP)
    palm = MOCAP.forward(q)["right_palm"]
    costs = excess_costs(rows, np.stack([palm[-1], palm[-1] + [0.3, 0.3, 0.0]]))
    assert (costs[-1].sum(axis=1) @ [1, -1]) < -0.1
    with pytest.raises(HumanModelError):
        reach_so_far(Motion(t_s, q[:, :12], DOF_NAMES), MOCAP)


def minimum_jerk_hand(way_m: float = 0.6, duration_s: float = 1.0, rate_hz: float = 60.0) -> FloatArray:
    """Return the hand (T, 3) on a minimum-jerk way that begins after ten postures at rest."""
    s = np.concatenate([np.zeros(10), np.linspace(0.0, 1.0, round(duration_s * rate_hz) + 1)])[:, None]
    return (s**3 * (10 - 15 * s + 6 * s * s)) * np.array([way_m, 0.0, 0.0])


def conclusions(hand: FloatArray, rate_hz: float = 60.0, begun_at: int = 15) -> list[int]:
    belief = LostHand()
    return [belief.judge(place, k / rate_hz, k >= begun_at) for k, place in enumerate(hand)]


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 60.0, 120.0])
def test_the_fastest_reach_that_people_can_do_is_accepted_in_the_noise_of_a_tracker(rate_hz: float) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.015, (10 + round(0.3 * rate_hz) + 1, 3))
    assert set(conclusions(minimum_jerk_hand(0.6, 0.3, rate_hz) + noise, rate_hz)) == {PART}


@pytest.mark.parametrize("n_lost", [1, 5, 20])
def test_a_lost_arm_is_left_out_and_found_again(n_lost: int) -> None:
    for shift in (np.array([0.0, 1.5, 0.9]), np.random.default_rng(1).normal(0.0, 0.5, (n_lost, 3))):
        hand = minimum_jerk_hand()
        hand[30 : 30 + n_lost] += shift
        said = conclusions(hand)
        back = 30 + n_lost + N_STEADY
        assert set(said[:30]) == {PART}
        assert set(said[30 : back - 1]) == {OUTLIER}
        assert said[back - 1] == RECOVERED
        assert set(said[back:]) == {PART}


def test_a_hand_that_stays_where_it_jumped_is_accepted_in_the_end() -> None:
    hand = np.vstack([minimum_jerk_hand(), np.tile(minimum_jerk_hand()[-1], (90, 1))])
    hand[40:] += [0.0, 5.0, 0.0]
    said = conclusions(hand)
    found = said.index(RECOVERED)
    assert 60 * 4.5 / FASTEST_M_S < found - 40 < 60 * 5.5 / FASTEST_M_S
    assert set(said[found + 1 :]) == {PART}


@pytest.mark.parametrize("n_wild", [1, 4, 9])
def test_a_reach_begins_where_the_hand_is_steady_first(n_wild: int) -> None:
    hand = minimum_jerk_hand()
    hand[:n_wild] += [0.0, 4.0, 0.0]
    said = conclusions(hand)
    assert said.index(RESTARTED) == n_wild + N_STEADY - 1
    assert set(said[n_wild + N_STEADY :]) == {PART}


def test_a_small_jump_to_and_fro_is_no_reason_to_stay_lost() -> None:
    hand = minimum_jerk_hand()
    hand[30] += [0.0, 0.2, 0.0]
    said = conclusions(hand)
    assert said.count(OUTLIER) <= N_STEADY
    assert RECOVERED in said


def test_frames_that_never_came_are_no_jump() -> None:
    hand, belief = minimum_jerk_hand(), LostHand()
    assert belief.judge(hand[0], 0.0, False) == PART
    assert belief.judge(hand[-1], 1.0, True) == PART
    assert belief.judge(hand[-1] + [2.0 * FASTEST_M_S, 0.0, 0.0], 2.0, True) == OUTLIER
