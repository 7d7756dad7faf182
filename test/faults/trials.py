"""What was seen of a graph while something was wrong with it, and whether that was right.

An arm rests from when its joint states last showed it moving. Its time to rest counts from the moment in which the
fault was put in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros.geometry.checks import FloatArray

#: An arm none of whose joints is faster rests, rad/s; so long without a faster one is rest, s.
REST_SPEED, REST_S = 0.01, 0.2
#: An arm with a faster joint is moving; a fault is put in when it is on its way in earnest, rad/s.
MOVING_SPEED, ON_ITS_WAY_SPEED = 0.05, 0.15
#: What the planner answers when it has looked at human data and lets the arm work.
WORKING = ("keep", "replan", "evade", "arrived")
#: Decisions and joint states on their way when a fault is put in are not held against anybody, s.
_GRACE_S = 0.2
#: A joint state tells where the arm was so much earlier or later, s.
_SAME_TIME_S = 0.05
#: Two messages of one moment come within this time of each other, s.
_LATELY_S = 1.0
#: A hold may be so much older than what /diagnostics says, s: it is published five times a second.
_STATUS_S = 0.5
#: How a row ends: the planner holds; the arm works on; it is stopped by whomever; only measured.
HOLDS, GOES_ON, STOPS, OPEN = "holds", "goes on", "stops", "open"


class TimedText(NamedTuple):
    """A decision (action, reason, age of the data in s) or a status (node, text, level), and when it came.

    A decision also has how long the planner took for it, ms.
    """

    t_s: float
    name: str
    text: str
    value: float
    took_ms: float = math.nan


class ArmState(NamedTuple):
    """Where the arm was (D,), rad, the speed of its fastest joint, rad/s, and the stamp of that, s."""

    t_s: float
    q: FloatArray
    speed: float
    stamp_s: float


class Command(NamedTuple):
    """A trajectory: where it begins (D,), rad, and when, by its stamp, s; how long it lasts, s."""

    t_s: float
    first: FloatArray
    stamp_s: float
    lasts_s: float


@dataclass
class Heard:
    """What came over the wire, in the order it came, at steady times."""

    arm: list[ArmState] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    decisions: list[TimedText] = field(default_factory=list)
    diagnostics: list[TimedText] = field(default_factory=list)
    travelled_rad: float = 0.0  #: way of the joint that moved most, from one joint state to the next, summed up

    def see_arm(self, t_s: float, q: FloatArray, speed: float, stamp_s: float) -> None:
        """Add a joint state."""
        if self.arm:
            self.travelled_rad += float(np.abs(q - self.arm[-1].q).max())
        self.arm.append(ArmState(t_s, q, speed, stamp_s))

    def gap_rad(self, command: Command) -> float:
        """Return how far a trajectory begins from where the arm was measured then; 0 if it was not."""
        # Where a clock was set back, a stamp comes twice.
        lately = [state for state in list(self.arm) if abs(state.t_s - command.t_s) < _LATELY_S]
        state = min(lately, key=lambda state: abs(state.stamp_s - command.stamp_s), default=None)
        if state is None or abs(state.stamp_s - command.stamp_s) > _SAME_TIME_S:
            return 0.0
        return float(np.abs(command.first - state.q).max())

    def forget(self) -> None:
        """Begin anew, but for where the arm is and how long it is going to move."""
        for entries in (self.arm, self.commands, self.decisions, self.diagnostics):
            del entries[:-1]

    def moving(self, now_s: float) -> bool:
        """Return whether the newest joint state shows a moving arm."""
        return bool(self.arm) and now_s - self.arm[-1].t_s < REST_S and self.arm[-1].speed > MOVING_SPEED

    def under_way(self, now_s: float, for_s: float) -> bool:
        """Return whether the arm moves, at the planner's will and undisturbed, and will do so for some time."""
        if not (self.moving(now_s) and self.commands and self.decisions):
            return False
        if self.arm[-1].speed < ON_ITS_WAY_SPEED:
            return False
        command, decision = self.commands[-1], self.decisions[-1]
        answered = decision.name in WORKING and now_s - decision.t_s < REST_S
        undisturbed = all(entry.name != "hold" or entry.t_s < now_s - REST_S for entry in list(self.decisions))
        return answered and undisturbed and command.t_s + command.lasts_s - now_s > for_s

    def working_since(self, t_s: float) -> bool:
        """Return whether the arm moves, and the planner has let it since `t_s`."""
        last = self.decisions[-1] if self.decisions else None
        return last is not None and last.t_s > t_s and last.name in WORKING and self.moving(last.t_s)

    def spoken_since(self, t_s: float, node: str) -> bool:
        """Return whether a node has said something on /diagnostics since `t_s`; true of no node."""
        return not node or any(status.t_s > t_s and status.name == node for status in list(self.diagnostics))

    def happened(self, bounds: Bounds, since_s: float, until_s: float) -> bool:
        """Return whether what is asked for has been seen: the reason, and rest where the arm must rest."""
        said = [entry for entry in [*self.decisions, *self.diagnostics] if entry.t_s >= since_s]
        told = not bounds.reasons or _first_that_says(said, bounds.reasons) is not None
        return told and (bounds.rest_s is None or self.rest_s(since_s, until_s) is not None)

    def rest_s(self, since_s: float, until_s: float) -> float | None:
        """Return when the arm came to rest after `since_s`, in s after it; None if it did not until `until_s`."""
        moved = [state.t_s for state in list(self.arm) if since_s <= state.t_s <= until_s and state.speed > REST_SPEED]
        for before, after in zip([since_s, *moved], [*moved, until_s], strict=True):
            if after - before >= REST_S:
                return before - since_s
        return None

    def oldest_data_s(self, since_s: float, until_s: float) -> float:
        """Return the greatest age of the human data that the arm was moving on."""
        answers = [entry for entry in list(self.decisions) if entry.name in WORKING]
        worst, newest, k = 0.0, -math.inf, 0
        for state in list(self.arm):
            while k < len(answers) and answers[k].t_s <= state.t_s:
                newest, k = max(newest, answers[k].t_s - answers[k].value), k + 1
            if since_s <= state.t_s <= until_s and state.speed > REST_SPEED and math.isfinite(newest):
                worst = max(worst, state.t_s - newest)
        return worst


@dataclass(frozen=True)
class Trial:
    """What one occurrence of a fault led to; times in s, None where it did not happen."""

    hold_s: float | None  #: from the fault to the decision to hold
    rest_s: float | None  #: from the fault until the arm rested
    reason: str  #: what was given for it, in the planner's words, or in those of /diagnostics
    recovered_s: float | None  #: from the fault's end until the arm moved again
    gap_rad: float  #: farthest that a trajectory began from where the arm was measured
    data_age_s: float  #: greatest age of the human data on which the arm moved meanwhile
    speed: float  #: of the fastest joint when the fault was put in, rad/s
    took_ms: float = math.nan  #: the planner, from the message that showed the fault to the hold it sent
    problems: tuple[str, ...] = ()  #: what was not as it should be

    @classmethod
    def not_begun(cls, why: str) -> Trial:
        """Return the trial of a fault that could not be put in."""
        return cls(None, None, "", None, math.nan, math.nan, math.nan, problems=(why,))


@dataclass(frozen=True)
class Bounds:
    """What is asked of a trial."""

    outcome: str  #: HOLDS, GOES_ON, STOPS or OPEN
    reasons: tuple[str, ...]  #: one of these must be part of what is said
    rest_s: float | None  #: longest time to rest; None asks for none
    data_age_s: float | None  #: greatest age of the data on which the arm moves; None does not look
    gap_rad: float  #: farthest that a trajectory may begin from the arm


def judged(heard: Heard, bounds: Bounds, began_s: float, ended_s: float, recovered_s: float | None) -> Trial:
    """Return what a fault led to.

    Args:
        heard: all of it.
        bounds: what is asked for.
        began_s, ended_s: when the fault was there, on the clock of what was heard.
        recovered_s: when the arm worked again; None if it did not.
    """
    until_s = math.inf if recovered_s is None else recovered_s
    holds = [entry for entry in list(heard.decisions) if began_s <= entry.t_s <= until_s and entry.name == "hold"]
    told = [entry for entry in list(heard.diagnostics) if began_s <= entry.t_s <= until_s]
    hold = _first_that_says(holds, bounds.reasons)
    said = hold or _first_that_says(told, bounds.reasons)
    rest_s = heard.rest_s(began_s, ended_s)
    gaps = [heard.gap_rad(c) for c in list(heard.commands) if began_s + _GRACE_S <= c.t_s <= until_s]
    speed = next((state.speed for state in heard.arm if state.t_s >= began_s), math.nan)
    trial = Trial(
        None if hold is None else hold.t_s - began_s,
        rest_s,
        _with(said, bounds.reasons),
        None if recovered_s is None else recovered_s - ended_s,
        max(gaps, default=0.0),
        heard.oldest_data_s(began_s, ended_s),
        speed,
        math.nan if hold is None else hold.took_ms,
    )
    problems = [] if bounds.outcome == OPEN else list(_problems(trial, bounds, holds))
    if hold is not None and bounds.rest_s is not None and bounds.outcome == HOLDS:
        planner = [s for s in told if s.name == "stomp_planner" and hold.t_s + _STATUS_S < s.t_s < ended_s]
        if any(status.value == 0.0 for status in planner):
            problems.append("the planner's diagnostics were OK while it held")
    return Trial(**(_fields(trial) | {"problems": tuple(problems)}))


def _problems(trial: Trial, bounds: Bounds, holds: Sequence[TimedText]) -> Any:
    wanted = " or ".join(bounds.reasons)
    if bounds.outcome == HOLDS and trial.hold_s is None:
        other = sorted({entry.text.split(":")[0] for entry in holds})
        yield f"wanted a hold that says {wanted}, got {'; '.join(other) or 'none'}"
    elif bounds.reasons and not trial.reason:
        yield f"nobody said {wanted}"
    if bounds.outcome in (HOLDS, STOPS) and bounds.rest_s is not None:
        if trial.rest_s is None:
            yield "the arm did not come to rest"
        elif trial.rest_s > bounds.rest_s:
            yield f"the arm rested after {trial.rest_s:.2f} s, at most {bounds.rest_s:.2f} s are allowed"
    if bounds.data_age_s is not None and trial.data_age_s > bounds.data_age_s:
        yield f"the arm moved on data {trial.data_age_s:.2f} s old, at most {bounds.data_age_s:.2f} s are allowed"
    if trial.recovered_s is None:
        yield "the arm did not work again"
    if trial.gap_rad > bounds.gap_rad:
        yield f"a trajectory began {trial.gap_rad:.3f} rad from the arm, at most {bounds.gap_rad:.3f} are allowed"


def _first_that_says(entries: Sequence[TimedText], reasons: Sequence[str]) -> TimedText | None:
    return next((entry for entry in entries if any(reason in entry.text for reason in reasons)), None)


def _with(entry: TimedText | None, reasons: Sequence[str]) -> str:
    """Return the part of a text that gives the reason."""
    if entry is None:
        return ""
    parts = entry.text.split("; ")
    return next((part for part in parts if any(reason in part for reason in reasons)), entry.text)


def _fields(trial: Trial) -> dict[str, Any]:
    return {name: getattr(trial, name) for name in trial.__dataclass_fields__}
