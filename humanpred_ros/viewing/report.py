"""The report of a run: one HTML file that needs nothing else, to read, print, attach and keep."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from humanpred_ros import __version__
from humanpred_ros.errors import UsageError
from humanpred_ros.viewing.clearance import measure_clearance
from humanpred_ros.viewing.figures import goal_colours, report_style, svg_of
from humanpred_ros.viewing.goal_columns import told_of_goals
from humanpred_ros.viewing.plots import draw_plots
from humanpred_ros.viewing.plots_reliability import reliability_plot
from humanpred_ros.viewing.reliability import MOVING
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.run_summary import Belief, Interruption, LatencyFigures, OccupancyCalibration, RunSummary
from humanpred_ros.viewing.workcell import load_workcell

_TEMPLATES = Path(__file__).resolve().parent / "templates"
_TEMPLATE = "report.html.j2"
#: Facts that are shown in the head of the report; all facts are in its last part.
_HEAD_FACTS = ("scene", "library", "trajectory", "mode", "predictor", "seed")
#: Values side by side in one tile.
_MOST_LISTED = 3
#: Recorded options of `humanpred demo`, as they are spelt on its command line.
_OPTIONS = (
    "scene", "library", "trajectory", "predictor", "classifier", "evidence", "window-frames", "hold-out", "seed",
)  # fmt: skip


@dataclass(frozen=True)
class KeyFigure:
    """A figure at the top of the report: what it is, its value with unit, a remark, and whether it is bad news."""

    name: str
    value: str
    remark: str = ""
    alarming: bool = False


def write_report(run: Run, summary: RunSummary, path: str | Path) -> None:
    """Write the report of a run as one HTML file; a file of that name is replaced when the new one is complete.

    Args:
        run, summary: of the same run.
        path: file to write.

    Raises:
        UsageError: the file cannot be written there.
    """
    path = Path(path)
    text = render_report(run, summary)
    temporary = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as trouble:
        temporary.unlink(missing_ok=True)
        raise UsageError(f"report {path}: cannot be written ({trouble.strerror}); choose another place") from trouble


def render_report(run: Run, summary: RunSummary) -> str:
    """Return the report as HTML text."""
    workcell = load_workcell(run)
    plots = draw_plots(run, summary, workcell, measure_clearance(run, workcell))
    with report_style():
        reliability = svg_of(reliability_plot(summary.calibration), "reliability") if summary.calibration else ""
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=_number, cost=_cost)
    return environment.get_template(_TEMPLATE).render(
        title=_title(run),
        run=run,
        summary=summary,
        figures=key_figures(summary),
        head_facts=[(name, run.facts[name]) for name in _HEAD_FACTS if name in run.facts],
        plots=[(plot, Markup(plot.svg)) for plot in plots],
        reliability=Markup(reliability),
        calibration=_calibration_rows(summary),
        decisions=list(zip(summary.steps, run.steps, strict=True)),
        told=told_of_goals(run),
        interruptions=_interruptions(summary),
        colours=goal_colours(dict.fromkeys([*workcell.goals, *summary.goals])),
        recorded=_recorded(run),
        command=reproduce_command(run),
        version=__version__,
    )


def key_figures(summary: RunSummary) -> list[KeyFigure]:
    """Return the figures shown on top, in the order of interest."""
    figures = []
    if summary.reached is not None:
        remark = f"after {summary.reached.t_s:.2f} s; final joint error {1e3 * summary.reached.error_rad:.1f} mrad"
        figures.append(KeyFigure("goal reached", summary.reached.goal, remark))
    else:
        figures.append(KeyFigure("goal reached", "none", "within the recorded time", alarming=True))
    if summary.closest is not None:
        closest = summary.closest
        figures.append(
            KeyFigure(
                "closest to human",
                f"{100.0 * closest.distance_m:.1f} cm",
                f"at {closest.t_s:.2f} s, {closest.robot_link} – {closest.human_body}",
                alarming=closest.distance_m <= 0.0,
            )
        )
    else:
        figures.append(KeyFigure("closest to human", "–", "not known"))
    figures.append(_switch_figure(summary))
    figures.append(_recognition_figure(summary))
    if any(belief.unknown_max > 0.0 for belief in summary.beliefs):
        figures.append(_unknown_figure(summary.beliefs))
    figures += [_calibration_figure(part) for name, part in summary.calibration.items() if name == MOVING]
    figures.append(_steps_figure(summary))
    for name, latency in summary.latency.items():
        figures.append(_latency_figure(name, latency))
    figures.append(_latency_figure("planning one step", summary.planning))
    if summary.peak_velocity is not None:
        figures.append(
            KeyFigure(
                "fastest joint",
                f"{100.0 * summary.peak_velocity:.0f} %",
                "of its velocity limit",
                alarming=summary.peak_velocity > 1.0 + 1e-6,
            )
        )
    return figures


def reproduce_command(run: Run) -> str:
    """Return the command that repeats the run, as far as the recorded facts tell."""
    parts = ["humanpred", "demo"]
    for option in _OPTIONS:
        value = run.facts.get(option.replace("-", "_"))
        if value:
            parts += [f"--{option}", value]
    if run.facts.get("detect_onsets") == "False":
        parts += ["--no-onsets"]
    if (run.folder / "model.npz").is_file():
        parts += ["--model", str(run.folder / "model.npz")]
    if run.facts.get("mode") == "real_time":
        parts += ["--real-time", run.facts.get("rate") or "1.0"]
    return shlex.join(parts)


def _switch_figure(summary: RunSummary) -> KeyFigure:
    if not summary.switches:
        chosen = next((row.chosen for row in summary.steps if row.chosen), "")
        return KeyFigure("switch of goal", "none", f"{chosen} chosen throughout" if chosen else "no goal was chosen")
    first = summary.switches[0]
    share = "" if first.percent is None else f" at {first.percent:.0f} % of the reach"
    more = f"; {len(summary.switches)} switches in all" if len(summary.switches) > 1 else ""
    return KeyFigure(
        "switch of goal",
        f"step {first.step}",
        f"{first.goal_before} to {first.goal_after}{share}, in effect in step {first.step_in_effect}{more}",
    )


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
    return KeyFigure(
        "calibration error of the occupancy",
        "–" if part.error is None else f"{part.error:.2f}",
        f"mean of |predicted – observed|; {missed}",
    )


def _calibration_rows(summary: RunSummary) -> list[tuple[str, list[str]]]:
    """Return the lines of the calibration table: a title and one cell per part of the run."""
    parts = summary.calibration.values()
    return [
        ("occupancies compared", [str(part.occupancies) for part in parts]),
        ("calibration error", [_number(part.error, 3) for part in parts]),
        ("swept voxels given less than 1 %", [_percent(part.missed, 1) for part in parts]),
        ("voxels expected (sum of probabilities)", [_number(part.expected_voxels, 0) for part in parts]),
        ("voxels really swept", [_number(part.swept_voxels, 0) for part in parts]),
        ("squared error, in voxels", [_number(part.squared_error, 0) for part in parts]),
        ("the same with the current posture only", [_number(part.squared_error_current, 0) for part in parts]),
    ]


def _steps_figure(summary: RunSummary) -> KeyFigure:
    remark = f"{len(summary.holds)} hold{'s' if len(summary.holds) != 1 else ''}" if summary.holds else "no hold"
    if summary.evasions:
        remark += f"; moved out of the person's way {_times(len(summary.evasions))}"
    value = f"{summary.missed} of {len(summary.steps)} missed" if summary.missed else str(len(summary.steps))
    return KeyFigure("replanning steps", value, remark, alarming=bool(summary.missed or summary.holds))


def _interruptions(summary: RunSummary) -> list[tuple[str, Interruption]]:
    """Return when the arm worked on no goal, with what it did instead, in time order."""
    both = [("stops", hold) for hold in summary.holds] + [("moves aside", evasion) for evasion in summary.evasions]
    return sorted(both, key=lambda entry: entry[1].t_s)


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def _latency_figure(name: str, latency: LatencyFigures) -> KeyFigure:
    if latency.median_ms is None or latency.p99_ms is None:
        return KeyFigure(name, "–", "no samples")
    remark = f"median of {latency.count}; 99 % below {latency.p99_ms:.1f} ms"
    return KeyFigure(name, f"{latency.median_ms:.1f} ms", remark)


def _title(run: Run) -> str:
    scene = Path(run.facts["scene"]).stem.replace("_", " ") if run.facts.get("scene") else run.folder.resolve().name
    trajectory = run.facts.get("trajectory")
    return f"{scene[:1].upper()}{scene[1:]}" + (f", reach {trajectory}" if trajectory else "")


def _recorded(run: Run) -> str:
    """Return when the run was recorded; empty for a bag without messages."""
    if not run.recorded_ns:
        return ""
    return datetime.fromtimestamp(run.recorded_ns * 1e-9, tz=timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")


def _number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """Return a number for people; a dash where there is none."""
    return "–" if value is None or value != value else f"{value:.{digits}f}{unit}"


def _percent(value: float | None, digits: int = 0) -> str:
    return _number(None if value is None else 100.0 * value, digits, " %")


def _cost(value: float | None) -> str:
    """Return a cost with three significant digits; powers of ten only where they save space."""
    if value is None or value != value:
        return "–"
    text = f"{value:#.3g}" if value else "0"
    return re.sub(r"e([+-])0*(\d)", r"e\1\2", text.removesuffix("."))
