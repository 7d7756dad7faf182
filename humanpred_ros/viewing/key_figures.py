"""The key figures of a run in words: one list that the terminal and the report show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.viewing.reliability import MOVING
from humanpred_ros.viewing.run_summary import (
    Belief,
    Interruption,
    LatencyFigures,
    OccupancyCalibration,
    RunSummary,
    StepRow,
)

#: Values of one figure that are listed.
_MOST_LISTED = 3


@dataclass(frozen=True)
class KeyFigure:
    """A figure of a run: what it is, its value with unit, a remark, and whether it is bad news."""

    name: str
    value: str
    remark: str = ""
    alarming: bool = False


def key_figures(summary: RunSummary) -> list[KeyFigure]:
    """Return the figures of a run in the order of interest."""
    figures = [_goal_figure(summary), _closest_figure(summary), _switch_figure(summary), _recognition_figure(summary)]
    if any(belief.unknown_max > 0.0 for belief in summary.beliefs):
        figures.append(_unknown_figure(summary.beliefs))
    figures += [_calibration_figure(part) for name, part in summary.calibration.items() if name == MOVING]
    figures.append(_steps_figure(summary))
    figures += [_latency_figure(name, latency) for name, latency in summary.latency.items()]
    figures.append(_latency_figure("planning one step", summary.planning))
    if summary.peak_velocity is not None:
        value = f"{100.0 * summary.peak_velocity:.0f} %"
        alarming = summary.peak_velocity > 1.0 + 1e-6
        figures.append(KeyFigure("fastest joint", value, "of its velocity limit", alarming))
    return figures


def interruptions(summary: RunSummary) -> list[tuple[str, Interruption]]:
    """Return when the arm worked on no goal, with what it did instead, in time order."""
    both = [("stops", hold) for hold in summary.holds] + [("moves aside", evasion) for evasion in summary.evasions]
    return sorted(both, key=lambda entry: entry[1].t_s)


def print_summary(summary: RunSummary, console: Console) -> None:
    """Print the replanning steps and the key figures of a run."""
    if summary.steps:
        console.print(_steps_table(summary))
    if any(row.out for row in summary.steps):
        console.print("[dim]× set aside or invalid in this step: the report says why[/dim]\n")
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="dim")
    table.add_column()
    for figure in key_figures(summary):
        text = f"{escape(figure.value)}  [dim]{escape(figure.remark)}[/dim]"
        table.add_row(escape(figure.name), f"[red]{text}[/red]" if figure.alarming else text)
    for what, part in interruptions(summary):
        table.add_row(f"arm {what}", f"{part.t_s:.2f} to {part.until_s:.2f} s: {escape(part.reason)}")
    table.add_row("duration", f"{summary.duration_s:.2f} s of data, {summary.wall_s:.1f} s of wall time")
    console.print(table)
    for note in summary.notes:
        console.print(f"[yellow]note[/yellow]  {escape(note)}")
    console.print(f"[bold]{escape(summary.outcome)}[/bold]", highlight=False)


def _steps_table(summary: RunSummary) -> Table:
    table = Table(
        title="replanning steps and the cost of every goal", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False
    )
    table.title_justify = "left"
    for name in ("step", "t in\ns", "reach", "class\np"):
        table.add_column(name, justify="right")
    for goal in summary.goals:
        table.add_column(escape(goal), justify="right", min_width=7)
    table.add_column("chosen", no_wrap=True)
    table.add_column("ms", justify="right", min_width=4)
    for row in summary.steps:
        cells = [
            str(row.step),
            f"{row.t_s:.2f}",
            _text(row.percent, ".0f", " %"),
            "–" if row.best_class is None else f"{row.best_class} {_text(row.best_probability, '.2f')}",
            *(_text(row.costs.get(goal), ".4f") + ("×" if goal in row.out else " ") for goal in summary.goals),
            _chosen(row),
            _text(row.compute_ms, ".0f"),
        ]
        table.add_row(*cells, style="bold" if row.switched and not row.missed else ("red" if row.missed else None))
    return table


def _chosen(row: StepRow) -> str:
    """Return the goal with what is special about the step, short enough for a terminal of 80 columns."""
    if row.missed or row.instead:
        return "missed" if row.missed else row.instead
    return ("→ " if row.switched else "") + escape(row.chosen)


def _text(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else f"{value:{form}}{unit}"


def _goal_figure(summary: RunSummary) -> KeyFigure:
    if summary.reached is None:
        return KeyFigure("goal reached", "none", "within the recorded time", alarming=True)
    remark = f"after {summary.reached.t_s:.2f} s; final joint error {1e3 * summary.reached.error_rad:.1f} mrad"
    return KeyFigure("goal reached", summary.reached.goal, remark)


def _closest_figure(summary: RunSummary) -> KeyFigure:
    closest = summary.closest
    if closest is None:
        return KeyFigure("closest to human", "–", "not known")
    remark = f"at {closest.t_s:.2f} s, {closest.robot_link} – {closest.human_body}"
    return KeyFigure(
        "closest to human", f"{100.0 * closest.distance_m:.1f} cm", remark, alarming=closest.distance_m <= 0.0
    )


def _switch_figure(summary: RunSummary) -> KeyFigure:
    if not summary.switches:
        chosen = next((row.chosen for row in summary.steps if row.chosen), "")
        return KeyFigure("switch of goal", "none", f"{chosen} chosen throughout" if chosen else "no goal was chosen")
    first = summary.switches[0]
    share = "" if first.percent is None else f" at {first.percent:.0f} % of the reach"
    more = f"; {len(summary.switches)} switches in all" if len(summary.switches) > 1 else ""
    remark = f"{first.goal_before} to {first.goal_after}{share}, in effect in step {first.step_in_effect}{more}"
    return KeyFigure("switch of goal", f"step {first.step}", remark)


def _recognition_figure(summary: RunSummary) -> KeyFigure:
    recognised, beliefs = summary.recognised, summary.beliefs
    if recognised is None and beliefs:
        found = ["none" if belief.rather_unknown else f"class {belief.best_class}" for belief in beliefs]
        remark = f"most probable {_at_the_end(beliefs)}; the true class is not known"
        return KeyFigure("reach recognised", _listed(found), remark)
    if recognised is None:
        return KeyFigure("reach recognised", "–", "no posterior was recorded that tells classes apart")
    if recognised.t_s is None:
        return KeyFigure("reach recognised", "no", f"true class {recognised.true_class}", alarming=True)
    share = f"{recognised.t_s:.2f} s" if recognised.percent is None else f"at {recognised.percent:.0f} %"
    remark = f"class {recognised.true_class}, most probable from {recognised.t_s:.2f} s on"
    return KeyFigure("reach recognised", share, remark)


def _unknown_figure(beliefs: Sequence[Belief]) -> KeyFigure:
    most = max(beliefs, key=lambda belief: belief.unknown_max)
    return KeyFigure(
        "probability of no known class",
        _listed([f"{100.0 * belief.unknown:.0f} %" for belief in beliefs]),
        f"{_at_the_end(beliefs)}; at most {100.0 * most.unknown_max:.0f} % at {most.unknown_max_s:.2f} s",
        alarming=any(belief.rather_unknown for belief in beliefs),
    )


def _at_the_end(beliefs: Sequence[Belief]) -> str:
    return "at the end of the movement" if len(beliefs) == 1 else f"at the end of each of {len(beliefs)} movements"


def _listed(texts: Sequence[str]) -> str:
    """Return values as a list that fits a tile."""
    return ", ".join(texts[:_MOST_LISTED]) + (", …" if len(texts) > _MOST_LISTED else "")


def _calibration_figure(part: OccupancyCalibration) -> KeyFigure:
    missed = "nothing was swept" if part.missed is None else f"{100.0 * part.missed:.1f} % of the swept voxels missed"
    value = "–" if part.error is None else f"{part.error:.2f}"
    return KeyFigure("calibration error of the occupancy", value, f"mean of |predicted – observed|; {missed}")


def _steps_figure(summary: RunSummary) -> KeyFigure:
    remark = f"{len(summary.holds)} hold{'s' if len(summary.holds) != 1 else ''}" if summary.holds else "no hold"
    if summary.evasions:
        times = {1: "once", 2: "twice"}.get(len(summary.evasions), f"{len(summary.evasions)} times")
        remark += f"; moved out of the person's way {times}"
    value = f"{summary.missed} of {len(summary.steps)} missed" if summary.missed else str(len(summary.steps))
    return KeyFigure("replanning steps", value, remark, alarming=bool(summary.missed or summary.holds))


def _latency_figure(name: str, latency: LatencyFigures) -> KeyFigure:
    if latency.median_ms is None or latency.p99_ms is None:
        return KeyFigure(name, "–", "no samples")
    remark = f"median of {latency.count}; 99 % below {latency.p99_ms:.1f} ms"
    return KeyFigure(name, f"{latency.median_ms:.1f} ms", remark)
