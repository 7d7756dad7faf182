"""Table I and its extension judged: which of the project's targets the predicting methods meet."""

from __future__ import annotations

from collections.abc import Sequence

from humanpred_ros.evaluation.interference.result import (
    BASIC,
    Comparison,
    ContactReport,
    MethodFigures,
    TableRow,
)
from humanpred_ros.evaluation.interference.runs import PREDICTING
from humanpred_ros.evaluation.target import Target


def targets_of(
    table1: Sequence[TableRow], comparison: Sequence[Comparison], contacts: Sequence[ContactReport]
) -> tuple[Target, ...]:
    """Return the targets that can be judged by what was run, for every predicting method that was."""
    targets: list[Target] = []
    for method in PREDICTING:
        rows = [row for row in table1 if method in row.methods]
        if rows:
            targets += _table_targets(method, rows)
        for everywhere in comparison[:1]:
            ours, basic = everywhere.figures(method), everywhere.figures(BASIC)
            if ours is not None and basic is not None:
                targets += _comparison_targets(ours, basic, everywhere.bound_m, contacts)
    return tuple(targets)


def _table_targets(method: str, rows: Sequence[TableRow]) -> list[Target]:
    figures = [row.methods[method] for row in rows]
    ratios = [f.ratio for f in figures]
    published = [row.published.ratio for row in rows if row.published is not None]
    runs, reached = sum(f.runs for f in figures), sum(f.reached for f in figures)
    clearance, distance = min(f.clearance_m for f in figures), min(f.least_distance_m for f in figures)
    return [
        Target(
            f"Table I, {method}: ratio basic / ours, every trajectory",
            ">= 60",
            " ".join(f"{ratio:.0f}" for ratio in ratios),
            " ".join(f"{ratio:.0f}" for ratio in published),
            min(ratios) >= 60.0,
        ),
        Target(f"Table I, {method}: goals reached", f"{runs} of {runs}", f"{reached} of {runs}", "", reached == runs),
        Target(
            f"Table I, {method}: least clearance to table, cups", "> 0 m", f"{clearance:.3f} m", "", clearance > 0.0
        ),
        Target(f"Table I, {method}: least distance to human", "> 0 m", f"{distance:.3f} m", "", distance > 0.0),
    ]


def _comparison_targets(
    ours: MethodFigures, basic: MethodFigures, bound_m: float, contacts: Sequence[ContactReport]
) -> list[Target]:
    mine = [report for report in contacts if report.method == ours.method]
    helpless = sum(report.avoidance is not None and not report.avoidance.avoidable for report in mine)
    late = ours.time_to_goal_s / basic.time_to_goal_s
    return [
        Target(
            f"{ours.method}: runs with contact that could be avoided",
            "0",
            f"{len(mine) - helpless} of all runs" + (f", and {helpless} that could not" if helpless else ""),
            "",
            len(mine) == helpless,
        ),
        Target(
            f"{ours.method}: median least distance",
            f">= 2 x basic's {basic.median_distance_m:.3f} m",
            f"{ours.median_distance_m:.3f} m (at most {bound_m:.3f} m is possible)",
            "",
            ours.median_distance_m >= 2.0 * basic.median_distance_m and ours.median_distance_m > 0.0,
        ),
        Target(
            f"{ours.method}: median time to goal",
            f"<= 1.3 x basic's {basic.time_to_goal_s:.2f} s",
            f"{ours.time_to_goal_s:.2f} s, {late:.2f} x",
            "",
            late <= 1.3,
        ),
    ]
