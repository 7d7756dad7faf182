"""Onsets and ends announced on a stream against those that really were: pure functions of times.

The figures are returned by name, as they stand in the JSON file of `humanpred evaluate streams`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from humanpred_ros.evaluation.stream_composed import Placed
from humanpred_ros.recognition.onset import MotionState

#: An announcement up to this long before what it announces still counts as one of it.
EARLY_S = 0.2
#: An end announced no earlier than this before the true one is it; before, it splits the motion in two.
EARLY_END_S = 0.3
#: An onset announced this soon after the true end is the rest of that motion, found again.
AFTER_S = 0.5


def announcements(states: Iterable[MotionState]) -> list[MotionState]:
    """Return those states of a detector in which it says something new: an onset, or an end."""
    found, before = [], MotionState(False, 0.0, 0.0, 0)
    for state in states:
        if state.moving != before.moving or (state.moving and state.n_motions != before.n_motions):
            found.append(state)
        before = state
    return found


def score_events(placed: Sequence[Placed], events: Sequence[MotionState]) -> tuple[list[dict[str, Any]], Counter[str]]:
    """Return what was announced of each motion, and how many onsets belong to none.

    Args:
        placed: the motions of a stream, in order.
        events: announcements on it.

    Returns:
        Of each motion its `name`; `made`: a return that was not recorded but made; `onset_delay_s`, `onset_error_s`:
        time of the announcement, and the announced time, less the true onset, None if none was announced between 0.2 s
        before it and the end; `end_delay_s`, `end_error_s`: the same of the end, None if none was announced before the
        next motion began; `extra_onsets`: announced during the motion after the first one, which cut it in two.
        And the number of false starts: in `recorded_rest`, with which a recording begins, before its true onset
        (mistracked, or a first stir); `after_motion`, within half a second of the end of a motion; in a `pause`.
    """
    others = [event for event in events if event.moving]
    scores = []
    for k, motion in enumerate(placed):
        following_s = placed[k + 1].onset_s - EARLY_S if k + 1 < len(placed) else float("inf")
        from_s = max(motion.onset_s - EARLY_S, placed[k - 1].end_s if k else -float("inf"))
        until_s = min(motion.end_s, following_s)
        onsets = [event for event in events if event.moving and from_s <= event.found_s < until_s]
        ends = [e for e in events if not e.moving and motion.end_s - EARLY_END_S <= e.found_s < following_s]
        others = [onset for onset in others if onset not in onsets]
        scores.append(
            {
                "name": motion.name,
                "made": motion.made,
                "onset_delay_s": onsets[0].found_s - motion.onset_s if onsets else None,
                "onset_error_s": onsets[0].since_s - motion.onset_s if onsets else None,
                "end_delay_s": ends[0].found_s - motion.end_s if ends else None,
                "end_error_s": ends[0].since_s - motion.end_s if ends else None,
                "extra_onsets": max(0, len(onsets) - 1),
            }
        )
    stirs = sum(any(m.start_s <= onset.found_s < m.onset_s for m in placed) for onset in others)
    after = sum(any(m.end_s <= onset.found_s < m.end_s + AFTER_S for m in placed) for onset in others)
    return scores, Counter(recorded_rest=stirs, after_motion=after, pause=len(others) - stirs - after)


def onset_figures(scores: Sequence[dict[str, Any]], tolerance_s: float) -> dict[str, Any] | None:
    """Return the figures of some motions; None of none.

    Quantiles are over the motions of which an onset, or end, was announced at all.

    Args:
        scores: of `score_events`.
        tolerance_s: an onset announced within this of the true one is in time.

    Returns:
        `n_motions`; `in_time`: share with an onset in time; `missed`: motions with no onset announced;
        `onset_delay_s`: median and 95th percentile of how late onsets are announced; `onset_error_s`: 5th percentile,
        median and 95th of the estimated onset's error; `ends_found`: share of the motions with an end announced before
        the next motion; `end_delay_s`, `end_error_s`: as for onsets; `split`: extra onsets during these motions.
    """
    if not scores:
        return None

    def quantiles(name: str, *percents: int) -> list[float]:
        values = [score[name] for score in scores if score[name] is not None]
        return np.percentile(values, percents).tolist() if values else [float("nan")] * len(percents)

    delays = [score["onset_delay_s"] for score in scores]
    return {
        "n_motions": len(scores),
        "in_time": float(np.mean([delay is not None and abs(delay) <= tolerance_s for delay in delays])),
        "missed": delays.count(None),
        "onset_delay_s": quantiles("onset_delay_s", 50, 95),
        "onset_error_s": quantiles("onset_error_s", 5, 50, 95),
        "ends_found": float(np.mean([score["end_delay_s"] is not None for score in scores])),
        "end_delay_s": quantiles("end_delay_s", 50, 95),
        "end_error_s": quantiles("end_error_s", 5, 50, 95),
        "split": sum(score["extra_onsets"] for score in scores),
    }
