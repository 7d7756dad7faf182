"""The evaluation of switching as tables in the terminal: Fig. 9 beside the published, decisions over all motions."""

from __future__ import annotations

import math
from collections.abc import Callable

from rich.console import Console
from rich.table import Table

from humanpred_ros.evaluation.switching.result import SwitchingEvaluation, SwitchSummary, VariantFigures
from humanpred_ros.evaluation.switching.runs import VARIANTS, Person
from humanpred_ros.evaluation.target import targets_table
from humanpred_ros.evaluation.text import figure_table, headline

_FIGURES: tuple[tuple[str, Callable[[VariantFigures], str]], ...] = (
    ("motions", lambda f: str(f.persons)),
    ("right in the end", lambda f: str(f.right)),
    ("wrong first", lambda f: str(f.wrong_first)),
    ("  of these right in the end", lambda f: str(f.recovered)),
    ("changed the goal", lambda f: str(f.switched)),
    ("returned to a goal left before", lambda f: f"{f.returned} ({100.0 * f.returned / f.persons:.1f} %)"),
    ("  more than once", lambda f: f"{f.returned_often} ({100.0 * f.returned_often / f.persons:.1f} %)"),
    ("step of the final choice", lambda f: _quartiles(f.settled)),
    ("right since step", lambda f: _quartiles(f.decided)),
    ("final choice: steps earlier than current", lambda f: _quartiles(f.settled_earlier)),
    ("right: steps earlier than current", lambda f: _quartiles(f.decided_earlier)),
)


def print_switching(evaluation: SwitchingEvaluation, console: Console) -> None:
    """Print Fig. 9, the decisions over many motions, and the targets."""
    n_steps = evaluation.settings["runs"]["steps"]
    if evaluation.figure is not None:
        person = evaluation.figure
        headline(
            console,
            f"P1 Fig. 9: motion {person.motion} in {person.scene}, cost of each goal by replanning step, seed 0; "
            f"chosen: *; right: {person.right}, with nobody there: {person.default}",
        )
        console.print(_costs(evaluation, person))
        console.print(_switches(evaluation, person))
    for k, summary in enumerate(evaluation.summaries):
        headline(console, f"{summary.title}: {summary.persons}")
        if k == 0:
            console.print(
                "median (quartiles) of steps; right: what the same planner chooses at once if told what the body is "
                f"going to sweep; right since: up to the end, never counts as step {n_steps + 1}; final choice: the "
                "last change of goal, step 1 if there is none; returned: back to a goal that had been left",
                style="dim",
                highlight=False,
            )
        console.print(_summary(summary))
    if evaluation.targets:
        console.print(targets_table(evaluation.targets))


def _costs(evaluation: SwitchingEvaluation, person: Person) -> Table:
    published, goals = evaluation.published, evaluation.goals
    theirs = {} if published is None else {"prediction": published.prediction, "current": published.current}
    titles = [f"{variant} {goal}" for variant in VARIANTS for goal in goals]
    titles += [f"published {name} {goal}" for name in theirs for goal in (published.goals if published else ())]
    table = figure_table("step", *titles, wrap=True)
    for k in range(evaluation.settings["runs"]["steps"]):
        cells = []
        for variant in VARIANTS:
            steps = person.run(variant).steps
            for goal in goals:
                if k >= len(steps):
                    cells.append("")
                    continue
                mark = "*" if steps[k].chosen == goal else " "
                cells.append(f"{_cost(steps[k].costs[goal])}{mark}")
        for costs in theirs.values():
            cheapest = costs[k].argmin() if k < len(costs) else -1
            cells += (
                [f"{cost:.4f}{'*' if g == cheapest else ' '}" for g, cost in enumerate(costs[k])]
                if k < len(costs)
                else [""] * costs.shape[1]
            )
        table.add_row(str(k + 1), *cells)
    return table


def _switches(evaluation: SwitchingEvaluation, person: Person) -> Table:
    table = figure_table("step of the first switch", "seed 0", "all seeds", "published", wrap=True)
    published = evaluation.published
    for variant in VARIANTS:
        steps = [run.figures.first_switch for run in person.runs if run.variant == variant]
        theirs = None
        if published is not None:
            theirs = published.switch(published.current if variant == "current" else published.prediction)
        table.add_row(variant, _step(steps[0]), " ".join(map(_step, steps)), "–" if theirs is None else str(theirs))
    return table


def _summary(summary: SwitchSummary) -> Table:
    table = figure_table("", *(figures.variant for figures in summary.variants), wrap=True)
    for title, cell in _FIGURES:
        table.add_row(title, *(cell(figures) for figures in summary.variants))
    return table


def _cost(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.4f}"


def _step(step: int | None) -> str:
    return "never" if step is None else str(step)


def _quartiles(values: tuple[float, float, float]) -> str:
    low, middle, high = values
    return f"{middle:.1f} ({low:.1f} .. {high:.1f})"
