"""A stream is what one person could do and one sensor could deliver, and says truly when the hand moves."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_library import DOF_NAMES, REST, small_library

from humanpred_ros.errors import LibraryFormatError, MotionError, UsageError
from humanpred_ros.evaluation.stream_composed import (
    StandingNoise,
    Stream,
    StreamBuilder,
    median_slope,
    motion_span,
    palm_speed,
    returns_home,
    standing_noise,
    standing_stream,
)
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary

TWIST = DOF_NAMES.index("rShoulderY")


@cache
def human() -> HumanModel:
    return HumanModel.kinect12()


@cache
def library(there_and_back: bool = True) -> MotionLibrary:
    """Reaches that begin with half a second of rest."""
    rng = np.random.default_rng(4)
    motions = []
    for motion in small_library(3, 3, 60, there_and_back=there_and_back):
        rest = np.repeat(motion.q[:1], 30, axis=0) + rng.normal(0.0, 0.003, (30, 12))
        t_s = np.arange(90) / 40.0
        motions.append(Motion(t_s, np.vstack([rest, motion.q]), DOF_NAMES, motion.label, motion.index))
    return MotionLibrary("rested", tuple(motions))


@cache
def noise(there_and_back: bool = True) -> StandingNoise:
    return standing_noise(library(there_and_back).motions, human())


def stream(there_and_back: bool = True, seed: int = 0) -> Stream:
    motions = [motion for motion in library(there_and_back) if motion.index == 1]
    rng = np.random.default_rng(seed)
    return StreamBuilder(human(), noise(there_and_back), rng, there_and_back).build(motions)


def reach(t: np.ndarray, start_s: float, duration_s: float) -> np.ndarray:
    u = np.clip((t - start_s) / duration_s, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2)


@settings(max_examples=30)
@given(
    start_s=st.floats(0.5, 1.5),
    duration_s=st.floats(0.4, 1.5),
    rate_hz=st.sampled_from([30.0, 60.0, 100.0]),
    dwell_s=st.floats(0.1, 1.0),
    seed=st.integers(0, 100),
)
def test_onset_and_end_are_where_the_speed_is_a_tenth_of_its_peak(
    start_s: float, duration_s: float, rate_hz: float, dwell_s: float, seed: int
) -> None:
    t = np.arange(0.0, start_s + 2 * duration_s + dwell_s + 1.0, 1 / rate_hz)
    share = reach(t, start_s, duration_s) - reach(t, start_s + duration_s + dwell_s, duration_s)
    palm = np.array([1.0, 2.0, 0.5]) + share[:, None] * np.array([0.5, 0.3, 0.1])
    palm += np.random.default_rng(seed).normal(0.0, 0.001, palm.shape)
    span = motion_span(t, palm)
    # Of least jerk: 30 u^2 (1-u)^2 is a tenth of its greatest, 1.875, at u = 0.086; smoothing takes some off.
    assert abs(span.onset_s - (start_s + 0.086 * duration_s)) < 0.07
    assert abs(span.end_s - (start_s + (2 - 0.086) * duration_s + dwell_s)) < 0.07
    assert span.peak_mps == pytest.approx(1.875 * np.linalg.norm([0.5, 0.3, 0.1]) / duration_s, rel=0.15)


def test_mistracked_frames_do_not_move_the_truth() -> None:
    t = np.arange(0.0, 4.0, 1 / 60)
    palm = reach(t, 1.5, 1.0)[:, None] * np.array([0.6, 0.0, 0.0])
    bad = palm.copy()
    bad[[20, 21, 60, 100]] += 0.4
    clean, spoiled = motion_span(t, palm), motion_span(t, bad)
    assert abs(clean.onset_s - spoiled.onset_s) < 0.02
    assert abs(clean.end_s - spoiled.end_s) < 0.02


def test_the_truth_does_not_take_what_is_no_motion() -> None:
    for t, palm in (
        (np.zeros(1), np.zeros((1, 3))),
        (np.zeros(3), np.zeros((3, 3))),
        (np.arange(3.0), np.zeros((2, 3))),
        (np.arange(3.0), np.full((3, 3), np.nan)),
    ):
        with pytest.raises(MotionError):
            motion_span(t, palm)
    assert palm_speed(np.arange(0.0, 1.0, 0.1), np.zeros((10, 3))).max() == 0.0


def test_recordings_are_in_the_stream_as_they_are_at_their_own_pace() -> None:
    for there_and_back in (True, False):
        found = stream(there_and_back)
        recorded = [placed for placed in found.placed if not placed.made]
        assert [placed.name for placed in recorded] == ["0/1", "10/1", "20/1"]
        assert len(found.placed) == len(recorded) * (1 if there_and_back else 2)
        for placed in recorded:
            motion = library(there_and_back).find(placed.name)
            first = int(np.searchsorted(found.t_s, placed.start_s - 1e-9))
            np.testing.assert_array_equal(found.q[first : first + len(motion)], motion.q)
            np.testing.assert_allclose(found.t_s[first : first + len(motion)] - placed.start_s, motion.t_s, atol=1e-9)
            assert placed.stop_s == pytest.approx(placed.start_s + motion.duration_s)


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), there_and_back=st.booleans())
def test_no_seam_asks_for_what_a_person_could_not_do(seed: int, there_and_back: bool) -> None:
    found = stream(there_and_back, seed)
    assert (np.diff(found.t_s) > 0).all()
    assert np.diff(found.t_s).max() < 0.06
    palm = human().forward(found.q)["right_palm"]
    fastest = max(
        np.linalg.norm(np.diff(human().forward(m.q)["right_palm"], axis=0), axis=1).max() / m.period_s
        for m in library(there_and_back)
    )
    assert (np.linalg.norm(np.diff(palm, axis=0), axis=1) / np.diff(found.t_s)).max() < 1.5 * fastest


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), there_and_back=st.booleans())
def test_what_lies_between_true_onsets_and_ends_is_all_that_moves(seed: int, there_and_back: bool) -> None:
    found = stream(there_and_back, seed)
    palm = human().forward(found.q)["right_palm"] - human().forward(found.q)["pelvis"]
    speed = palm_speed(found.t_s, palm)
    moving = np.zeros(len(speed), dtype=bool)
    before = 0.0
    for placed in found.placed:
        assert before + 1.0 <= placed.onset_s < placed.end_s
        before = placed.end_s
        moving |= (found.t_s > placed.onset_s - 0.15) & (found.t_s < placed.end_s + 0.15)
        inside = speed[(found.t_s > placed.onset_s) & (found.t_s < placed.end_s)]
        assert inside.max() > 0.2
    assert speed[~moving].max() < 0.2


def test_pauses_are_as_long_as_asked() -> None:
    motions = [motion for motion in library() if motion.index == 1]
    rng = np.random.default_rng(0)
    found = StreamBuilder(human(), noise(), rng, True, pause_s=(2.0, 2.0), lead_s=1.0).build(motions)
    assert found.placed[0].start_s == pytest.approx(3.0, abs=0.1)
    for one, following in zip(found.placed, found.placed[1:], strict=False):
        assert 2.0 < following.start_s - one.stop_s < 2.0 + 1.5 + 0.1  # pause and closing stroke
    assert found.t_s[-1] - found.placed[-1].stop_s > 3.0


def test_the_same_seed_gives_the_same_stream_and_another_another() -> None:
    np.testing.assert_array_equal(stream(seed=5).q, stream(seed=5).q)
    assert len(stream(seed=5).q) != len(stream(seed=6).q)


def test_angles_that_wrap_do_so_in_the_stream_too() -> None:
    """A twist of half a turn is the same arm; the way to it must be short, and the sensor's range kept."""
    motions = []
    for k, motion in enumerate(m for m in library() if m.index == 1):
        q = motion.q.copy()
        q[:, TWIST] += np.pi - 0.05 if k % 2 else -np.pi + 0.25
        motions.append(motion.with_postures(np.where(np.abs(q) > np.pi, q - 2 * np.pi * np.sign(q), q)))
    found = StreamBuilder(human(), noise(), np.random.default_rng(0), True).build(motions)
    assert np.abs(found.q[:, TWIST]).max() <= np.pi
    palm = human().forward(found.q)["right_palm"]
    assert np.linalg.norm(np.diff(palm, axis=0), axis=1).max() < 0.12


def test_whether_motions_come_back_is_seen() -> None:
    assert returns_home(library(True), human())
    assert not returns_home(library(False), human())


def test_standing_shows_the_noise_of_the_recordings_and_goes_nowhere() -> None:
    plain = StandingNoise(noise().rests, DOF_NAMES, sway=0.0)
    found = standing_stream(REST, 120.0, plain, np.random.default_rng(0))
    assert found.placed == ()
    assert found.t_s[-1] == pytest.approx(120.0, abs=0.1)
    deviation = found.q - REST
    np.testing.assert_allclose(deviation.std(axis=0), 0.003, rtol=0.3)
    np.testing.assert_allclose(deviation.mean(axis=0), 0.0, atol=0.001)
    swaying = standing_stream(REST, 120.0, noise(), np.random.default_rng(0)).q - REST
    assert 0.005 < swaying[:, 0].std() < 0.02
    np.testing.assert_allclose(swaying[:, TWIST].std(), 0.003, rtol=0.3)


def test_noise_is_of_the_nearest_rounds_and_never_of_motion() -> None:
    pooled = noise()
    assert {rest.index for rest in pooled.near(0).rests} == {0, 1}  # three of one round are too few
    q = library().motions[0].q.copy()
    q[:, DOF_NAMES.index("rShoulderX")] += np.linspace(0.0, -1.5, len(q))  # moves from the first frame on
    restless = library().motions[0].with_postures(q)
    with pytest.raises(LibraryFormatError, match="rest"):
        standing_noise([restless], human())


def test_a_few_bad_frames_do_not_tilt_a_line() -> None:
    t = np.arange(20.0)
    values = np.column_stack([3.0 * t, -t])
    values[[3, 11]] += 100.0
    np.testing.assert_allclose(median_slope(t, values), [3.0, -1.0], atol=0.05)


def test_impossible_requests_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(UsageError, match="motion"):
        StreamBuilder(human(), noise(), rng, True).build([])
    with pytest.raises(UsageError, match="pauses"):
        StreamBuilder(human(), noise(), rng, True, pause_s=(0.0, 1.0)).build(library().motions)
