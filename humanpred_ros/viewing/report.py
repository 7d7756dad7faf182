"""The report of a run: one HTML file that needs nothing else, to read, print, attach and keep."""

from __future__ import annotations

import gc
import inspect
import json
import math
import multiprocessing
import os
import re
import shlex
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from humanpred_ros import __version__
from humanpred_ros.errors import UsageError
from humanpred_ros.resources import replacing
from humanpred_ros.viewing.analysis import Analysis, RunSummary, analyse
from humanpred_ros.viewing.figures import report_style, svg_of, time_axes
from humanpred_ros.viewing.key_figures import key_figures, story
from humanpred_ros.viewing.playback import Recording
from humanpred_ros.viewing.plots_decisions import cost_terms_plot, goal_costs_plot, posterior_plot
from humanpred_ros.viewing.plots_space import snapshots_plot, top_view_plot
from humanpred_ros.viewing.plots_time import clearance_plot, joints_plot, latency_plot, occupancy_plot
from humanpred_ros.viewing.recorded import RecordedDecision
from humanpred_ros.viewing.reliability import reliability_plot
from humanpred_ros.viewing.replay import environment as templates
from humanpred_ros.viewing.replay import replay_data
from humanpred_ros.viewing.run import Run, read_run

_TEMPLATE = "report.html.j2"
#: Facts that are shown in the head of the report; all facts are in its last part.
_HEAD_FACTS = ("scene", "library", "trajectory", "mode", "predictor", "seed")
#: Recorded options of `humanpred demo`, as they are spelt on its command line.
_OPTIONS = (
    "scene", "library", "trajectory", "predictor", "classifier", "evidence", "window-frames", "hold-out", "seed",
)  # fmt: skip


def report_run(folder: str | Path, path: str | Path | None = None, namespace: str | None = None) -> RunSummary:
    """Write the report of the run in a folder, and `summary.json` beside it; return the summary.

    Args:
        folder: of the run.
        path: HTML file to write; `report.html` in the run's folder if None.
        namespace: of the robot; only needed where the bag holds several.

    Raises:
        BagError: there is no complete run.
        UsageError: the files cannot be written there.
    """
    analysis = analyse(read_run(folder, namespace))
    path = Path(folder) / "report.html" if path is None else Path(path)
    write_report(analysis, path, _replay(analysis))
    with replacing(path.with_name("summary.json")) as part:
        part.write_text(analysis.summary.to_json(), encoding="utf-8")
    return analysis.summary


def _replay(analysis: Analysis) -> str:
    """Return the data of the run's replay in 3D; empty where there is nothing to draw, or nowhere to draw it."""
    try:
        return replay_data(Recording(analysis.run, analysis.workcell))
    except UsageError:
        return ""


def write_report(analysis: Analysis, path: Path, replay: str = "") -> None:
    """Write the report of a run as one HTML file; a file of that name is replaced when the new one is complete.

    Args:
        analysis: of the run.
        path: of the file.
        replay: data of `replay_data`; no replay if empty.

    Raises:
        UsageError: the file cannot be written there.
    """
    text = render_report(analysis, replay)
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def render_report(analysis: Analysis, replay: str = "") -> str:
    """Return the report as HTML text; `replay` is data of `replay_data`, none if empty."""
    run, summary = analysis.run, analysis.summary
    environment = templates()
    told = {**run.facts, **({"scene": scene.name} if (scene := analysis.workcell.scene) else {})}
    environment.filters.update(number=_number, cost=_cost)
    plots = draw_plots(analysis)
    with report_style():
        reliability = svg_of(reliability_plot(summary.calibration), "reliability") if summary.calibration else ""
    return environment.get_template(_TEMPLATE).render(
        title=_title(analysis),
        story=story(summary),
        run=run,
        summary=summary,
        figures=key_figures(summary),
        head_facts=[(name, told[name]) for name in _HEAD_FACTS if name in told],
        plots=plots,
        reliability=Markup(reliability),
        calibration=_calibration_rows(summary),
        decisions=list(zip(summary.steps, run.steps, strict=True)),
        told=told_of_goals(run.steps),
        colours=analysis.colours,
        recorded=_recorded(run),
        command=reproduce_command(run),
        version=__version__,
        replay=replay,
    )


def told_of_goals(steps: Sequence[RecordedDecision]) -> dict[str, Any]:
    """Return what replanning steps tell of their goals, by column of the report; bags of earlier versions tell less.

    `terms` are the names of STOMP's cost terms. The others are whether there is a cost of resting at goals, any goal
    with a cost of its own, any plan to another than its goal's preferred configuration, and a margin of any choice.
    """
    goals = [goal for step in steps for goal in step.goals]
    return {
        "terms": tuple(dict.fromkeys(name for goal in goals for name in goal.terms)),
        "rest": any(math.isfinite(goal.rest) for goal in goals),
        "task_cost": any(math.isfinite(goal.task_cost) and goal.task_cost != 0.0 for goal in goals),
        "alternative": any(goal.alternative for goal in goals),
        "margin": any(math.isfinite(step.margin) for step in steps),
    }


class Plot(NamedTuple):
    """One plot: `key` names it in links, `svg` is an element ready to stand in HTML, `axes` is `time_axes` as JSON."""

    key: str
    title: str
    caption: str
    svg: Markup
    axes: str


#: The report's plots by key. Title and caption are the function's docstring; a plot without data says so.
PLOTS: dict[str, Callable[[Analysis], Figure]] = {
    "top-view": top_view_plot,
    "posterior": posterior_plot,
    "goal-costs": goal_costs_plot,
    "cost-terms": cost_terms_plot,
    "predictions": snapshots_plot,
    "clearance": clearance_plot,
    "occupancy": occupancy_plot,
    "joints": joints_plot,
    "latency": latency_plot,
}


def draw_plots(analysis: Analysis) -> list[Plot]:
    """Return the plots of a run; on Linux, half of them are drawn by a second process that begins as a copy of this."""
    keys = list(PLOTS)
    with report_style():
        if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
            return _drawn(keys, analysis)
        context = multiprocessing.get_context("fork")
        receiver, sender = context.Pipe(duplex=False)
        helper = context.Process(target=_send_drawn, args=(sender, keys[1::2], analysis), daemon=True)
        with warnings.catch_warnings():
            # Newer Pythons warn of forks beside threads; the copy only draws, which needs no other thread.
            warnings.simplefilter("ignore", DeprecationWarning)
            helper.start()
        sender.close()
        plots = _drawn(keys[::2], analysis)
        try:
            others = receiver.recv()
        except EOFError:  # it was killed, or what it met is met here again
            others = _drawn(keys[1::2], analysis)
        helper.join()
    return sorted([*plots, *others], key=lambda plot: keys.index(plot.key))


def _send_drawn(sender: Connection, keys: Sequence[str], analysis: Analysis) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the first process, which ends this one
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.disable()  # what a copied process throws away may belong to threads that were not copied
    sender.send(_drawn(keys, analysis))


def _drawn(keys: Sequence[str], analysis: Analysis) -> list[Plot]:
    plots = []
    for key in keys:
        figure = PLOTS[key](analysis)
        # Nothing to draw is a sentence, not a canvas.
        text = str(figure.get_label())
        svg = escape(f"{text[:1].upper()}{text[1:]}.") if text else svg_of(figure, key)
        plots.append(Plot(key, *_told(PLOTS[key]), Markup(svg), json.dumps(time_axes(figure))))
    return plots


def _told(draw: Callable[[Analysis], Figure]) -> tuple[str, str]:
    """Return the title and the caption in a function's docstring."""
    title, _, caption = (inspect.getdoc(draw) or draw.__name__).partition(".\n\n")
    return title.removesuffix("."), " ".join(caption.split())


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


def _title(analysis: Analysis) -> str:
    run, known = analysis.run, analysis.workcell.scene
    name = Path(run.facts["scene"]).stem if run.facts.get("scene") else run.folder.resolve().name
    scene = (name if known is None else known.name).replace("_", " ")
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
