"""The figures of an evaluation of switching: what is printed, drawn and written as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from humanpred_ros.evaluation.outputs import plain
from humanpred_ros.evaluation.switching.measures import steps_earlier
from humanpred_ros.evaluation.switching.reference import PublishedCosts
from humanpred_ros.evaluation.switching.runs import Person
from humanpred_ros.evaluation.target import Target

CURRENT = "current"


@dataclass(frozen=True)
class VariantFigures:
    """The choices by one kind of occupancy beside N persons; see `ChoiceFigures` for each word.

    Attributes:
        variant: its name.
        persons: N.
        right: how many chose rightly in the end.
        wrong_first, recovered: how many chose wrongly first; of these, how many rightly in the end.
        switched: how many changed the goal at all.
        returned, returned_often: how many returned to a goal they had left (back and forth); how many more than once.
        settled: quartiles (25, 50, 75 %) of the step in which the final choice was made.
        decided: quartiles of the step since when the choice is right up to the end; never is one after the last.
        settled_earlier, decided_earlier: quartiles over persons of how many steps earlier than current occupancy
            only; 0 for that itself.
    """

    variant: str
    persons: int
    right: int
    wrong_first: int
    recovered: int
    switched: int
    returned: int
    returned_often: int
    settled: tuple[float, float, float]
    decided: tuple[float, float, float]
    settled_earlier: tuple[float, float, float]
    decided_earlier: tuple[float, float, float]

    @classmethod
    def of(cls, variant: str, persons: Sequence[Person], n_steps: int) -> VariantFigures:
        """Return the figures of one variant, seed 0, beside one or more persons."""
        mine = [person.run(variant).figures for person in persons]
        current = [person.run(CURRENT).figures for person in persons]
        pairs = list(zip(mine, current, strict=True))
        return cls(
            variant=variant,
            persons=len(mine),
            right=sum(f.right for f in mine),
            wrong_first=sum(f.wrong_first for f in mine),
            recovered=sum(f.recovered for f in mine),
            switched=sum(f.switches > 0 for f in mine),
            returned=sum(f.returns > 0 for f in mine),
            returned_often=sum(f.returns > 1 for f in mine),
            settled=_quartiles([f.settled for f in mine]),
            decided=_quartiles([n_steps + 1 if f.decided is None else f.decided for f in mine]),
            settled_earlier=_quartiles([theirs.settled - f.settled for f, theirs in pairs]),
            decided_earlier=_quartiles([steps_earlier(f, theirs, n_steps) for f, theirs in pairs]),
        )


@dataclass(frozen=True)
class SwitchSummary:
    """All variants beside the same persons."""

    title: str
    persons: int
    variants: tuple[VariantFigures, ...]


@dataclass(frozen=True)
class SwitchingEvaluation:
    """The whole evaluation.

    Attributes:
        library: facts about it.
        settings: everything the figures depend on.
        machine: what it was run on.
        goals: names, in the scene's order.
        figure: P1's Fig. 9: one person, several seeds; None if it was left out.
        published: what P1 shows of it, None if it does not lie beside the library.
        summaries: over many motions, first all of them, then parts; empty if they were left out.
        targets: side by side.
        persons: all of them, step by step.
    """

    library: Mapping[str, Any]
    settings: Mapping[str, Any]
    machine: Mapping[str, Any]
    goals: tuple[str, ...]
    figure: Person | None
    published: PublishedCosts | None
    summaries: tuple[SwitchSummary, ...]
    targets: tuple[Target, ...]
    persons: tuple[Person, ...]

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain values."""
        value: dict[str, Any] = plain(self)
        return value


def targets_of(
    figure: Person | None, published: PublishedCosts | None, summaries: Sequence[SwitchSummary]
) -> tuple[Target, ...]:
    """Return the targets that can be judged by what was run."""
    targets: list[Target] = []
    for variant in ("ours", "ours_p1"):
        if figure is not None:
            # Not the first switch: who is right from the first step has none.
            steps = [run.figures.decided for run in figure.runs if run.variant == variant]
            theirs = published.switch(published.prediction) if published is not None else None
            targets.append(
                Target(
                    f"Fig. 9, {variant}: chooses {figure.right} for good, by seed",
                    "step <= 4",
                    " ".join("never" if step is None else str(step) for step in steps),
                    "" if theirs is None else str(theirs),
                    all(step is not None and step <= 4 for step in steps),
                )
            )
        for summary in summaries[:1]:
            f = next(f for f in summary.variants if f.variant == variant)
            contested = next((s for s in summaries if s.title == CONTESTED), None)
            part = None if contested is None else next(c for c in contested.variants if c.variant == variant)
            targets += [
                Target(
                    f"{variant}: decides rightly earlier than current, median of all motions",
                    ">= 5 steps",
                    f"{f.decided_earlier[1]:.1f}",
                    "",
                    f.decided_earlier[1] >= 5,
                ),
                Target(
                    f"{variant}: motions with more than one switch back and forth",
                    "<= 5 %",
                    f"{100.0 * f.returned / f.persons:.1f} % return to a goal they left, "
                    f"{100.0 * f.returned_often / f.persons:.1f} % more than once",
                    "",
                    f.returned <= 0.05 * f.persons,
                ),
            ]
            if part is not None:
                targets.insert(
                    len(targets) - 1,
                    Target(
                        f"{variant}: the same where something is to be decided",
                        ">= 5 steps",
                        f"{part.decided_earlier[1]:.1f} ({part.persons} motions)",
                        "",
                        part.decided_earlier[1] >= 5,
                    ),
                )
    return tuple(targets)


#: Title of the persons who take the goal that the arm would choose: elsewhere everybody is right from the first step.
CONTESTED = "motions that take the goal the arm would choose"


def _quartiles(values: Sequence[int]) -> tuple[float, float, float]:
    low, middle, high = np.percentile(np.array(values, dtype=np.float64), [25.0, 50.0, 75.0])
    return float(low), float(middle), float(high)
