"""All plots of a run in reading order, each with a title and a caption that says what to look for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from humanpred_ros.viewing.clearance import Clearance, measure_clearance
from humanpred_ros.viewing.figures import goal_colours, report_style, svg_of
from humanpred_ros.viewing.plots_decisions import cost_terms_plot, goal_costs_plot, posterior_plot
from humanpred_ros.viewing.plots_space import snapshots_plot, top_view_plot
from humanpred_ros.viewing.plots_time import clearance_plot, joints_plot, latency_plot, occupancy_plot
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.run_summary import RunSummary
from humanpred_ros.viewing.workcell import Workcell, load_workcell


@dataclass(frozen=True)
class Plot:
    """One plot: `key` names it in links, `svg` is an element ready to stand in HTML."""

    key: str
    title: str
    caption: str
    svg: str


def draw_plots(
    run: Run, summary: RunSummary, workcell: Workcell | None = None, clearance: Clearance | None = None
) -> tuple[Plot, ...]:
    """Return the plots of a run; a plot without data says so.

    Args:
        run, summary: of the same run.
        workcell, clearance: found and measured if None.
    """
    workcell = workcell or load_workcell(run)
    clearance = clearance or measure_clearance(run, workcell)
    colours = goal_colours(dict.fromkeys([*workcell.goals, *summary.goals]))
    wanted: tuple[tuple[str, str, str, Callable[[], Figure]], ...] = (
        (
            "top-view",
            "Seen from above",
            "Left: where the palm and the tool went; numbered squares are the goal places of the human's classes. "
            "Right: human body and robot collision spheres at the moment they were closest; the ring marks the place.",
            lambda: top_view_plot(run, summary, workcell, clearance, colours),
        ),
        (
            "posterior",
            "What the human is believed to do",
            "Probability of each class of reach given the part of the motion seen so far; hatched, if the classifier "
            "considers it, the probability that the motion belongs to none of them. Where all are equal, the human is "
            "taken to be at rest.",
            lambda: posterior_plot(run, summary, colours),
        ),
        (
            "goal-costs",
            "Cost of every goal",
            "What goals are compared by, at every replanning step (compare with P1 Fig. 9). Hollow: set aside, so the "
            "cheapest goal need not be the chosen one; the table of decisions says why. A decision takes effect one "
            "step after it was computed (P1 Fig. 4).",
            lambda: goal_costs_plot(run, summary, colours),
        ),
        (
            "cost-terms",
            "What the chosen plan costs",
            "What STOMP minimised: terms of the cost of the chosen goal's plan at every replanning step.",
            lambda: cost_terms_plot(run, summary, colours),
        ),
        (
            "predictions",
            "What was predicted",
            "Occupancy at the first, the decisive and the last replanning step, seen from above: every cell shows the "
            "most probable voxel of its column. The dark line is the palm so far, the diamond the robot's tool.",
            lambda: snapshots_plot(run, summary, workcell, colours),
        ),
        (
            "clearance",
            "Distance between robot and human",
            "Least distance between the robot's collision spheres and the human's body at equal data time. The "
            "spheres contain the arm from the upper arm on, so the true distance is never smaller.",
            lambda: clearance_plot(run, summary, clearance, colours),
        ),
        (
            "occupancy",
            "Predicted occupancy",
            "Size of the space the human is predicted to need.",
            lambda: occupancy_plot(run, summary, colours),
        ),
        (
            "joints",
            "Arm joints",
            "Measured positions and velocities; dashed red lines are limits, drawn where they are near.",
            lambda: joints_plot(run, summary, workcell, colours),
        ),
        (
            "latency",
            "Delays",
            "Wall time between sending a posture and sending what follows from it, and wall time of one replanning "
            "step.",
            lambda: latency_plot(run, summary),
        ),
    )
    with report_style():
        return tuple(Plot(key, title, caption, svg_of(draw(), key)) for key, title, caption, draw in wanted)
