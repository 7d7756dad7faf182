"""Whether the arm can do the tasks of a scene while nobody is there: each is planned once, and the scene is drawn."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from rich.console import Console
from rich.table import Table

from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation.outputs import write_plot
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.robot.clearance import SelfCollision, nearest_contacts
from humanpred_ros.robot.scene import Scene, scene_of
from humanpred_ros.robot.scene_file import GoalSection, SceneFile, read_scene_file, start_of
from humanpred_ros.settings import Settings, setting
from humanpred_ros.viewing.figures import INK, MUTED, goal_colours, new_figure
from humanpred_ros.viewing.plots_space import outline_of

_WOOD, _ROBOT = "#efe6d5", "#9aa5b1"


class SceneCheckSettings(Settings):
    """Settings of `humanpred scene check`."""

    scene: str = setting(..., "name of a scene of the package, or a YAML file", positional=True)
    plot: Path | None = setting(None, "picture to write, from above and from the side: .png, .svg or .pdf")


class SceneSchemaSettings(Settings):
    """Settings of `humanpred scene schema`."""


@dataclass(frozen=True)
class TaskCheck:
    """Whether one task can be done."""

    name: str
    reason: str  #: why not; empty where it can
    configurations: int = 0  #: that finish it
    clearance_m: float = float("nan")  #: of the best of them, from everything
    motion_s: float = float("nan")  #: of the way from the start


def run(settings: SceneCheckSettings, console: Console) -> int:
    """Read a scene, plan every task once with nobody there, and draw it; the exit status is 1 if a task is in vain."""
    file = read_scene_file(settings.scene)
    checked = list(_checked(file))
    scene = next((scene for _, scene in checked if scene is not None), None)
    table = Table("task", "configurations", "clearance (m)", "motion (s)", "verdict", box=None)
    for task, _ in checked:
        figures = [f"{task.clearance_m:.3f}", f"{task.motion_s:.2f}"] if not task.reason else ["", ""]
        table.add_row(task.name, str(task.configurations or ""), *figures, task.reason or "reached")
    if scene is not None:
        place, voxels = np.round(scene.T_world_base[:3, 3], 3).tolist(), " x ".join(map(str, scene.grid.shape))
        console.print(
            f"{file.name}: {scene.arm.robot.name} at {place}, {len(scene.obstacles)} solids, lattice of {voxels} "
            f"voxels of {scene.grid.resolution_m} m"
        )
    console.print(table)
    if settings.plot is not None and scene is not None:
        write_plot(settings.plot, lambda: scene_figure([found for _, found in checked if found is not None]))
        console.print(f"plot  {settings.plot}")
    return 1 if any(task.reason for task, _ in checked) else 0


def schema(settings: SceneSchemaSettings, console: Console) -> int:
    """Print the JSON schema of scene files, from which editors complete them."""
    del settings
    console.out(json.dumps(SceneFile.model_json_schema(), indent=2), highlight=False)
    return 0


def _checked(file: SceneFile) -> Iterator[tuple[TaskCheck, Scene | None]]:
    """Yield what is found of each task, and the scene with that task alone; none where it cannot be made.

    Raises:
        HumanPredError: what is wrong is no task.
    """
    start = tuple(start_of(file)[1])
    stay = tuple(GoalSection(name=entry.name, configuration_rad=start) for entry in file.goals)
    bare = scene_of(file.model_copy(update={"goals": stay}))
    bare.check_free()
    field = bare.distance_field()
    for entry in file.goals:
        scene = None
        try:
            scene = scene_of(file.model_copy(update={"goals": (entry,)}))
            scene.check_free()
            itself = SelfCollision.for_arm(scene.arm).clearance
            yield _planned(scene, Replanner(scene.arm, scene.goals, field, self_clearance=itself)), scene
        except HumanPredError as trouble:
            yield TaskCheck(entry.name, str(trouble)), scene


def _planned(scene: Scene, replanner: Replanner) -> TaskCheck:
    [goal] = scene.goals
    nobody = Occupancy(scene.grid, np.zeros(scene.grid.shape, dtype=np.float32), 0.1)
    try:
        replanner.start(scene.start, 0.0)
        decision = replanner.plan(nobody)
    finally:
        replanner.close()
    clearance_m = max(
        contact.clearance_m for contact in nearest_contacts(scene.arm, scene.obstacles, goal.configurations)
    )
    count = len(goal.configurations)
    if decision.trajectory is None or decision.chosen is None:
        reason = next((report.reason for report in decision.goals if report.reason), decision.reason)
        return TaskCheck(goal.name, f"no way from the start: {reason}", count, clearance_m)
    return TaskCheck(goal.name, "", count, clearance_m, decision.trajectory.end_s - decision.t_switch_s)


def scene_figure(scenes: list[Scene]) -> Figure:
    """Return a drawing of a scene from above and from the side; scenes that differ in their tasks are drawn as one."""
    figure = new_figure(5.0)
    for k, (across, upwards) in enumerate(((0, 1), (0, 2))):
        axes = figure.add_subplot(1, 2, k + 1)
        axes.set_aspect("equal")
        axes.set_xlabel("x in m")
        axes.set_ylabel(f"{'xyz'[upwards]} in m")
        axes.set_title("from above" if upwards == 1 else "from the side (against y)")
        _draw(axes, scenes, (across, upwards))
        axes.autoscale_view()
    return figure


def _draw(axes: Axes, scenes: list[Scene], sides: tuple[int, int]) -> None:
    scene, columns = scenes[0], list(sides)
    for obstacle in scene.obstacles:
        axes.add_patch(Polygon(outline_of(obstacle, columns), facecolor=_WOOD, edgecolor=MUTED, linewidth=0.8))
    for obstacle in scene.arm.fixed_obstacles:
        axes.add_patch(Polygon(outline_of(obstacle, columns), facecolor="none", edgecolor=_ROBOT, linewidth=0.5))
    spheres = scene.arm.spheres()
    for centre, radius in zip(spheres.world_m(scene.arm.chain, scene.start), spheres.radius_m, strict=True):
        axes.add_patch(Circle(tuple(centre[columns]), float(radius), facecolor=_ROBOT, alpha=0.5, linewidth=0))
    colours = goal_colours([goal.name for one in scenes for goal in one.goals])
    for goal in (goal for one in scenes for goal in one.goals):
        place: FloatArray = scene.arm.chain.tool_pose(goal.configuration)[:3, 3][columns]
        axes.plot(*place, marker="o", color=colours[goal.name], linestyle="none")
        axes.annotate(goal.name, tuple(place), xytext=(4, 4), textcoords="offset points", color=INK, fontsize=8)
    for T, name in ((scene.T_world_base, scene.arm.robot.name), (scene.T_world_human, "tracker")):
        place = T[:3, 3][columns]
        axes.plot(*place, marker="P", color=INK, linestyle="none")
        axes.annotate(name, tuple(place), xytext=(4, -10), textcoords="offset points", color=INK, fontsize=8)
