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
from humanpred_ros.viewing import figures as look
from humanpred_ros.viewing.analysis import Analysis, RunSummary
from humanpred_ros.viewing.plots_time import mark_events

#: Classes that never reach this probability share the legend's last entry.
_NEVER_LIKELY = 0.05
#: Below the smallest positive cost by this factor a logarithmic axis turns linear, to show zeros.
_LINEAR_BELOW = 2.0
_MOST_TICKS = 6
#: Steps in which the arm is not sent to a goal: colour, how strong, and what the legend says.
_SHADED = {
    "missed": (look.ALARM, 0.10, "step missed"),
    "hold": (look.INK, 0.12, "arm stops"),
    "evade": (look.CAUTION, 0.18, "arm moves aside"),
}


def posterior_plot(analysis: Analysis) -> Figure:
    """What the human is believed to do.

    Probability of each class of reach given the part of the motion seen so far; hatched, if the classifier considers
    it, the probability that the motion belongs to none of them. Where all are equal, the human is taken to be at rest.
    """
    track, summary = analysis.run.posterior, analysis.summary
    if not len(track):
        return look.empty_figure("no class posterior was recorded")
    figure, axes = look.new_panel(3.1)
    hidden = []
    for k, label in enumerate(track.labels):
        column = track.probability[:, k]
        if column.max() < _NEVER_LIKELY:
            hidden.append(str(label))
            continue
        true = summary.recognised is not None and summary.recognised.true_class == label
        style = look.class_style(k) | ({"linewidth": 2.6} if true else {})
        axes.plot(track.t_s, column, drawstyle="steps-post", label=look.class_title(label) + " (true)" * true, **style)
    if track.unknown.any():
        # An area, where the classes are lines: it is what they leave.
        axes.fill_between(
            track.t_s, track.unknown, step="post", facecolor=look.WASH, edgecolor=look.MUTED, hatch="////",
            linewidth=0.0, label="no known class", zorder=1.1,
        )  # fmt: skip
        axes.plot(track.t_s, track.unknown, drawstyle="steps-post", color=look.INK, linewidth=1.1, zorder=1.2)
    if hidden:
        axes.plot([], [], color="none", label=f"never above {_NEVER_LIKELY:.0%}:\n{', '.join(hidden)}")
    axes.set_ylim(-0.02, 1.02)
    axes.set_ylabel("probability")
    mark_events(axes, analysis)
    look.legend_beside(axes)
    return figure


def goal_costs_plot(analysis: Analysis) -> Figure:
    """Cost of every goal.

    What goals are compared by, at every replanning step (compare with P1 Fig. 9). Hollow: set aside, so the cheapest
    goal need not be the chosen one; the table of decisions says why. A decision takes effect one step after it was
    computed (P1 Fig. 4).
    """
    run, summary, colours = analysis.run, analysis.summary, analysis.colours
    if not summary.steps:
        return look.empty_figure("no replanning step was recorded")
    figure, axes = look.new_panel(3.6)
    number = np.array([row.step for row in summary.steps])
    costs = {goal: _column([row.costs.get(goal) for row in summary.steps]) for goal in summary.goals}
    _log_scale(axes, np.concatenate(list(costs.values())))
    for k, (goal, cost) in enumerate(costs.items()):
        style = {"color": colours[goal], "linestyle": look.DASHES[k % len(look.DASHES)]}
        axes.plot(number, cost, marker=look.MARKERS[k % len(look.MARKERS)], markersize=4.5, label=goal, **style)
        chosen = np.array([row.chosen == goal and not row.lost_to for row in summary.steps])
        axes.plot(
            number[chosen], cost[chosen], marker="o", markersize=11, linestyle="none",
            markerfacecolor="none", markeredgecolor=colours[goal], markeredgewidth=1.4,
        )  # fmt: skip
        plans = [(decision.step, plan) for decision in run.steps for plan in decision.goals if plan.name == goal]
        for step, plan in plans:
            priced = np.isfinite(plan.selection_cost)
            if plan.set_aside and priced:
                axes.plot(
                    [step], [plan.selection_cost], marker=look.MARKERS[k % len(look.MARKERS)], markersize=4.5, zorder=3,
                    markerfacecolor="white", markeredgecolor=colours[goal],
                )  # fmt: skip
            elif not plan.valid:  # without a cost the mark goes to the upper edge
                axes.plot(
                    [step], [plan.selection_cost if priced else 0.97 - 0.06 * k], marker="x", color=look.ALARM,
                    markersize=9, markeredgewidth=1.8, zorder=4,
                    transform=axes.transData if priced else axes.get_xaxis_transform(),
                )  # fmt: skip
    for switch in summary.switches:
        axes.axvline(switch.step, color=look.INK, linewidth=1.0, alpha=0.6, zorder=0)
        look.label_above(axes, switch.step, f"switch to {switch.goal_after}", look.INK, align="center")
    for row in summary.steps:
        if row.lost_to:
            colour, strength, _ = _SHADED[row.lost_to]
            axes.axvspan(row.step - 0.5, row.step + 0.5, color=colour, alpha=strength, linewidth=0)
    axes.set_ylabel("selection cost")
    _step_axis(axes, summary)
    handles, _ = axes.get_legend_handles_labels()
    handles.append(_key(marker="o", markersize=9, markerfacecolor="none", color=look.MUTED, label="chosen"))
    everything = [plan for decision in run.steps for plan in decision.goals]
    if any(plan.set_aside for plan in everything):
        handles.append(_key(marker="o", markersize=4.5, markerfacecolor="white", color=look.MUTED, label="set aside"))
    if any(not plan.eligible and not plan.set_aside for plan in everything):
        handles.append(_key(marker="x", markersize=8, markeredgewidth=1.8, color=look.ALARM, label="plan invalid"))
    actions = {row.lost_to for row in summary.steps}
    for action, (colour, strength, text) in _SHADED.items():
        if action in actions:
            handles.append(_key(marker="s", markersize=9, color=colour, alpha=2.0 * strength, label=text))
    look.legend_beside(axes, handles=handles)
    return figure


def cost_terms_plot(analysis: Analysis) -> Figure:
    """What the chosen plan costs.

    What STOMP minimised: terms of the cost of the chosen goal's plan at every replanning step.
    """
    run, summary, colours = analysis.run, analysis.summary, analysis.colours
    plans = [decision.plan_of_chosen for decision in run.steps]
    names = tuple(dict.fromkeys(name for plan in plans if plan is not None for name in plan.terms))
    if not names:
        return look.empty_figure("no cost terms were recorded")
    figure, axes = look.new_panel(3.2)
    number = np.array([row.step for row in summary.steps])
    terms = {name: _column([plan.terms.get(name) if plan else None for plan in plans]) for name in names}
    zero = [name.replace("_", " ") for name, cost in terms.items() if not np.nan_to_num(cost).any()]
    terms = {name: cost for name, cost in terms.items() if np.nan_to_num(cost).any()}
    _log_scale(axes, np.concatenate([*terms.values(), np.zeros(0)]))
    for k, (name, cost) in enumerate(terms.items()):
        axes.plot(
            number, cost, marker=look.MARKERS[k % len(look.MARKERS)], markersize=4.5,
            color=(look.INK, look.MUTED)[k % 2], linestyle=look.DASHES[k % len(look.DASHES)],
            label=name.replace("_", " "),
        )  # fmt: skip
    if zero:
        axes.plot([], [], color="none", label="always zero:\n" + "\n".join(zero))
    axes.set_ylabel("cost of the chosen plan")
    _step_axis(axes, summary)
    _goal_strip(axes, summary, colours)
    look.legend_beside(axes)
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
        look.plain_powers(axes.yaxis)
    else:
        least = float(positive.min())
        axes.set_yscale("symlog", linthresh=least / _LINEAR_BELOW, linscale=0.4)
        look.plain_powers(axes.yaxis)
        # Within the linear part there is room for the zero alone.
        powers = np.arange(np.ceil(np.log10(least)), np.floor(np.log10(float(positive.max()))) + 1.0)
        axes.set_yticks([0.0, *10.0 ** powers[:: max(1, len(powers) // _MOST_TICKS)]])
        axes.set_yticks([], minor=True)
        axes.axhline(0.0, color=look.MUTED, linewidth=0.8)


def _step_axis(axes: Axes, summary: RunSummary) -> None:
    """Number the steps below, and say above how much of the human's motion was over."""
    first, last = summary.steps[0].step, summary.steps[-1].step
    axes.set_xlim(first - 0.6, last + 0.6)
    axes.set_xlabel("replanning step")
    axes.set_label(look.STEP)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=24, min_n_ticks=1))
    moving = [row for row in summary.steps if row.percent is not None and row.percent < 100.0]
    if moving and len(moving) < len(summary.steps):
        axes.axvline(moving[-1].step + 0.5, color=look.MUTED, linewidth=1.0, linestyle=":")
        look.label_above(axes, moving[-1].step + 0.5, "human at rest", look.MUTED)


def _goal_strip(axes: Axes, summary: RunSummary, colours: Mapping[str, str]) -> None:
    """Draw along the top which goal was worked on, or what the arm did instead; a missed step leaves it at that."""
    for (instead, goal), stretch in groupby(summary.steps, key=lambda row: (row.instead, row.instead or row.chosen)):
        if not instead and goal not in colours:
            continue
        colour = _SHADED[instead][0] if instead else colours[goal]
        steps = [row.step for row in stretch]
        axes.axvspan(steps[0] - 0.5, steps[-1] + 0.5, 1.0, 1.03, color=colour, linewidth=0, clip_on=False)
        if not instead:
            look.label_above(axes, steps[0] - 0.5, f"{goal} chosen", colour)
