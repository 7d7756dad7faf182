"""The summary of a run as tables in the terminal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.viewing.run_summary import (
    Belief,
    LatencyFigures,
    OccupancyCalibration,
    Recognised,
    RunSummary,
    StepRow,
)

#: Movements listed; a long stream has many.
_MOST_MOVEMENTS = 6


def print_summary(summary: RunSummary, console: Console) -> None:
    """Print the replanning steps and the key figures of a run."""
    if summary.steps:
        console.print(_steps_table(summary))
    if any(row.out for row in summary.steps):
        console.print("[dim]× out of the question in this step: the report says why[/dim]\n")
    console.print(_figures_table(summary))
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


def _figures_table(summary: RunSummary) -> Table:
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="dim")
    table.add_column()
    for switch in summary.switches:
        share = "" if switch.percent is None else f", {switch.percent:.0f} % of the reach"
        table.add_row(
            "switch",
            f"step {switch.step} ({switch.t_s:.2f} s{share}): {escape(switch.goal_before)} to "
            f"{escape(switch.goal_after)}, in effect in step {switch.step_in_effect}"
            + (f"; {escape(switch.reason)}" if switch.reason else ""),
        )
    if not summary.switches:
        table.add_row("switch", "none")
    if summary.closest is not None:
        closest = summary.closest
        parts = f"{closest.robot_link} – {closest.human_body}"
        text = f"{100.0 * closest.distance_m:.1f} cm at {closest.t_s:.2f} s ({parts})"
        table.add_row("closest to human", f"[red]{text}[/red]" if closest.distance_m <= 0.0 else text)
    if summary.recognised is not None:
        table.add_row("recognised", recognition_text(summary.recognised))
    for belief in summary.beliefs[:_MOST_MOVEMENTS]:
        table.add_row("movement", belief_text(belief))
    if len(summary.beliefs) > _MOST_MOVEMENTS:
        table.add_row("", f"and {len(summary.beliefs) - _MOST_MOVEMENTS} more")
    for name, part in summary.calibration.items():
        table.add_row(f"occupancy, {name}", calibration_text(part))
    for name, latency in summary.latency.items():
        table.add_row(name, _latency(latency))
    table.add_row("planning one step", _latency(summary.planning))
    table.add_row("missed steps", f"{summary.missed} of {len(summary.steps)}")
    for hold in summary.holds:
        table.add_row("hold", f"{hold.t_s:.2f} to {hold.until_s:.2f} s: {escape(hold.reason)}")
    for evasion in summary.evasions:
        table.add_row("moves aside", f"{evasion.t_s:.2f} to {evasion.until_s:.2f} s: {escape(evasion.reason)}")
    if summary.peak_velocity is not None:
        table.add_row("fastest joint", f"{100.0 * summary.peak_velocity:.0f} % of its velocity limit")
    table.add_row("duration", f"{summary.duration_s:.2f} s of data, {summary.wall_s:.1f} s of wall time")
    return table


def recognition_text(recognised: Recognised) -> str:
    """Return when the true class was recognised, in words."""
    if recognised.t_s is None:
        return f"class {recognised.true_class} not recognised"
    share = "" if recognised.percent is None else f", {recognised.percent:.0f} % of the reach"
    return f"class {recognised.true_class} from {recognised.t_s:.2f} s on{share}"


def belief_text(belief: Belief) -> str:
    """Return what a movement was believed to be, in words."""
    share = "" if belief.since_percent is None else f", {belief.since_percent:.0f} % of the reach"
    text = f"class {belief.best_class} (p = {belief.probability:.2f}), likeliest from {belief.since_s:.2f} s on{share}"
    if belief.unknown_max > 0.0:
        text += f"; no known class p = {belief.unknown:.2f}, at most {belief.unknown_max:.2f}"
    rather = "rather no known class, of those " if belief.rather_unknown else ""
    return f"{belief.from_s:.2f} to {belief.until_s:.2f} s: {rather}{text}"


def calibration_text(part: OccupancyCalibration) -> str:
    """Return whether the predicted occupancy came true, in words."""
    texts = [
        "" if part.error is None else f"calibration error {part.error:.2f}",
        "" if part.missed is None else f"{100.0 * part.missed:.1f} % of swept voxels missed",
        "" if part.squared_error_ratio is None else f"squared error {part.squared_error_ratio:.2f} x current posture's",
    ]
    return ", ".join(text for text in texts if text) + f" (n = {part.occupancies})"


def _latency(latency: LatencyFigures) -> str:
    if latency.median_ms is None or latency.p99_ms is None:
        return "no samples"
    return f"median {latency.median_ms:.1f} ms, 99 % below {latency.p99_ms:.1f} ms (n = {latency.count})"


def _chosen(row: StepRow) -> str:
    """Return the goal with what is special about the step, short enough for a terminal of 80 columns."""
    if row.missed or row.instead:
        return "missed" if row.missed else row.instead
    return ("→ " if row.switched else "") + escape(row.chosen)


def _text(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else f"{value:{form}}{unit}"
