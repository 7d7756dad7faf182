"""The evaluation of interference as tables in the terminal: published, reached and wanted side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.evaluation.interference.result import (
    ContactReport,
    InterferenceEvaluation,
    MethodFigures,
    TableRow,
    UnreachedReport,
)
from humanpred_ros.evaluation.target import targets_table
from humanpred_ros.evaluation.text import figure_table, headline

#: So many are listed of what may be many: contacts of methods that do not predict, and runs that reach no goal.
_LISTED = 20

_FIGURES: tuple[tuple[str, Callable[[MethodFigures], str]], ...] = (
    ("runs", lambda f: str(f.runs)),
    ("goal reached", lambda f: str(f.reached)),
    ("runs with contact", lambda f: str(f.contacts)),
    ("median least distance to human, m", lambda f: f"{f.median_distance_m:.3f}"),
    ("least of all, m", lambda f: f"{f.least_distance_m:.3f}"),
    ("median time to goal, s", lambda f: _number(f.time_to_goal_s, 2)),
    ("median execution time, s", lambda f: f"{f.execution_s:.2f}"),
    ("mean cost", lambda f: f"{f.cost_mean:.4f}"),
    ("median cost", lambda f: f"{f.cost_median:.4f}"),
    ("basic / this, mean cost", lambda f: _number(f.ratio, 1)),
    ("  under what was really swept", lambda f: _number(f.ratio_swept, 1)),
    ("  where both reach a goal", lambda f: _number(f.ratio_reached, 1)),
    ("least clearance to table, cups, m", lambda f: f"{f.clearance_m:.3f}"),
    ("median replanning step, ms", lambda f: _number(f.step_ms, 1)),
)


def print_interference(evaluation: InterferenceEvaluation, console: Console) -> None:
    """Print Table I, the comparison over many motions, the contacts, and the targets."""
    held_out = evaluation.library["held_out_together"]
    headline(
        console,
        f"{evaluation.library['name']}: what is shown was not learned from, nor were the motions held out with it, "
        f"{held_out} of every class; cost: human occupancy under P1's final prediction, integrated over the executed "
        "motion, + 0.002 length",
    )
    if evaluation.table1:
        runs = evaluation.table1[0].methods["basic"].runs
        headline(console, f"P1 Table I: cost, mean +- sd of {runs} runs; ratio basic / ours")
        console.print(_costs(evaluation.table1))
        headline(console, "the same runs: goal reached, least clearance and distance of all, median times")
        console.print(_safety(evaluation.table1))
    for comparison in evaluation.comparison:
        headline(
            console,
            f"many motions, {comparison.title}: {comparison.persons} persons; no run that ends at a goal can keep a "
            f"median least distance above {comparison.bound_m:.3f} m",
        )
        console.print(_comparison(comparison.methods))
    if evaluation.contacts:
        headline(console, "runs in which the arm's spheres touch the human")
        console.print(_contacts(evaluation.contacts))
    if evaluation.unreached:
        headline(console, f"predicting runs that end at no goal: {len(evaluation.unreached)}")
        console.print(_unreached(evaluation.unreached))
    if evaluation.targets:
        console.print(targets_table(evaluation.targets))


def _costs(rows: Sequence[TableRow]) -> Table:
    table = figure_table(
        "id", "published ours", "basic", "ratio", "ours_p1", "basic", "ratio", "ours (default)", "ratio", wrap=True
    )  # fmt: skip
    for row in rows:
        p1, ours, basic = (row.methods[name] for name in ("ours_p1", "ours", "basic"))
        theirs = row.published
        table.add_row(
            str(row.number),
            "–" if theirs is None else f"{theirs.ours_mean:.3f} +- {theirs.ours_sd:.3f}",
            "–" if theirs is None else f"{theirs.basic_mean:.2f} +- {theirs.basic_sd:.2f}",
            "–" if theirs is None else f"{theirs.ratio:.0f}",
            f"{p1.cost_mean:.4f} +- {p1.cost_sd:.4f}",
            f"{basic.cost_mean:.3f} +- {basic.cost_sd:.3f}",
            _number(p1.ratio, 0),
            f"{ours.cost_mean:.4f} +- {ours.cost_sd:.4f}",
            _number(ours.ratio, 0),
        )
    return table


def _safety(rows: Sequence[TableRow]) -> Table:
    table = figure_table(
        "id", "method", "goal", "clear of table, cups", "human", "contacts", "execution", "to goal", wrap=True
    )
    for row in rows:
        for name, f in row.methods.items():
            table.add_row(
                str(row.number),
                name,
                f"{f.reached}/{f.runs}",
                f"{f.clearance_m:.3f} m",
                f"{f.least_distance_m:.3f} m",
                str(f.contacts),
                f"{f.execution_s:.2f} s",
                f"{_number(f.time_to_goal_s, 2)} s",
            )
    return table


def _comparison(methods: Sequence[MethodFigures]) -> Table:
    table = figure_table("", *(figures.method for figures in methods), wrap=True)
    for title, cell in _FIGURES:
        table.add_row(title, *(cell(figures) for figures in methods))
    return table


def _contacts(reports: Sequence[ContactReport]) -> Table:
    table = figure_table(
        "method", "scene", "motion", "seed", "at", "deepest", "arm's surface", "parts", "moved", "avoidable", wrap=True
    )
    predicting = [report for report in reports if report.method.startswith("ours")]
    others = [report for report in reports if not report.method.startswith("ours")]
    for report in [*predicting, *others[:_LISTED]]:
        contact, avoidance = report.contact, report.avoidance
        if avoidance is None:
            verdict = "not looked into"
        elif avoidance.avoidable:
            until = avoidance.latest_departure_s
            verdict = f"yes: {avoidance.policy}" + (f", leaving by {until:.2f} s" if math.isfinite(until) else "")
        else:
            verdict = f"no: best of {avoidance.tried} policies came to {avoidance.best_m:.3f} m"
        table.add_row(
            report.method,
            report.scene,
            report.motion,
            str(report.seed),
            f"{contact.t_s:.2f} s",
            f"{contact.deepest_m:.3f} m",
            f"{contact.surface_m:.3f} m",
            f"{contact.robot_link}, {contact.human_body}",
            contact.moved,
            verdict,
        )
    if len(others) > _LISTED:
        table.add_row("...", f"and {len(others) - _LISTED} more of methods that do not predict")
    return table


def _unreached(reports: Sequence[UnreachedReport]) -> Table:
    table = figure_table("method", "scene", "motion", "seed", "person leaves at a goal", "last decision", wrap=True)
    for r in reports[:_LISTED]:
        table.add_row(r.method, r.scene, r.motion, str(r.seed), f"{r.goal_m:.3f} m", escape(r.ended))
    if len(reports) > _LISTED:
        table.add_row("...", f"and {len(reports) - _LISTED} more")
    return table


def _number(value: float, digits: int) -> str:
    if math.isnan(value):
        return "–"
    return f"{value:.{digits}f}" if math.isfinite(value) else "never"
