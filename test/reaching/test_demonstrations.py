"""Cuts of a reach are where P2's are, and samples around a demonstration vary it smoothly."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import HumanModelError, MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.reach_recordings import Jump, ReachRecording, load_reach_recordings
from humanpred_ros.reaching.demonstrations import (
    SamplingSettings,
    cut_frames,
    demonstration,
    demonstrations,
    jerk_matrix,
    sample_around,
    smooth_noise,
)
from humanpred_ros.reaching.features import PADDING, ReachFeatures

FEATURES = ReachFeatures(MODEL)
DEMO = demonstration(recording(1), FEATURES)
HAND = MODEL.dof_names.index("rElbowZ")


def test_the_papers_recordings_are_cut_27_times() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    cuts = {entry.name: len(cut_frames(entry.active)) for entry in recordings}
    assert cuts == {"0446-0578": 6, "0525-0657": 6, "0444-0585": 7, "0489-0589": 2, "0780-0871": 2, "1537-1608": 0,
                    "2711-2823": 4}  # fmt: skip
    assert len(demonstrations(recordings, FEATURES, cut=True, keep_unfit=True)) == 34
    assert len(demonstrations(recordings, FEATURES, cut=True)) == 26  # without the one that jumps


def test_cuts_are_a_tenth_of_a_second_apart_at_any_rate() -> None:
    entry = recording(1, n_frames=132)
    assert cut_frames(entry.active) == [1, 11, 21, 31, 41, 51]
    slow = dataclasses.replace(entry.active, t_s=2.0 * entry.active.t_s)
    assert cut_frames(slow) == list(range(1, 132 - 40 + 1, 5))


def test_a_whole_reach_starts_from_rest() -> None:
    entry = recording(1)
    demo = demonstration(entry, FEATURES)
    assert demo.situation.history is None
    assert demo.situation.duration_s == pytest.approx(entry.active.duration_s)
    np.testing.assert_array_equal(demo.q[[0, -1]], entry.active.q[[0, -1]])
    np.testing.assert_allclose(demo.situation.partner_m, FEATURES.link_points(entry.passive.q[0]))


def test_a_cut_continues_what_came_before_it() -> None:
    entry = recording(1, n_frames=140)
    demo = demonstration(entry, FEATURES, 41)
    t_s, dt_s = entry.active.t_s, (entry.active.t_s[-1] - entry.active.t_s[41]) / 99
    assert demo.name == "made_up_1+41"
    assert demo.situation.history is not None
    # t0 - 6 dt to t0 - dt: one step further would repeat the first waypoint, one less would leave a hole.
    wanted = np.interp(t_s[41] - dt_s * np.arange(6, 0, -1), t_s, entry.active.q[:, 12])
    np.testing.assert_allclose(demo.situation.history[:, 12], wanted)
    joined = np.concatenate([demo.situation.history, demo.q])
    bend = np.abs(np.diff(joined, n=2, axis=0)).max(axis=1)
    assert bend[: 2 * PADDING].max() < 3.0 * np.median(bend)
    np.testing.assert_allclose(demo.situation.partner_m, FEATURES.link_points(entry.passive.q[41]))


def test_before_the_recording_the_person_stood_still() -> None:
    demo = demonstration(recording(1), FEATURES, 1)
    assert demo.situation.history is not None
    np.testing.assert_array_equal(demo.situation.history[:4], np.repeat(recording(1).active.q[:1], 4, axis=0))


def test_what_comes_after_a_jump_may_be_learned_from() -> None:
    jumps = (Jump("active", 15, "right_wrist", 7.0), Jump("passive", 90, "right_palm", 9.0))
    entry = dataclasses.replace(recording(1, n_frames=140), jumps=jumps)
    found = demonstrations([entry], FEATURES, cut=True)
    assert [demo.first_frame for demo in found] == [31, 41, 51]  # the history of the cut at 21 holds the jump


def test_reaches_shorter_than_the_stencil_are_left_out() -> None:
    assert demonstrations([recording(1, n_frames=6)], FEATURES) == ()
    assert demonstrations([recording(1, n_frames=6)], FEATURES, keep_unfit=True) == ()
    assert len(demonstrations([recording(1, n_frames=7)], FEATURES)) == 1


def test_recordings_with_jumps_are_learned_from_if_asked_for() -> None:
    entry = dataclasses.replace(recording(1, n_frames=140), jumps=(Jump("active", 15, "right_wrist", 7.0),))
    found = demonstrations([entry], FEATURES, cut=True, keep_unfit=True)
    assert [demo.first_frame for demo in found] == [0, 1, 11, 21, 31, 41, 51]


def test_recordings_of_another_human_are_refused() -> None:
    entry = recording(1)
    names = (entry.active.dof_names[1], entry.active.dof_names[0], *entry.active.dof_names[2:])
    mixed = [dataclasses.replace(motion, dof_names=names) for motion in (entry.active, entry.passive)]
    with pytest.raises(HumanModelError, match="another order"):
        demonstration(ReachRecording("mixed", *mixed), FEATURES)


@pytest.mark.parametrize("frame", [-1, 99])
def test_cuts_outside_are_refused(frame: int) -> None:
    with pytest.raises(MotionError, match="made_up_1: wanted a cut at frame 0 to 98"):
        demonstration(recording(1), FEATURES, frame)


def standard_deviation(n_waypoints: int) -> FloatArray:
    """Return the (N,) standard deviation of noise of unit scale at each waypoint."""
    D = jerk_matrix(n_waypoints)
    return np.sqrt(np.diagonal(np.linalg.inv(D.T @ D)))


def rng() -> np.random.Generator:
    return np.random.default_rng(4)


class RightHalf:
    """A wall through the demonstration."""

    def of(self, q: FloatArray) -> np.ndarray:
        return q[:, 50, HAND] > DEMO.q[50, HAND]

    def most_frequent(self, q: FloatArray) -> str:
        return "elbow into the wall"


class Everywhere(RightHalf):
    def of(self, q: FloatArray) -> np.ndarray:
        return np.ones(len(q), dtype=bool)


right_half = RightHalf()


def test_samples_scatter_about_the_demonstration_as_asked() -> None:
    config = SamplingSettings(n_samples=400)
    samples, collided = sample_around(DEMO, config, rng())
    assert collided == 0
    assert samples.shape == (400, 100, 23)
    off = samples - DEMO.q
    wanted = config.deviation * standard_deviation(100)
    np.testing.assert_allclose(off.std(axis=(0, 2)), wanted, rtol=0.06)
    assert wanted[50] == pytest.approx(0.112, abs=1e-3)  # rad and m, as published
    assert np.abs(off[:, [0, -1]]).max() < 1e-3


def test_a_demonstration_is_smoother_than_its_samples() -> None:
    own = FEATURES.values(DEMO.q, DEMO.situation)
    others = FEATURES.values(sample_around(DEMO, SamplingSettings(n_samples=50), rng())[0], DEMO.situation)
    assert (others[:, [1, 4, 5]] > own[[1, 4, 5]]).mean() > 0.85


def test_colliding_samples_are_replaced() -> None:
    for seed in range(8):
        samples, collided = sample_around(DEMO, SamplingSettings(n_samples=20), np.random.default_rng(seed), right_half)
        assert len(samples) == 20
        assert not right_half.of(samples).any()
        assert 4 < collided < 60  # about half of all


def test_if_some_are_lacking_in_the_end_fewer_are_returned() -> None:
    samples, collided = sample_around(DEMO, SamplingSettings(n_samples=60, attempts=1), rng(), right_half)
    assert 10 < len(samples) < 50
    assert collided + len(samples) == 60
    assert not right_half.of(samples).any()


def test_if_all_collide_the_demonstration_is_named() -> None:
    with pytest.raises(MotionError, match=r"made_up_1.*all 3 x 20 do, most with elbow into the wall"):
        sample_around(DEMO, SamplingSettings(n_samples=20, attempts=3), rng(), Everywhere())


@pytest.mark.parametrize("bad", [{"n_samples": 0}, {"attempts": 0}, {"deviation": 0.0}, {"deviation": np.nan}])
def test_impossible_sampling_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(bad))):
        SamplingSettings(**bad)  # type: ignore[arg-type]


def test_noise_has_the_covariance_of_the_jerk_rule() -> None:
    n = 20
    D = jerk_matrix(n)
    R = D.T @ D
    draws = smooth_noise(np.random.default_rng(0), 3000, n, 2)
    flat = draws.transpose(0, 2, 1).reshape(-1, n)
    expected = np.linalg.inv(R)
    empirical = flat.T @ flat / len(flat)
    spread = np.sqrt(np.diagonal(expected))
    assert np.abs((empirical - expected) / np.outer(spread, spread)).max() < 0.06  # 1 / sqrt(6000), times 4.6


def test_noise_of_a_hundred_waypoints_is_as_large_as_in_p2() -> None:
    # As published: 746 in the middle, 1e-4 / 1.5e-4 at the ends.
    deviation = standard_deviation(100)
    assert deviation[50] == pytest.approx(746.0, abs=1.0)
    assert 0.5 < deviation[0] < 1.0
    assert deviation[-1] == pytest.approx(deviation[0], rel=1e-6)


def test_the_same_seed_gives_the_same_noise() -> None:
    draws = [smooth_noise(np.random.default_rng(5), 4, 30, 3) for _ in range(2)]
    assert draws[0].shape == (4, 30, 3)
    np.testing.assert_array_equal(*draws)


def test_reaches_shorter_than_the_stencil_are_refused() -> None:
    with pytest.raises(MotionError, match="at least 7 waypoints, got 6"):
        smooth_noise(np.random.default_rng(0), 1, 6, 1)
