"""Plots of what happened over time: distance, occupancy volume, joint motion, and how long the computers took."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing import figures as look
from humanpred_ros.viewing.analysis import Analysis
from humanpred_ros.viewing.recorded import LatencyFigures

_MAX_BINS = 40
#: Delays of more than so many medians are told instead of drawn, if no larger share of all are.
_FAR, _MOST_FAR = 4.0, 0.06
_JOINT_ROW_IN = 0.98
#: Least span of a joint's axes: a joint at rest looks at rest.
_LEAST_SPAN = 0.2
_LITRES_PER_M3 = 1000.0
#: Labels closer than this share of the axis are stacked.
_LABEL_SHARE = 0.13
_LINE_HEIGHT = 0.065


def clearance_plot(analysis: Analysis) -> Figure:
    """Distance between robot and human.

    Least distance between the robot's collision spheres and the human's body at equal data time. The spheres contain
    the arm from the upper arm on, so the true distance is never smaller.
    """
    clearance, closest = analysis.clearance, analysis.summary.closest
    if closest is None:
        return look.empty_figure("the distance is not known")
    figure, axes = look.new_panel(2.9)
    distance_cm = 100.0 * clearance.distance_m
    axes.plot(clearance.t_s, distance_cm, color=look.INK)
    axes.plot([closest.t_s], [100.0 * closest.distance_m], marker="o", color=look.INK, markersize=6)
    on_left = closest.t_s < 0.6 * analysis.run.duration_s
    span_cm = max(float(np.ptp(distance_cm)), 1.0)
    low_enough = closest.distance_m * 100.0 - min(0.0, float(distance_cm.min()) * 1.1) > 0.3 * span_cm
    axes.annotate(
        f"{100.0 * closest.distance_m:.1f} cm at {closest.t_s:.2f} s\n{closest.robot_link} – {closest.human_body}",
        (closest.t_s, 100.0 * closest.distance_m), xytext=(14 if on_left else -14, -10 if low_enough else 26),
        textcoords="offset points",
        ha="left" if on_left else "right", va="top" if low_enough else "bottom", fontsize=8.5,
        arrowprops={"arrowstyle": "-", "color": look.MUTED, "linewidth": 0.8},
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
    )  # fmt: skip
    low, high = min(0.0, float(distance_cm.min()) * 1.1), float(distance_cm.max())
    axes.set_ylim(low, high + 0.08 * (high - low) if high > low else low + 1.0)
    if low < 0.0:
        axes.axhspan(low, 0.0, color=look.ALARM, alpha=0.12, linewidth=0)
        axes.axhline(0.0, color=look.ALARM, linewidth=1.0)
    axes.set_ylabel("robot to human in cm")
    mark_events(axes, analysis)
    return figure


def occupancy_plot(analysis: Analysis) -> Figure:
    """Predicted occupancy.

    Size of the space the human is predicted to need.
    """
    track = analysis.run.occupancy
    if not len(track):
        return look.empty_figure("no occupancy was recorded")
    figure, axes = look.new_panel(2.7)
    axes.fill_between(track.t_s, track.expected_voxels, color=look.INK, alpha=0.12, linewidth=0)
    axes.plot(track.t_s, track.expected_voxels, color=look.INK, label="expected occupied (sum of probabilities)")
    axes.plot(track.t_s, track.n_voxels, color=look.MUTED, linewidth=1.2, linestyle=(0, (4, 2)), label="published")
    axes.set_ylim(0.0, max(1.0, 1.08 * float(track.n_voxels.max())))
    axes.set_ylabel("voxels")
    mark_events(axes, analysis)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncol=2)
    if track.grid is not None:
        litres = _LITRES_PER_M3 * track.grid.resolution_m**3
        both_ways: Any = (lambda voxels: voxels * litres, lambda volume: volume / litres)
        axes.secondary_yaxis("right", functions=both_ways).set_ylabel("volume in litres")
    return figure


def joints_plot(analysis: Analysis) -> Figure:
    """Arm joints.

    Measured positions and velocities; dashed red lines are limits, drawn where they are near.
    """
    track, arm = analysis.run.robot, analysis.workcell.arm
    shown = (track.t_s >= 0.0) & (track.t_s <= analysis.run.duration_s)
    if shown.sum() < 2:
        return look.empty_figure("the arm was not recorded during the run")
    n_joints = len(track.names)
    figure = look.new_figure(_JOINT_ROW_IN * n_joints + 0.6)
    axes = figure.subplots(n_joints, 2, sharex=True, squeeze=False)
    for j, name in enumerate(track.names):
        left, right = axes[j]
        left.plot(track.t_s[shown], track.q[shown, j], color=look.INK, linewidth=1.4)
        right.plot(track.t_s[shown], track.v[shown, j], color=look.INK, linewidth=1.2)
        short = name.removeprefix("r_").removesuffix("_joint").replace("_", " ")
        left.set_ylabel(short, rotation=0, ha="right", va="center")
        fastest = np.inf if arm is None else float(arm.chain.velocity_limit[j])
        limits = () if arm is None else (float(arm.chain.lower[j]), float(arm.chain.upper[j]))
        _limit_lines(left, limits, track.q[shown, j])
        _limit_lines(right, (-fastest, fastest), track.v[shown, j])
        for side in (left, right):
            mark_events(side, analysis, labels=False, xlabel=j == n_joints - 1)
            side.locator_params(axis="y", nbins=3)
    axes[0, 0].set_title("position in rad")
    axes[0, 1].set_title("velocity in rad/s")
    figure.align_ylabels(axes[:, 0])
    return figure


def latency_plot(analysis: Analysis) -> Figure:
    """Delays.

    Wall time between sending a posture and sending what follows from it, and wall time of one replanning step.
    """
    run = analysis.run
    if not len(run.postures) and not run.steps:
        return look.empty_figure("there is nothing to measure delays on")
    figure, panels = look.new_figure(2.7), (*run.latencies, run.planning)
    for axes, latency in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        axes.set_title(latency.name, pad=18)
        _histogram(axes, 1e3 * latency.delay_s, latency.figures)
    return figure


def _histogram(axes: Axes, delay_ms: FloatArray, figures: LatencyFigures) -> None:
    if figures.median_ms is None or figures.p99_ms is None:
        look.note(axes, "no samples")
        return
    # The first posture may wait for what is made at its use; one such delay must not squash all others.
    far = delay_ms > max(_FAR * figures.median_ms, figures.median_ms + 1.0)
    beyond = int(far.sum()) if far.mean() <= _MOST_FAR else 0
    shown_ms = delay_ms[~far] if beyond else delay_ms
    bins = int(np.clip(round(2.0 * np.sqrt(len(shown_ms))), 5, _MAX_BINS))
    axes.hist(shown_ms, bins=bins, color=look.MUTED, edgecolor="white", linewidth=0.4)
    axes.axvline(figures.median_ms, color=look.INK, linewidth=1.2)
    if not beyond or figures.p99_ms <= shown_ms.max():
        axes.axvline(figures.p99_ms, color=look.INK, linewidth=1.2, linestyle=(0, (4, 2)))
    if beyond:
        text = f"{beyond} more, up to {delay_ms.max():.0f} ms →"
        axes.text(0.99, 0.95, text, ha="right", va="top", fontsize=8, color=look.MUTED, transform=axes.transAxes)
    axes.annotate(
        f"median {figures.median_ms:.1f} ms, 99 % below {figures.p99_ms:.1f} ms, n = {figures.count}", (0.0, 1.0),
        xytext=(0, 5), xycoords="axes fraction", textcoords="offset points", fontsize=8, color=look.MUTED,
    )  # fmt: skip
    if shown_ms.min() < 0.7 * shown_ms.max():  # far from zero, the shape says more than the distance to it
        axes.set_xlim(left=min(0.0, float(shown_ms.min())))
    axes.set_xlabel("ms")
    axes.set_ylabel("count")
    axes.locator_params(axis="y", integer=True)


def _limit_lines(axes: Axes, limits: tuple[float, ...], values: FloatArray) -> None:
    """Draw the limits that lie near the data: a far limit would flatten the curve."""
    low, high = float(values.min()), float(values.max())
    room = max(0.1, 0.35 * (high - low))
    for limit in limits:
        if np.isfinite(limit) and low - room <= limit <= high + room:
            axes.axhline(limit, color=look.ALARM, linewidth=1.0, linestyle=(0, (4, 2)))
            low, high = min(low, limit), max(high, limit)
    margin = max(0.12 * (high - low), (_LEAST_SPAN - (high - low)) / 2.0)
    axes.set_ylim(low - margin, high + margin)


def mark_events(axes: Axes, analysis: Analysis, *, labels: bool = True, xlabel: bool = True) -> None:
    """Mark the end of the human's motion, switches taking effect, holds, evasions and arrival; set the time limits.

    The axis spans the run from its origin: what the robot reported before is standing still.
    """
    run, summary = analysis.run, analysis.summary
    axes.set_label(look.TIME)
    axes.set_xlim(0.0, run.duration_s if run.duration_s > 0.0 else 1.0)
    if xlabel:
        axes.set_xlabel("time since the first posture in s")
    events: list[tuple[float, str, str, Any]] = []
    if 0.0 < run.motion_duration_s < run.duration_s:
        events.append((run.motion_duration_s, "human at rest", look.MUTED, ":"))
    for switch in summary.switches:
        t_s = switch.t_s if switch.t_effect_s is None else switch.t_effect_s
        events.append((t_s, f"arm turns to {switch.goal_after}", look.INK, "-"))
    if summary.reached is not None:
        events.append((summary.reached.t_s, f"arm at {summary.reached.goal}", look.INK, (0, (4, 2))))
    for parts, text, colour in (
        (summary.holds, "hold", look.ALARM),
        (summary.evasions, "arm moves aside", look.CAUTION),
    ):
        for part in parts:
            # A single one must be seen, too.
            until_s = max(part.until_s, part.t_s + 0.004 * run.duration_s)
            axes.axvspan(part.t_s, until_s, color=colour, alpha=0.15, linewidth=0)
            events.append((part.t_s, text, colour, "-"))
    right_end, level = -1.0, 0
    for t_s, text, colour, dashes in sorted(events, key=lambda event: event[0]):
        axes.axvline(t_s, color=colour, linewidth=1.1, linestyle=dashes, zorder=1)
        if not labels:
            continue
        share = t_s / run.duration_s if run.duration_s > 0.0 else 0.0
        level = level + 1 if share < right_end else 0
        right_end = share + _LABEL_SHARE
        align = "left" if share < 0.85 else "right"
        look.label_above(axes, t_s, text, colour, align=align, y=1.01 + level * _LINE_HEIGHT)
