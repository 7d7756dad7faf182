"""Watches what is being executed between the steps: a person moves sooner than the next step is due."""

from __future__ import annotations

import numpy as np

from humanpred_ros.planning.person import Person
from humanpred_ros.planning.schedule import Schedule

#: An arm that is too close to the person already may come closer by this before it is stopped, m.
_CLOSER_M = 0.01
#: Moments of a stretch at which the distance is looked at.
_LOOKS = 9


def stop_reason(person: Person, schedule: Schedule, from_s: float, to_s: float, separation_m: float) -> str:
    """Return why the robot must stop at once: it would come too close to the person before `to_s`. Else empty.

    An arm that is too close already, because the person came to it, is stopped only if it comes closer itself.
    """
    for begin_s, end_s, trajectory in schedule.pieces(from_s, to_s):
        if trajectory.end_s <= begin_s:
            continue  # an arm at rest can do nothing by stopping
        trouble = person.in_the_way(trajectory, begin_s, end_s)
        if trouble is None:
            continue
        here = float(person.gap_m(schedule.state_at(from_s)[0][None])[0])
        coming = trajectory.sample(np.linspace(begin_s, end_s, _LOOKS))[0]
        if float(person.gap_m(coming).min()) < min(separation_m, here - _CLOSER_M):
            return f"too close: {trouble}"
    return ""


def has_become_bad(person: Person, schedule: Schedule, t_s: float, t_switch_s: float) -> bool:
    """Return whether what is executed at `t_s` should be replaced as soon as a new plan can take over.

    That is if it comes too close to where the person is, crosses where they are likely to be, or ends there. While
    the answer to the last such danger has not taken over yet, nothing is asked for.
    """
    if schedule.last_from_s > t_s:
        return False
    executing = schedule.at(t_s)
    if person.comes_to(executing.q[-1]) or person.in_the_way(executing, t_switch_s):
        return True
    return executing.end_s > t_s and bool(person.on_the_way(executing, t_switch_s))
