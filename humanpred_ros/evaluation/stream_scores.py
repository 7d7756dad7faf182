"""Onsets and ends announced on a stream against those that really were: pure functions of times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.evaluation.stream_composed import Placed
from humanpred_ros.recognition.onset import MotionState

#: An announcement up to this long before what it announces still counts as one of it.
EARLY_S = 0.2
#: An end announced no earlier than this before the true one is it; before, it splits the motion in two.
EARLY_END_S = 0.3
#: An onset announced this soon after the true end is the rest of that motion, found again.
AFTER_S = 0.5


@dataclass(frozen=True)
class Event:
    """An announcement: at `found_s`, that since `since_s` there has been motion, or rest."""

    moving: bool
    since_s: float
    found_s: float


class EventLog:
    """Collects announcements from the states of a detector, one for each change."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._moving, self._n_motions = False, 0

    def add(self, state: MotionState) -> None:
        """Take the state after a frame."""
        if state.moving != self._moving or (state.moving and state.n_motions != self._n_motions):
            self.events.append(Event(state.moving, state.since_s, state.found_s))
        self._moving, self._n_motions = state.moving, state.n_motions


@dataclass(frozen=True)
class MotionScore:
    """What was announced of one motion.

    Delays are times of announcements less the true ones, errors are the announced times less the true ones.

    Attributes:
        name: of the recorded motion.
        made: a return that was not recorded but made.
        onset_delay_s, onset_error_s: None if no onset was announced between 0.2 s before the true one and the end.
        end_delay_s, end_error_s: None if no end was announced before the next motion began.
        extra_onsets: onsets announced during the motion after the first one, which cut it in two.
    """

    name: str
    made: bool
    onset_delay_s: float | None
    onset_error_s: float | None
    end_delay_s: float | None
    end_error_s: float | None
    extra_onsets: int


@dataclass(frozen=True)
class FalseStarts:
    """Onsets announced when no motion was under way.

    Attributes:
        recorded_rest: in the rest with which a recording begins, before its true onset: mistracked, or a first stir.
        after_motion: within half a second of the end of a motion.
        pause: in the pause between.
    """

    recorded_rest: int
    after_motion: int
    pause: int

    def __add__(self, other: FalseStarts) -> FalseStarts:
        return FalseStarts(
            self.recorded_rest + other.recorded_rest,
            self.after_motion + other.after_motion,
            self.pause + other.pause,
        )


def score_events(placed: Sequence[Placed], events: Sequence[Event]) -> tuple[tuple[MotionScore, ...], FalseStarts]:
    """Return the score of each motion, and the onsets that belong to none."""
    onsets = [event for event in events if event.moving]
    ends = [event for event in events if not event.moving]
    scores = []
    others = list(onsets)
    for k, motion in enumerate(placed):
        following_s = placed[k + 1].onset_s - EARLY_S if k + 1 < len(placed) else float("inf")
        before_s = placed[k - 1].end_s if k else -float("inf")
        mine = [
            onset for onset in onsets
            if max(motion.onset_s - EARLY_S, before_s) <= onset.found_s < min(motion.end_s, following_s)
        ]  # fmt: skip
        mine_ends = [end for end in ends if motion.end_s - EARLY_END_S <= end.found_s < following_s]
        others = [onset for onset in others if onset not in mine]
        onset, end = (mine[0] if mine else None), (mine_ends[0] if mine_ends else None)
        scores.append(
            MotionScore(
                name=motion.name,
                made=motion.made,
                onset_delay_s=None if onset is None else onset.found_s - motion.onset_s,
                onset_error_s=None if onset is None else onset.since_s - motion.onset_s,
                end_delay_s=None if end is None else end.found_s - motion.end_s,
                end_error_s=None if end is None else end.since_s - motion.end_s,
                extra_onsets=max(0, len(mine) - 1),
            )
        )
    stirs = sum(any(m.start_s <= onset.found_s < m.onset_s for m in placed) for onset in others)
    after = sum(any(m.end_s <= onset.found_s < m.end_s + AFTER_S for m in placed) for onset in others)
    return tuple(scores), FalseStarts(stirs, after, len(others) - stirs - after)


@dataclass(frozen=True)
class OnsetFigures:
    """Figures over some motions. Quantiles are over the motions of which an onset, or end, was announced at all.

    Attributes:
        n_motions: how many.
        in_time: share with an onset announced within the tolerance of the true one.
        missed: motions with no onset announced.
        onset_delay_s: median and 95th percentile of how late onsets are announced.
        onset_error_s: 5th percentile, median and 95th of the estimated onset's error.
        ends_found: share of the motions with an end announced before the next motion.
        end_delay_s, end_error_s: as for onsets.
        split: extra onsets during these motions.
    """

    n_motions: int
    in_time: float
    missed: int
    onset_delay_s: tuple[float, ...]
    onset_error_s: tuple[float, ...]
    ends_found: float
    end_delay_s: tuple[float, ...]
    end_error_s: tuple[float, ...]
    split: int


def onset_figures(scores: Sequence[MotionScore], tolerance_s: float) -> OnsetFigures | None:
    """Return the figures of some motions; None of none."""
    if not scores:
        return None
    in_time = [s.onset_delay_s is not None and abs(s.onset_delay_s) <= tolerance_s for s in scores]
    return OnsetFigures(
        n_motions=len(scores),
        in_time=float(np.mean(in_time)),
        missed=sum(score.onset_delay_s is None for score in scores),
        onset_delay_s=_quantiles(scores, lambda score: score.onset_delay_s, (50, 95)),
        onset_error_s=_quantiles(scores, lambda score: score.onset_error_s, (5, 50, 95)),
        ends_found=float(np.mean([score.end_delay_s is not None for score in scores])),
        end_delay_s=_quantiles(scores, lambda score: score.end_delay_s, (50, 95)),
        end_error_s=_quantiles(scores, lambda score: score.end_error_s, (5, 50, 95)),
        split=sum(score.extra_onsets for score in scores),
    )


def _quantiles(
    scores: Sequence[MotionScore], value: Callable[[MotionScore], float | None], percents: tuple[int, ...]
) -> tuple[float, ...]:
    values = [found for score in scores if (found := value(score)) is not None]
    return tuple(float(q) for q in np.percentile(values, percents)) if values else tuple(float("nan") for _ in percents)
