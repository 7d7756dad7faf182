"""When was it decided what the arm works on, and was it decided once? Definitions, so that figures mean one thing.

A run is a sequence of choices, one for each replanning step, numbered from 1 as in P1's Fig. 9. A step that chooses
no goal of the scene (a retreat, or a hold before any choice) is None and counts as no choice: it is skipped.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

Choices = Sequence[str | None]


@dataclass(frozen=True)
class ChoiceFigures:
    """One run's choices.

    Attributes:
        first, last: goals chosen first and last; None if none ever was.
        switches: changes from one goal to another.
        first_switch: step of the first of them, None if there is none.
        settled: step in which the final choice was made: from it on nothing changes; 1 if nothing ever did.
        returns: changes to a goal that had been chosen and left before. A - B - A is one: back and forth.
        right: whether the last choice is the right one, what `Person.right` says.
        decided: step since when the right goal is chosen up to the end, None if the last choice is wrong.
        wrong_first: whether the first choice is wrong.
    """

    first: str | None
    last: str | None
    switches: int
    first_switch: int | None
    settled: int
    returns: int
    right: bool
    decided: int | None
    wrong_first: bool

    @property
    def recovered(self) -> bool:
        """Whether it decided wrongly first, and rightly in the end."""
        return self.wrong_first and self.right

    @classmethod
    def of(cls, choices: Choices, right: str) -> ChoiceFigures:
        """Return the figures of a run's choices, step by step."""
        chosen = [(step, goal) for step, goal in enumerate(choices, start=1) if goal is not None]
        left: set[str] = set()
        changes, returns = [], 0
        for (_, before), (step, goal) in itertools.pairwise(chosen):
            if goal != before:
                changes.append(step)
                left.add(before)
                returns += goal in left
        first = chosen[0][1] if chosen else None
        last = chosen[-1][1] if chosen else None
        settled = changes[-1] if changes else (chosen[0][0] if chosen else 1)
        return cls(
            first=first,
            last=last,
            switches=len(changes),
            first_switch=changes[0] if changes else None,
            settled=settled,
            returns=returns,
            right=last == right,
            decided=settled if last == right else None,
            wrong_first=first != right,
        )


def steps_earlier(ours: ChoiceFigures, other: ChoiceFigures, n_steps: int) -> int:
    """Return by how many steps `ours` decided rightly before `other`; who never does counts as one after the last."""
    never = n_steps + 1
    return (never if other.decided is None else other.decided) - (never if ours.decided is None else ours.decided)
