"""The time axis all plots of a run share, with the run's events marked on it, so that they can be read together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes

from humanpred_ros.viewing.figures import ALARM, CAUTION, INK, MUTED
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.run_summary import RunSummary

#: Labels closer than this share of the axis are stacked.
_LABEL_SHARE = 0.13
_LINE_HEIGHT = 0.065


def set_time_limits(axes: Axes, run: Run) -> None:
    """Let the axis span the run from its origin: what the robot reported before is standing still."""
    axes.set_xlim(0.0, run.duration_s if run.duration_s > 0.0 else 1.0)


def mark_events(
    axes: Axes, run: Run, summary: RunSummary, colours: Mapping[str, str], *, labels: bool = True, xlabel: bool = True
) -> None:
    """Mark the end of the human's motion, switches taking effect, holds, evasions and arrival; set the time limits."""
    set_time_limits(axes, run)
    if xlabel:
        axes.set_xlabel("time since the first posture in s")
    events: list[tuple[float, str, str, Any]] = []
    if 0.0 < run.motion_duration_s < run.duration_s:
        events.append((run.motion_duration_s, "human at rest", MUTED, ":"))
    for switch in summary.switches:
        t_s = switch.t_s if switch.t_effect_s is None else switch.t_effect_s
        events.append((t_s, f"arm turns to {switch.goal_after}", colours.get(switch.goal_after, INK), "-"))
    if summary.reached is not None:
        goal = summary.reached.goal
        events.append((summary.reached.t_s, f"arm at {goal}", colours.get(goal, INK), (0, (4, 2))))
    interruptions = [(hold, "hold", ALARM) for hold in summary.holds]
    interruptions += [(evasion, "arm moves aside", CAUTION) for evasion in summary.evasions]
    for interruption, text, colour in interruptions:
        # A single one must be seen, too.
        until_s = max(interruption.until_s, interruption.t_s + 0.004 * run.duration_s)
        axes.axvspan(interruption.t_s, until_s, color=colour, alpha=0.15, linewidth=0)
        events.append((interruption.t_s, text, colour, "-"))
    right_end, level = -1.0, 0
    for t_s, text, colour, dashes in sorted(events, key=lambda event: event[0]):
        axes.axvline(t_s, color=colour, linewidth=1.1, linestyle=dashes, zorder=1)
        if not labels:
            continue
        share = t_s / run.duration_s if run.duration_s > 0.0 else 0.0
        level = level + 1 if share < right_end else 0
        right_end = share + _LABEL_SHARE
        axes.annotate(
            text, (t_s, 1.01 + level * _LINE_HEIGHT), xycoords=("data", "axes fraction"),
            ha="left" if share < 0.85 else "right", va="bottom", fontsize=8, color=colour,
        )  # fmt: skip
