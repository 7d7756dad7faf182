"""Plots of what the system believed and decided: class posterior, cost of every goal, terms of the chosen plan."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import (
    ALARM,
    CAUTION,
    DASHES,
    INK,
    MARKERS,
    MUTED,
    SERIES,
    WASH,
    class_style,
    empty_figure,
    new_figure,
)
from humanpred_ros.viewing.plots_time import mark_events
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.run_summary import RunSummary, StepRow

#: Classes that never reach this probability share the legend's last entry.
_NEVER_LIKELY = 0.05
#: Below the smallest positive cost by this factor a logarithmic axis turns linear, to show zeros.
_LINEAR_BELOW = 2.0
#: Steps in which the arm is not sent to a goal: colour, how strong, and what the legend says.
_SHADED = {
    "missed": (ALARM, 0.10, "step missed"),
    "hold": (INK, 0.12, "arm stops"),
    "evade": (CAUTION, 0.18, "arm moves aside"),
}


def posterior_plot(run: Run, summary: RunSummary, colours: Mapping[str, str]) -> Figure:
    """Return the class posterior over time."""
    track = run.posterior
    if not len(track):
        return empty_figure("no class posterior was recorded")
    figure = new_figure(3.1)
    axes = figure.add_subplot()
    hidden = []
    for k, label in enumerate(track.labels):
        column = track.probability[:, k]
        if column.max() < _NEVER_LIKELY:
            hidden.append(str(label))
            continue
        true = summary.recognised is not None and summary.recognised.true_class == label
        style = class_style(k) | ({"linewidth": 2.6} if true else {})
        axes.plot(track.t_s, column, drawstyle="steps-post", label=f"class {label}{' (true)' * true}", **style)
    if track.unknown.any():
        # An area, where the classes are lines: it is what they leave.
        axes.fill_between(
            track.t_s, track.unknown, step="post", facecolor=WASH, edgecolor=MUTED, hatch="////", linewidth=0.0,
            label="no known class", zorder=1.1,
        )  # fmt: skip
        axes.plot(track.t_s, track.unknown, drawstyle="steps-post", color=INK, linewidth=1.1, zorder=1.2)
    if hidden:
        axes.plot([], [], color="none", label=f"never above {_NEVER_LIKELY:.0%}:\n{', '.join(hidden)}")
    axes.set_ylim(-0.02, 1.02)
    axes.set_ylabel("probability")
    mark_events(axes, run, summary, colours)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def goal_costs_plot(run: Run, summary: RunSummary, colours: Mapping[str, str]) -> Figure:
    """Return the selection cost of every goal at every replanning step, as in P1 Fig. 9."""
    if not summary.steps:
        return empty_figure("no replanning step was recorded")
    figure = new_figure(3.6)
    axes = figure.add_subplot()
    number = np.array([row.step for row in summary.steps])
    costs = {goal: _column([row.costs.get(goal) for row in summary.steps]) for goal in summary.goals}
    _log_scale(axes, np.concatenate(list(costs.values())))
    for k, (goal, cost) in enumerate(costs.items()):
        style = {"color": colours[goal], "linestyle": DASHES[k % len(DASHES)]}
        axes.plot(number, cost, marker=MARKERS[k % len(MARKERS)], markersize=4.5, label=goal, **style)
        chosen = np.array([row.chosen == goal and row.effective for row in summary.steps])
        axes.plot(
            number[chosen], cost[chosen], marker="o", markersize=11, linestyle="none",
            markerfacecolor="none", markeredgecolor=colours[goal], markeredgewidth=1.4,
        )  # fmt: skip
        for step, decision in zip(number, run.steps, strict=True):
            plan = next((plan for plan in decision.goals if plan.name == goal), None)
            if plan is not None and plan.set_aside and np.isfinite(plan.selection_cost):
                axes.plot(
                    [step], [plan.selection_cost], marker=MARKERS[k % len(MARKERS)], markersize=4.5, zorder=3,
                    markerfacecolor="white", markeredgecolor=colours[goal],
                )  # fmt: skip
            elif plan is not None and not plan.valid:
                priced = np.isfinite(plan.selection_cost)  # without a cost the mark goes to the upper edge
                axes.plot(
                    [step], [plan.selection_cost if priced else 0.97 - 0.06 * k], marker="x", color=ALARM, markersize=9,
                    markeredgewidth=1.8, transform=axes.transData if priced else axes.get_xaxis_transform(), zorder=4,
                )  # fmt: skip
    for switch in summary.switches:
        axes.axvline(switch.step, color=colours.get(switch.goal_after, INK), linewidth=1.0, alpha=0.6, zorder=0)
        axes.annotate(
            f"switch to {switch.goal_after}", (switch.step, 1.04), xycoords=("data", "axes fraction"),
            ha="center", va="bottom", fontsize=8, color=colours.get(switch.goal_after, INK),
        )  # fmt: skip
    for row in summary.steps:
        if _lost_to(row):
            colour, strength, _ = _SHADED[_lost_to(row)]
            axes.axvspan(row.step - 0.5, row.step + 0.5, color=colour, alpha=strength, linewidth=0)
    axes.set_ylabel("selection cost")
    _step_axis(axes, summary)
    handles, _ = axes.get_legend_handles_labels()
    handles.append(_key(marker="o", markersize=9, markerfacecolor="none", color=MUTED, label="chosen"))
    plans = [plan for decision in run.steps for plan in decision.goals]
    if any(plan.set_aside for plan in plans):
        handles.append(_key(marker="o", markersize=4.5, markerfacecolor="white", color=MUTED, label="set aside"))
    if any(not plan.eligible and not plan.set_aside for plan in plans):
        handles.append(_key(marker="x", markersize=8, markeredgewidth=1.8, color=ALARM, label="plan invalid"))
    actions = {_lost_to(row) for row in summary.steps}
    for action, (colour, strength, text) in _SHADED.items():
        if action in actions:
            handles.append(_key(marker="s", markersize=9, color=colour, alpha=2.0 * strength, label=text))
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def cost_terms_plot(run: Run, summary: RunSummary, colours: Mapping[str, str]) -> Figure:
    """Return the cost terms of the chosen goal's plan at every replanning step."""
    plans = [decision.plan_of_chosen for decision in run.steps]
    names = tuple(dict.fromkeys(name for plan in plans if plan is not None for name in plan.terms))
    if not names:
        return empty_figure("no cost terms were recorded")
    figure = new_figure(3.2)
    axes = figure.add_subplot()
    number = np.array([row.step for row in summary.steps])
    terms = {name: _column([plan.terms.get(name) if plan else None for plan in plans]) for name in names}
    zero = [name.replace("_", " ") for name, cost in terms.items() if not np.nan_to_num(cost).any()]
    terms = {name: cost for name, cost in terms.items() if np.nan_to_num(cost).any()}
    _log_scale(axes, np.concatenate([*terms.values(), np.zeros(0)]))
    for k, (name, cost) in enumerate(terms.items()):
        axes.plot(
            number, cost, marker=MARKERS[k % len(MARKERS)], markersize=4.5, color=SERIES[k % len(SERIES)],
            linestyle=DASHES[(k // len(SERIES)) % len(DASHES)], label=name.replace("_", " "),
        )  # fmt: skip
    if zero:
        axes.plot([], [], color="none", label="always zero:\n" + "\n".join(zero))
    axes.set_ylabel("cost of the chosen plan")
    _step_axis(axes, summary)
    _goal_strip(axes, summary, colours)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _column(values: list[float | None]) -> FloatArray:
    return np.array(
        [value if value is not None and np.isfinite(value) else np.nan for value in values], dtype=np.float64
    )


def _key(**style: object) -> Line2D:
    return Line2D([], [], linestyle="none", **style)  # type: ignore[arg-type]


def _log_scale(axes: Axes, values: FloatArray) -> None:
    """Make the y axis logarithmic; where values reach zero, linear close to it."""
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0.0]
    if not len(positive):
        return
    if len(positive) == len(finite):
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=float(positive.min()) / _LINEAR_BELOW, linscale=0.4)
        axes.axhline(0.0, color=MUTED, linewidth=0.8)


def _step_axis(axes: Axes, summary: RunSummary) -> None:
    """Number the steps below, and say above how much of the human's motion was over."""
    first, last = summary.steps[0].step, summary.steps[-1].step
    axes.set_xlim(first - 0.6, last + 0.6)
    axes.set_xlabel("replanning step")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=24, min_n_ticks=1))
    moving = [row for row in summary.steps if row.percent is not None and row.percent < 100.0]
    if moving and len(moving) < len(summary.steps):
        axes.axvline(moving[-1].step + 0.5, color=MUTED, linewidth=1.0, linestyle=":")
        axes.annotate(
            "human at rest", (moving[-1].step + 0.5, 1.04), xycoords=("data", "axes fraction"),
            ha="left", va="bottom", fontsize=8, color=MUTED,
        )  # fmt: skip


def _lost_to(row: StepRow) -> str:
    """Return why a step did not send the arm to a goal, as in `_SHADED`; empty if it did."""
    return "missed" if row.missed else row.instead


def _doing(row: StepRow) -> tuple[str, str]:
    """Return the goal worked on, or what the arm did instead; a missed step leaves it at what it did."""
    return ("", row.instead) if row.instead else (row.chosen, "")


def _goal_strip(axes: Axes, summary: RunSummary, colours: Mapping[str, str]) -> None:
    """Draw which goal was chosen as a strip of colour along the top."""
    for (goal, what), stretch in groupby(summary.steps, key=_doing):
        steps = [row.step for row in stretch]
        if what:
            axes.axvspan(steps[0] - 0.5, steps[-1] + 0.5, 1.0, 1.03, color=_SHADED[what][0], linewidth=0, clip_on=False)
        if what or goal not in colours:
            continue
        axes.axvspan(steps[0] - 0.5, steps[-1] + 0.5, 1.0, 1.03, color=colours[goal], linewidth=0, clip_on=False)
        axes.annotate(
            f"{goal} chosen", (steps[0] - 0.5, 1.04), xycoords=("data", "axes fraction"),
            ha="left", va="bottom", fontsize=8, color=colours[goal],
        )  # fmt: skip
