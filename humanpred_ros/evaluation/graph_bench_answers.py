"""Reads off a recorded run how long every answer to a posture took, and which replanning steps were missed.

Times begin when a posture was published (the sender's clock) and end when the answer was received by the recorder, a
process of its own: what another node on this machine would see.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from humanpred_ros import topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import BagError
from humanpred_ros.viewing.recorded import RecordedDecision, decision_of
from humanpred_ros.viewing.run import Entry, stamped

_READY = "ready"
_PLANNER = "stomp_planner"
#: Stamps are rounded to nanoseconds; steps are due this much early, as in the replanner.
_DUE_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class Answers:
    """How long the answers of one run took, and what was not answered.

    Attributes:
        delays_ms: from a posture's publication: `occupancy_ms` of every posture, `step_ms` (to the decision) of every
            replanning step, `trajectory_ms` of every step that sent one; `compute_ms`: what the planner itself says a
            step took.
        iterations: fewest STOMP iterations of a goal in each step, goals that were set aside left out; fewer than
            asked for mean that time ran out or the goal was far too expensive.
        counts: `steps` that were taken; `late`: whose plan came too late to be taken over; `skipped`: that were due
            and not taken, because the planner was still busy with the one before; postures `unanswered`.
        ready_s: from the start of the planner's process to its first word of being ready; NaN if it never was.
    """

    delays_ms: Mapping[str, Sequence[float]]
    iterations: Sequence[int]
    counts: Mapping[str, int]
    ready_s: float


class PostureAnswer(NamedTuple):
    """A posture and the occupancy that answered it.

    Attributes:
        stamp_ns: of both.
        sent_ns: when the posture was published.
        heard_ns: when the recorder received the occupancy; None if there was none.
    """

    stamp_ns: int
    sent_ns: int
    heard_ns: int | None

    @property
    def delay_ms(self) -> float:
        """From one to the other; NaN without an answer."""
        return float("nan") if self.heard_ns is None else (self.heard_ns - self.sent_ns) * 1e-6


def posture_answers(reader: BagReader) -> tuple[PostureAnswer, ...]:
    """Return every posture of a run in real time with its answer.

    Raises:
        BagError: no postures, or a damaged bag.
    """
    postures = list(stamped(reader, topics.body_topic(reader.topics, topics.human_joint_states)))
    if not postures:
        raise BagError(f"{reader.path}: wanted a run with postures, got none; did the tracker start?")
    heard_ns = {entry.stamp_ns: entry.heard_ns for entry in stamped(reader, topics.OCCUPANCY)}
    return tuple(PostureAnswer(entry.stamp_ns, entry.sent_ns, heard_ns.get(entry.stamp_ns)) for entry in postures)


def answers_of(bag: Path, period_s: float, planner_started_ns: int) -> Answers:
    """Return the answers recorded in `bag`.

    Args:
        bag: of a run in real time.
        period_s: of a replanning step.
        planner_started_ns: wall time at which the planner's process was started.

    Raises:
        BagError: no postures, or a damaged bag.
    """
    reader = BagReader(bag)
    answers = posture_answers(reader)
    sent_ns = {answer.stamp_ns: answer.sent_ns for answer in answers}
    decisions = [(entry, decision_of(entry.message, 0.0, 0.0)) for entry in stamped(reader, topics.DECISION)]
    steps = [(entry, decision) for entry, decision in decisions if decision.is_step]

    def delays_ms(heard: Iterable[Entry]) -> list[float]:
        return [(entry.heard_ns - sent_ns[entry.stamp_ns]) * 1e-6 for entry in heard if entry.stamp_ns in sent_ns]

    return Answers(
        {
            "occupancy_ms": [answer.delay_ms for answer in answers if answer.heard_ns is not None],
            "step_ms": delays_ms(entry for entry, _ in steps),
            "trajectory_ms": delays_ms(_stamped_by_step(stamped(reader, topics.TRAJECTORY), decisions)),
            "compute_ms": [1e3 * decision.compute_s for _, decision in steps],
        },
        [min((goal.iterations for goal in decision.goals if goal.iterations), default=0) for _, decision in steps],
        {
            "steps": len(steps),
            "late": sum(decision.action == "missed" for _, decision in decisions),
            "skipped": skipped_steps([entry.stamp_ns * 1e-9 for entry, _ in steps], period_s),
            "unanswered": sum(answer.heard_ns is None for answer in answers),
        },
        _ready_s(reader, planner_started_ns),
    )


def skipped_steps(stamps_s: Sequence[float], period_s: float) -> int:
    """Return how many whole periods went by between neighbouring steps without one."""
    gaps = np.diff(np.asarray(stamps_s, dtype=np.float64))
    return int(np.maximum(np.floor((gaps + _DUE_TOLERANCE_S) / period_s) - 1, 0).sum())


def _stamped_by_step(
    trajectories: Iterable[Entry], decisions: Sequence[tuple[Entry, RecordedDecision]]
) -> Iterable[Entry]:
    """Give each trajectory of a replanning step the step's stamp: it was sent right before its decision."""
    order = sorted(decisions, key=lambda entry: entry[0].sent_ns)
    times = [entry.sent_ns for entry, _ in order]
    for trajectory in trajectories:
        k = bisect_left(times, trajectory.sent_ns)
        if k < len(order) and order[k][1].is_step:
            yield trajectory._replace(stamp_ns=order[k][0].stamp_ns)


def _ready_s(reader: BagReader, started_ns: int) -> float:
    for entry in stamped(reader, topics.DIAGNOSTICS):
        for status in entry.message.status:
            if status.name == _PLANNER and status.message == _READY:
                return (entry.sent_ns - started_ns) * 1e-9
    return float("nan")
