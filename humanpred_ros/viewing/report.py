"""The report of a run: one HTML file that needs nothing else, to read, print, attach and keep."""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from humanpred_ros import __version__
from humanpred_ros.errors import UsageError
from humanpred_ros.viewing.clearance import measure_clearance
from humanpred_ros.viewing.figures import goal_colours
from humanpred_ros.viewing.plots import draw_plots
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.run_summary import LatencyFigures, RunSummary
from humanpred_ros.viewing.workcell import load_workcell

_TEMPLATES = Path(__file__).resolve().parent / "templates"
_TEMPLATE = "report.html.j2"
#: Facts that are shown in the head of the report; all facts are in its last part.
_HEAD_FACTS = ("scene", "library", "trajectory", "mode", "predictor", "seed")
#: Recorded options of `humanpred demo`, as they are spelt on its command line.
_OPTIONS = ("scene", "library", "trajectory", "predictor", "evidence", "window-frames", "hold-out", "seed")


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
        decisions=list(zip(summary.steps, run.steps, strict=True)),
        reasons=any(step.reason for step in run.steps),
        terms=tuple(dict.fromkeys(name for step in run.steps for goal in step.goals for name in goal.terms)),
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
    figures += [_recognition_figure(summary), _steps_figure(summary)]
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
    recognised = summary.recognised
    if recognised is None:
        return KeyFigure("reach recognised", "–", "the true class or the posterior is not known")
    if recognised.t_s is None:
        return KeyFigure("reach recognised", "no", f"true class {recognised.true_class}", alarming=True)
    share = f"{recognised.t_s:.2f} s" if recognised.percent is None else f"at {recognised.percent:.0f} %"
    remark = f"class {recognised.true_class}, most probable from {recognised.t_s:.2f} s on"
    return KeyFigure("reach recognised", share, remark)


def _steps_figure(summary: RunSummary) -> KeyFigure:
    holds = f"{len(summary.holds)} hold{'s' if len(summary.holds) != 1 else ''}" if summary.holds else "no hold"
    value = f"{summary.missed} of {len(summary.steps)} missed" if summary.missed else str(len(summary.steps))
    return KeyFigure("replanning steps", value, holds, alarming=bool(summary.missed or summary.holds))


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


def _cost(value: float | None) -> str:
    """Return a cost with three significant digits; powers of ten only where they save space."""
    if value is None or value != value:
        return "–"
    text = f"{value:#.3g}" if value else "0"
    return re.sub(r"e([+-])0*(\d)", r"e\1\2", text.removesuffix("."))
