"""Cuts of a reach are where P2's are, and know how the person was moving there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import HumanModelError, MotionError, UsageError
from humanpred_ros.motion.reach_recordings import Jump, ReachRecording, load_reach_recordings
from humanpred_ros.reaching.demonstrations import SplittingConfig, cut_frames, demonstration, demonstrations
from humanpred_ros.reaching.features import ReachFeatures
from humanpred_ros.reaching.stencils import PADDING

FEATURES = ReachFeatures(MODEL)


def test_the_papers_recordings_are_cut_27_times() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    cuts = {entry.name: len(cut_frames(entry.active)) for entry in recordings}
    assert cuts == {"0446-0578": 6, "0525-0657": 6, "0444-0585": 7, "0489-0589": 2, "0780-0871": 2, "1537-1608": 0,
                    "2711-2823": 4}  # fmt: skip
    assert len(demonstrations(recordings, FEATURES, SplittingConfig(), keep_unfit=True)) == 34
    assert len(demonstrations(recordings, FEATURES, SplittingConfig())) == 26  # without the one that jumps


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
    found = demonstrations([entry], FEATURES, SplittingConfig())
    assert [demo.first_frame for demo in found] == [31, 41, 51]  # the history of the cut at 21 holds the jump


def test_reaches_shorter_than_the_stencil_are_left_out() -> None:
    assert demonstrations([recording(1, n_frames=6)], FEATURES) == ()
    assert demonstrations([recording(1, n_frames=6)], FEATURES, keep_unfit=True) == ()
    assert len(demonstrations([recording(1, n_frames=7)], FEATURES)) == 1


def test_recordings_with_jumps_are_learned_from_if_asked_for() -> None:
    entry = dataclasses.replace(recording(1, n_frames=140), jumps=(Jump("active", 15, "right_wrist", 7.0),))
    found = demonstrations([entry], FEATURES, SplittingConfig(), keep_unfit=True)
    assert [demo.first_frame for demo in found] == [0, 1, 11, 21, 31, 41, 51]


def test_recordings_of_another_human_are_refused() -> None:
    entry = recording(1)
    names = (entry.active.dof_names[1], entry.active.dof_names[0], *entry.active.dof_names[2:])
    mixed = [dataclasses.replace(motion, dof_names=names) for motion in (entry.active, entry.passive)]
    with pytest.raises(HumanModelError, match="another order"):
        demonstration(ReachRecording("mixed", *mixed), FEATURES)


@pytest.mark.parametrize("bad", [{"every_s": 0.0}, {"first_s": -1.0}, {"least_s": np.nan}])
def test_impossible_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="splitting"):
        SplittingConfig(**bad)


@pytest.mark.parametrize("frame", [-1, 99])
def test_cuts_outside_are_refused(frame: int) -> None:
    with pytest.raises(MotionError, match="made_up_1: wanted a cut at frame 0 to 98"):
        demonstration(recording(1), FEATURES, frame)
