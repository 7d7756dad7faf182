"""The key figures of a run in words: one list that the terminal and the report show."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from humanpred_ros.errors import printable
from humanpred_ros.viewing.analysis import Belief, RunSummary, StepRow, Switch
from humanpred_ros.viewing.figures import class_title
from humanpred_ros.viewing.recorded import LatencyFigures
from humanpred_ros.viewing.reliability import MOVING

#: Values of one figure that are listed.
_MOST_LISTED = 3


class KeyFigure(NamedTuple):
    """A figure of a run: what it is, its value with unit, a remark, and whether it is bad news."""

    name: str
    value: str
    remark: str = ""
    alarming: bool = False


#: What is said of a figure: value, remark, and perhaps whether it is bad news; None where it is left out.
_Said = tuple[str, str] | tuple[str, str, bool] | None


def key_figures(summary: RunSummary) -> list[KeyFigure]:
    """Return the figures of a run in the order of interest."""
    figures: list[tuple[str, _Said]] = [(name, say(summary)) for name, say in _FIGURES.items()]
    figures += [(name, _latency(latency)) for name, latency in summary.latency.items()]
    figures += [("planning one step", _latency(summary.planning)), ("fastest joint", _peak_velocity(summary))]
    return [KeyFigure(name, *said) for name, said in figures if said is not None]


def story(summary: RunSummary) -> str:
    """Return in a sentence or two what happened: what the person reached for, what the arm did, and how it ended."""
    parts = []
    known = summary.recognised
    if known is not None and known.t_s is not None:
        parts.append(f"The person reached for {class_title(known.true_class)}, most probable from {known.t_s:.2f} s on")
    elif summary.beliefs:
        last = summary.beliefs[-1]
        what = "nothing that was learned" if last.rather_unknown else class_title(last.best_class)
        parts.append(f"The person reached, it seems, for {what}")
    if summary.switches:
        turns = [_turn(switch) for switch in summary.switches[:_MOST_LISTED]]
        more = f" and {len(summary.switches) - _MOST_LISTED} times more" if len(summary.switches) > _MOST_LISTED else ""
        parts.append(
            f"the arm, on its way to {summary.switches[0].goal_before}, turned to {', then to '.join(turns)}{more}"
        )
    elif chosen := next((row.chosen for row in summary.steps if row.chosen), ""):
        parts.append(f"the arm worked on {chosen} throughout")
    held = [f"{len(found)} times" if len(found) > 1 else "once" for found in (summary.holds,) if found]
    if held:
        reason = re.split(r"[:;(]", summary.holds[0].reason, maxsplit=1)[0].strip()
        parts.append(f"it stopped {held[0]} ({reason}{' first' if len(summary.holds) > 1 else ''})")
    told = f"{'; '.join(parts)}. " if parts else ""
    return f"{told[:1].upper()}{told[1:]}{summary.outcome}"


def _turn(switch: Switch) -> str:
    share = "" if switch.percent is None else f", {switch.percent:.0f} % of the reach"
    return f"{switch.goal_after} after {switch.t_s:.2f} s{share}"


def print_summary(summary: RunSummary, console: Console) -> None:
    """Print the replanning steps and the key figures of a run."""
    if summary.steps:
        console.print(_steps_table(summary))
    if any(row.out for row in summary.steps):
        console.print("× set aside or invalid in this step: the report says why\n", style="dim")
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="dim")
    table.add_column()
    for figure in key_figures(summary):
        text = Text.assemble(
            printable(figure.value), "  ", (printable(figure.remark), "dim"), style="red" if figure.alarming else ""
        )
        table.add_row(Text(figure.name), text)
    for what, part in summary.interruptions:
        table.add_row(f"arm {what}", Text(f"{part.t_s:.2f} to {part.until_s:.2f} s: {printable(part.reason)}"))
    table.add_row("duration", f"{summary.duration_s:.2f} s of data, {summary.wall_s:.1f} s of wall time")
    console.print(table)
    for note in summary.notes:
        console.print(Text.assemble(("note", "yellow"), "  ", printable(note)))
    console.print(Text(printable(story(summary)), "bold"))


def _steps_table(summary: RunSummary) -> Table:
    table = Table(
        title="replanning steps and the cost of every goal", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False
    )
    table.title_justify = "left"
    for name in ("step", "t in\ns", "reach", "class\np"):
        table.add_column(name, justify="right")
    for goal in summary.goals:
        table.add_column(Text(printable(goal)), justify="right", min_width=7)
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
        table.add_row(
            *map(Text, map(printable, cells)), style="red" if row.missed else "bold" if row.switched else None
        )
    return table


def _chosen(row: StepRow) -> str:
    """Return the goal with what is special about the step, short enough for a terminal of 80 columns."""
    return row.lost_to or ("→ " if row.switched else "") + row.chosen


def _text(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else f"{value:{form}}{unit}"


def _reached(summary: RunSummary) -> _Said:
    reached = summary.reached
    if reached is None:
        return "none", "within the recorded time", True
    return reached.goal, f"after {reached.t_s:.2f} s; final joint error {1e3 * reached.error_rad:.1f} mrad"


def _closest(summary: RunSummary) -> _Said:
    closest = summary.closest
    if closest is None:
        return "–", "not known"
    remark = f"at {closest.t_s:.2f} s, {closest.robot_link} – {closest.human_body}"
    return f"{100.0 * closest.distance_m:.1f} cm", remark, closest.distance_m <= 0.0


def _switch(summary: RunSummary) -> _Said:
    if not summary.switches:
        chosen = next((row.chosen for row in summary.steps if row.chosen), "")
        return "none", f"{chosen} chosen throughout" if chosen else "no goal was chosen"
    first = summary.switches[0]
    share = "" if first.percent is None else f" at {first.percent:.0f} % of the reach"
    more = f"; {len(summary.switches)} switches in all" if len(summary.switches) > 1 else ""
    remark = f"{first.goal_before} to {first.goal_after}{share}, in effect in step {first.step_in_effect}{more}"
    return f"step {first.step}", remark


def _recognition(summary: RunSummary) -> _Said:
    recognised, beliefs = summary.recognised, summary.beliefs
    if recognised is None and beliefs:
        found = ["none" if belief.rather_unknown else class_title(belief.best_class) for belief in beliefs]
        return _listed(found), f"most probable {_at_the_end(beliefs)}; the true class is not known"
    if recognised is None:
        return "–", "no posterior was recorded that tells classes apart"
    if recognised.t_s is None:
        return "no", f"true {class_title(recognised.true_class)}", True
    share = f"{recognised.t_s:.2f} s" if recognised.percent is None else f"at {recognised.percent:.0f} %"
    return share, f"{class_title(recognised.true_class)}, most probable from {recognised.t_s:.2f} s on"


def _unknown(summary: RunSummary) -> _Said:
    beliefs = summary.beliefs
    most = max(beliefs, key=lambda belief: belief.unknown_max, default=None)
    if most is None or most.unknown_max <= 0.0:
        return None
    remark = f"{_at_the_end(beliefs)}; at most {100.0 * most.unknown_max:.0f} % at {most.unknown_max_s:.2f} s"
    listed = _listed([f"{100.0 * belief.unknown:.0f} %" for belief in beliefs])
    return listed, remark, any(belief.rather_unknown for belief in beliefs)


def _at_the_end(beliefs: Sequence[Belief]) -> str:
    return "at the end of the movement" if len(beliefs) == 1 else f"at the end of each of {len(beliefs)} movements"


def _listed(texts: Sequence[str]) -> str:
    """Return values as a list that fits a tile."""
    return ", ".join(texts[:_MOST_LISTED]) + (", …" if len(texts) > _MOST_LISTED else "")


def _calibration(summary: RunSummary) -> _Said:
    part = summary.calibration.get(MOVING)
    if part is None:
        return None
    missed = "nothing was swept" if part.missed is None else f"{100.0 * part.missed:.1f} % of the swept voxels missed"
    return _text(part.error, ".2f"), f"mean of |predicted – observed|; {missed}"


def _steps(summary: RunSummary) -> _Said:
    holds, evasions = len(summary.holds), len(summary.evasions)
    remark = f"{holds} hold{'s' if holds != 1 else ''}" if holds else "no hold"
    if evasions:
        times = {1: "once", 2: "twice"}.get(evasions, f"{evasions} times")
        remark += f"; moved out of the person's way {times}"
    value = f"{summary.missed} of {len(summary.steps)} missed" if summary.missed else str(len(summary.steps))
    return value, remark, bool(summary.missed or holds)


def _latency(latency: LatencyFigures) -> _Said:
    if latency.median_ms is None:
        return "–", "no samples"
    return f"{latency.median_ms:.1f} ms", f"median of {latency.count}; 99 % below {latency.p99_ms:.1f} ms"


def _peak_velocity(summary: RunSummary) -> _Said:
    share = summary.peak_velocity
    return None if share is None else (f"{100.0 * share:.0f} %", "of its velocity limit", share > 1.0 + 1e-6)


#: The figures that every run has, as far as they are known.
_FIGURES: dict[str, Callable[[RunSummary], _Said]] = {
    "goal reached": _reached,
    "closest to human": _closest,
    "switch of goal": _switch,
    "reach recognised": _recognition,
    "probability of no known class": _unknown,
    "calibration error of the occupancy": _calibration,
    "replanning steps": _steps,
}
