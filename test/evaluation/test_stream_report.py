"""Announcements are counted for the motions they belong to, once; what belongs to none is a false start."""

from __future__ import annotations

import pytest

from humanpred_ros.evaluation.stream_composed import Placed
from humanpred_ros.evaluation.stream_report import announcements, onset_figures, score_events
from humanpred_ros.recognition.onset import MotionState

PLACED = (
    Placed("0/1", 0, False, start_s=4.5, stop_s=6.5, onset_s=5.0, end_s=6.8),
    Placed("1/1", 1, False, start_s=9.5, stop_s=11.5, onset_s=10.0, end_s=11.8),
)


def events(*found: tuple[str, float]) -> list[MotionState]:
    return [MotionState(kind == "onset", t_s - 0.1, t_s, k) for k, (kind, t_s) in enumerate(found)]


def test_a_perfect_detector_gets_delays_and_no_false_starts() -> None:
    scores, false = score_events(PLACED, events(("onset", 5.1), ("end", 7.2), ("onset", 10.15), ("end", 12.3)))
    assert [score["onset_delay_s"] for score in scores] == pytest.approx([0.1, 0.15])
    assert [score["onset_error_s"] for score in scores] == pytest.approx([0.0, 0.05])
    assert [score["end_delay_s"] for score in scores] == pytest.approx([0.4, 0.5])
    assert not any(false.values())


def test_what_is_not_announced_is_missed() -> None:
    scores, false = score_events(PLACED, events(("onset", 5.1)))
    assert (scores[0]["end_delay_s"], scores[1]["onset_delay_s"], scores[1]["end_delay_s"]) == (None, None, None)
    figures = onset_figures(scores, 0.2)
    assert figures is not None
    assert (figures["in_time"], figures["missed"], figures["ends_found"]) == (0.5, 1, 0.0)
    assert not any(false.values())


def test_onsets_of_no_motion_are_told_apart() -> None:
    _, false = score_events(
        PLACED,
        events(
            ("onset", 1.0), ("end", 2.0),  # while standing
            ("onset", 4.7), ("end", 4.75),  # in the recorded rest, too early
            ("onset", 5.0), ("end", 6.9),
            ("onset", 7.1), ("end", 7.6),  # what is left of the motion
            ("onset", 10.0), ("end", 12.0),
        ),
    )  # fmt: skip
    assert false == {"recorded_rest": 1, "after_motion": 1, "pause": 1}


def test_a_motion_cut_in_two_counts_as_found_once() -> None:
    scores, false = score_events(
        PLACED, events(("onset", 5.1), ("end", 5.9), ("onset", 6.0), ("end", 7.2), ("onset", 10.3), ("end", 12.0))
    )
    assert scores[0]["extra_onsets"] == 1
    assert scores[0]["end_delay_s"] == pytest.approx(0.4)
    assert not any(false.values())
    figures = onset_figures(scores, 0.2)
    assert figures is not None
    assert (figures["in_time"], figures["missed"], figures["split"]) == (0.5, 0, 1)


def test_no_motions_have_no_figures() -> None:
    assert onset_figures([], 0.2) is None


def test_a_new_motion_without_a_rest_between_is_an_onset() -> None:
    said = [(False, 0), (True, 1), (True, 1), (True, 2), (False, 2), (False, 2), (True, 3)]
    states = [MotionState(moving, t - 0.5, float(t), n) for t, (moving, n) in enumerate(said, start=1)]
    assert [(event.moving, event.found_s) for event in announcements(states)] == [
        (True, 2.0), (True, 4.0), (False, 5.0), (True, 7.0),
    ]  # fmt: skip
