"""Plots of where things were, seen from above: the paths, the closest moment, and what was predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MultipleLocator
from scipy.spatial import ConvexHull

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.solids import EllipticCylinder, Obstacle
from humanpred_ros.viewing.analysis import Analysis, RunSummary
from humanpred_ros.viewing.figures import ALARM, INK, MUTED, WIDTH_IN, empty_figure, goal_colours, new_figure
from humanpred_ros.viewing.recorded import OccupancySnapshot
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.workcell import Workcell

HUMAN = "#b7791f"
ROBOT = "#52606d"
WOOD = "#f3ece0"
PROBABILITY = LinearSegmentedColormap.from_list("probability", ["#fdf3e1", "#f0a04b", "#9c2a10"])
_MARGIN_M = 0.12
#: Pictures of what was predicted: first, decisive, last.
_N_SNAPSHOTS = 3
#: What the arm does in a step that sends it to no goal.
_WITHOUT_GOAL = {"hold": "the arm stops", "evade": "the arm moves aside"}


def top_view_plot(analysis: Analysis) -> Figure:
    """Seen from above.

    Left: where the palm and the tool went; numbered squares are the goal places of the human's classes. Right: human
    body and robot collision spheres at the moment they were closest; the ring marks the place.
    """
    run, workcell, closest = analysis.run, analysis.workcell, analysis.summary.closest
    palm, tool = workcell.palm_path(run.postures), workcell.tool_path(run.robot.q[run.robot.t_s >= 0.0])
    if workcell.scene is None or not (len(palm) or len(tool)):
        return empty_figure("no motion was recorded" if workcell.scene else "the scene is not known")
    figure = new_figure(2.0)
    paths, moment = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes in (paths, moment):
        _draw_scene(axes, analysis)
    paths.set_title("paths")
    for label, place in zip(run.posterior.labels, run.posterior.goals_m, strict=True):
        paths.plot(place[0], place[1], marker="s", color="white", markeredgecolor=INK, markersize=4.5, zorder=3.0)
        # Beside the place: a task's cross may stand on it.
        paths.annotate(
            str(label), (place[0], place[1]), xytext=(6, 5), textcoords="offset points", fontsize=8, color=INK
        )
    for name, path, colour in (("human palm", palm, HUMAN), ("robot tool", tool, ROBOT)):
        if len(path):
            paths.plot(path[:, 0], path[:, 1], color=colour, linewidth=2.2, label=name)
            paths.plot(*path[0, :2], marker="o", color=colour, markersize=6)
            paths.plot(*path[-1, :2], marker="s", color=colour, markersize=6)
    for name, configurations in workcell.goals.items():
        of_several = f" (preferred of {len(configurations)})" if len(configurations) > 1 else ""
        place = workcell.tool_path(configurations[:1])[0]
        paths.plot(
            place[0], place[1], marker="X", markersize=8, color=analysis.colours.get(name, INK), zorder=4.0,
            markeredgecolor="white", linestyle="none", label=f"goal {name}{of_several}",
        )  # fmt: skip
    paths.plot([], [], marker="o", color=MUTED, linestyle="none", label="start")
    paths.plot([], [], marker="s", color=MUTED, linestyle="none", label="end")
    _draw_closest(moment, analysis)
    parts = [palm[:, :2], tool[:, :2], *_outlines(workcell), workcell.scene.T_world_base[None, :2, 3]]
    if closest is not None:
        parts += workcell.human_outlines(_posture_at(run, closest.t_s))
        parts += [centre[None, :2] for centre, _ in _arm_spheres(run, workcell, closest.t_s)]
    _frame(paths, parts, figure, n_panels=2, extra_in=1.2)
    paths.set_ylabel("y in m")
    figure.legend(*paths.get_legend_handles_labels(), loc="outside lower center", ncol=7, columnspacing=1.6)
    return figure


def snapshots_plot(analysis: Analysis) -> Figure:
    """What was predicted.

    Occupancy at the first, the decisive and the last replanning step, seen from above: every cell shows the most
    probable voxel of its column. The dark line is the palm so far, the diamond the robot's tool.
    """
    run, workcell = analysis.run, analysis.workcell
    chosen = _decisive(run, analysis.summary)
    if not chosen:
        return empty_figure("no occupancy was recorded at a replanning step")
    figure = new_figure(2.0)
    panels = figure.subplots(1, len(chosen), sharex=True, sharey=True, squeeze=False)[0]
    palm, image = workcell.palm_path(run.postures), None
    parts = [snapshot.centres_m[:, :2] for snapshot, _ in chosen] + _outlines(workcell)
    for axes, (snapshot, title) in zip(panels, chosen, strict=True):
        axes.set_title(title)
        _draw_scene(axes, analysis, faint=True)
        image = _draw_footprint(axes, run, snapshot)
        tool = _tool_at(run, workcell, snapshot.t_s)
        parts.append(tool[:, :2])
        if len(tool):
            axes.plot(*tool[0, :2], marker="D", color=ROBOT, markersize=7, markeredgecolor="white", linestyle="none")
        if len(palm):
            so_far = palm[: int(np.searchsorted(run.postures.t_s, snapshot.t_s, side="right"))]
            axes.plot(so_far[:, 0], so_far[:, 1], color=INK, linewidth=1.6)
            axes.plot(*so_far[-1, :2], marker="o", color=INK, markersize=6, markeredgecolor="white", linestyle="none")
    _frame(panels[0], parts, figure, n_panels=len(chosen) + 0.4, extra_in=1.15)
    panels[0].set_ylabel("y in m")
    if image is not None:
        bar = figure.colorbar(image, ax=list(panels), shrink=0.8, aspect=14, pad=0.015)
        bar.set_label("highest probability in the column")
        bar.outline.set_visible(False)
    return figure


def _decisive(run: Run, summary: RunSummary) -> list[tuple[OccupancySnapshot, str]]:
    """Return the snapshots worth a picture with their titles, in time order."""
    steps = {row.t_s: row for row in summary.steps}
    snapshots = [s for s in run.occupancy.snapshots if s.t_s in steps and len(s.probability)]
    if not snapshots:
        return []
    switched = {switch.step for switch in summary.switches}
    turning = next((k for k, snapshot in enumerate(snapshots) if steps[snapshot.t_s].step in switched), None)
    middle = turning if turning is not None else len(snapshots) // 2
    titles = []
    for k in sorted({0, middle, len(snapshots) - 1})[:_N_SNAPSHOTS]:
        row = steps[snapshots[k].t_s]
        share = "" if row.percent is None else f", {row.percent:.0f} % of the reach"
        verb = "switch to" if row.step in switched else "chosen:"
        verdict = _WITHOUT_GOAL.get(row.instead, f"{verb} {row.chosen}" if row.chosen else "nothing chosen")
        titles.append((snapshots[k], f"step {row.step}{share}\n{verdict}"))
    return titles


def _draw_scene(axes: Axes, analysis: Analysis, *, faint: bool = False) -> None:
    workcell = analysis.workcell
    axes.set_aspect("equal")
    axes.set_xlabel("x in m")
    if workcell.scene is None:
        return
    hues = {**goal_colours(obstacle.name for obstacle in workcell.obstacles), **analysis.colours}
    for obstacle in workcell.obstacles:
        outline = outline_of(obstacle)
        if isinstance(obstacle.shape, EllipticCylinder):
            hue = _hue_of(obstacle.name, hues)
            axes.add_patch(Polygon(outline, facecolor=hue, alpha=0.35 if faint else 0.8, linewidth=0, zorder=3))
        else:
            axes.add_patch(Polygon(outline, facecolor=WOOD, edgecolor="#d9cbb2", linewidth=0.8, zorder=0.5))
    if not faint:
        x, y = workcell.scene.T_world_base[:2, 3]
        axes.plot(x, y, marker="P", color=ROBOT, markersize=9, linestyle="none", zorder=2)
        axes.annotate(
            workcell.scene.arm.robot.name,
            (x, y),
            xytext=(0, 8),
            textcoords="offset points",
            ha="center",
            color=ROBOT,
            fontsize=8,
        )


def _hue_of(name: str, hues: Mapping[str, str]) -> str:
    """Return the colour of an object: its goal's if one is named in its name."""
    words = name.lower().replace("-", "_").split("_")
    return next((colour for goal, colour in hues.items() if goal.lower() in words), hues.get(name, MUTED))


def _tool_at(run: Run, workcell: Workcell, t_s: float) -> FloatArray:
    """Return where the tool was at a time, (1, 3), or (0, 3) if that is not known."""
    robot = run.robot.at(np.array([t_s]))
    return workcell.tool_path(robot[np.isfinite(robot).all(axis=1)])


def _posture_at(run: Run, t_s: float) -> FloatArray:
    posture: FloatArray = run.postures.q[int(np.argmin(np.abs(run.postures.t_s - t_s)))]
    return posture


def _arm_spheres(run: Run, workcell: Workcell, t_s: float) -> list[tuple[FloatArray, float]]:
    """Return centre and radius of the arm's collision spheres at a time, from the lowest to the highest."""
    if workcell.arm is None:
        return []
    spheres = workcell.arm.spheres()
    centres = spheres.world_m(workcell.arm.chain, run.robot.at(np.array([t_s]))[0])
    return [(centres[k], float(spheres.radius_m[k])) for k in np.argsort(centres[:, 2])]


def _draw_closest(axes: Axes, analysis: Analysis) -> None:
    run, workcell, closest = analysis.run, analysis.workcell, analysis.summary.closest
    if closest is None:
        axes.set_title("closest moment: not known")
        return
    t_s = closest.t_s
    axes.set_title(f"closest moment: {100 * closest.distance_m:.1f} cm at {t_s:.2f} s")
    for outline in workcell.human_outlines(_posture_at(run, t_s)):
        axes.add_patch(Polygon(outline, facecolor="#f1ddbb", edgecolor="#d3ad72", linewidth=0.7, zorder=2))
    for centre, radius in _arm_spheres(run, workcell, t_s):
        ball = Circle((centre[0], centre[1]), radius, facecolor="#cbd2d9", edgecolor="#8f9ba8", linewidth=0.7, zorder=4)
        axes.add_patch(ball)
    place = analysis.clearance.place_m
    axes.plot(*place[:2], marker="o", markersize=13, markerfacecolor="none", markeredgecolor=ALARM, zorder=5)


def _draw_footprint(axes: Axes, run: Run, snapshot: OccupancySnapshot) -> AxesImage:
    """Draw the highest probability over each column of voxels."""
    centres, probability = snapshot.centres_m[:, :2], snapshot.probability
    edge = run.occupancy.grid.resolution_m if run.occupancy.grid is not None else _spacing(centres)
    low = centres.min(axis=0)
    cell = np.rint((centres - low) / edge).astype(np.int64)
    image = np.zeros(tuple(cell.max(axis=0) + 1))
    np.maximum.at(image, (cell[:, 0], cell[:, 1]), probability)
    size = np.array(image.shape) * edge
    x, y = low - edge / 2
    return axes.imshow(
        np.ma.masked_equal(image.T, 0.0), origin="lower", extent=(x, x + size[0], y, y + size[1]), cmap=PROBABILITY,
        vmin=0.0, vmax=1.0, interpolation="nearest", alpha=0.9, zorder=1.5,
    )  # fmt: skip


def _spacing(centres: FloatArray) -> float:
    steps = np.diff(np.unique(np.round(centres[:, 0], 4)))
    return float(steps.min()) if len(steps) else 0.05


def outline_of(obstacle: Obstacle, sides: Sequence[int] = (0, 1)) -> FloatArray:
    """Return the outline (N, 2) of an obstacle, counter-clockwise, by two of its coordinates: seen from above."""
    if isinstance(obstacle.shape, EllipticCylinder):
        angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:
        rim = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    local = np.concatenate([np.column_stack([rim, np.full(len(rim), z)]) for z in (-1, 1)]) * obstacle.shape.half_m
    T = obstacle.T_world_shape
    flat = (local @ T[:3, :3].T + T[:3, 3])[:, list(sides)]
    outline: FloatArray = flat[ConvexHull(flat).vertices]
    return outline


def _outlines(workcell: Workcell) -> list[FloatArray]:
    return [outline_of(obstacle) for obstacle in workcell.obstacles]


def _frame(axes: Axes, parts: list[FloatArray], figure: Figure, *, n_panels: float, extra_in: float) -> None:
    """Set limits that hold all parts (N, 2), and make the figure as high as that needs.

    Args:
        axes: one of the panels, which share their limits.
        parts: what must be seen.
        figure: with `n_panels` panels side by side, and `extra_in` inches for labels below and above.
    """
    points = np.concatenate([part.reshape(-1, 2) for part in parts])
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(0.25 if n_panels < _N_SNAPSHOTS else 0.5))
    panel_in = (WIDTH_IN - 0.6) / n_panels - 0.25
    figure.set_figheight(panel_in * float((high[1] - low[1]) / (high[0] - low[0])) + extra_in)
