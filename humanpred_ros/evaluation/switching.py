"""`humanpred evaluate switching`: how early the arm chooses the task that leaves the person alone (P1 Fig. 9).

Simulated as in `simulation`: every posture is given to the predictor, the arm replans every 5 % of the person's motion
and executes meanwhile. A step's costs are what the planner compares the goals by. No motion is shown to a predictor
that has learned from it, or from the four of its class that are held out with it.

Words: the *right* goal is the one the same planner chooses in the first step if it is told all voxels that the body is
going to sweep; the *default* goal the one it chooses if nobody is there. Where the two are the same, every choice is
right from the first step and there is nothing to be decided earlier.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import Begin, Column, Report, Table
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.simulation import (
    METHODS,
    RunSettings,
    SimulationSettings,
    first_of_classes,
    group_of,
    read_published,
)
from humanpred_ros.evaluation.switching_runs import (
    CURRENT,
    FIG9_VARIANTS,
    SUMMARY,
    VARIANTS,
    Choosing,
    Curve,
    Person,
    SwitchTask,
    curves,
    first_switch,
    steps_earlier,
    variant_figures,
)
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.settings import setting
from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, SERIES, goal_colours, new_figure, note, plain_powers

#: Where the papers' data folder keeps Fig. 9, relative to the folder that a library lies in.
FIG9_BESIDE_LIBRARY = Path("reference") / "fig9_costs.csv"
_PLOT_COLUMNS = 3
#: Title of the persons who take the goal that the arm would choose; elsewhere every choice is right from step 1.
CONTESTED = "motions that take the goal the arm would choose"


class SwitchingSettings(SimulationSettings):
    """Settings of `humanpred evaluate switching`."""

    scene: str = setting("face_to_face", "scene with two goals or more, name or YAML file")
    trajectory: str = setting("77", "motion of Fig. 9, class/index or running number; empty leaves it out")
    seeds: int = setting(10, "runs of Fig. 9", low=1)
    motions: int | None = setting(None, "show only so many first motions of every class; 0 none; all by default", low=0)


def measure(settings: SwitchingSettings, begin: Begin, run_settings: RunSettings | None = None) -> Report:
    """Make all runs and report their figures.

    Same library, settings and seeds give the same figures for any number of processes.

    Raises:
        UsageError: a scene with a single goal, or an unknown motion.
        LibraryFormatError: a library that nothing can be learned from.
    """
    goals = [goal.name for goal in load_scene(settings.scene).goals]
    if len(goals) < 2:
        raise UsageError(
            f"scene {settings.scene}: wanted two goals or more to choose between, got {', '.join(goals)}; take "
            "another, like face_to_face"
        )
    library, how = settings.material(run_settings)
    tasks = tasks_of(library, settings)
    advance = begin("motions", len(tasks))
    persons = map_processes(Choosing(library, how), tasks, settings.jobs, advance, settings.scheduler)
    published = read_fig9(settings.library_path.resolve().parent)
    figure = None
    if settings.trajectory:
        name = library.find(settings.trajectory).name
        figure = next(person for person in persons if person.motion == name)
    shown = _shown(library, settings)
    parts = {"all motions": [person for person in persons if person.motion in set(shown)]}
    parts[CONTESTED] = [person for person in parts["all motions"] if person.conflict]
    variants = {title: [variant_figures(v, some, how.steps) for v in VARIANTS] for title, some in parts.items() if some}
    figures = {
        "library": library_facts(library, held_out_together=how.hold_out),
        "variants_are": {name: METHODS[name][1] for name in VARIANTS},
        "shown_motions": shown,
        "goals": goals,
        "figure": figure,
        "published": published,
        "summaries": [{"title": title, "persons": len(parts[title]), "variants": f} for title, f in variants.items()],
        "persons": persons,
    }
    tables = [] if figure is None else _figure_tables(figure, goals, published, how.steps)
    notes = (
        "Median (quartiles) of steps. Right: what the same planner chooses at once if told what the body is going to "
        f"sweep. Right since: up to the end; never counts as step {how.steps + 1}. Final choice: the last change of "
        "goal, step 1 if there is none. Returned: back to a goal that had been left.",
    )
    tables += [Table(f"{title}: {len(parts[title])}", records, _COLUMNS) for title, records in variants.items()]
    return Report(
        f"{library.name}: which goal the arm chooses",
        tables,
        figures,
        notes if variants else (),
        draw=lambda: draw_switching(figure, goals, published, parts[CONTESTED], how.steps),
    )


def tasks_of(library: MotionLibrary, settings: SwitchingSettings) -> list[SwitchTask]:
    """Return what is to be run, one task for each person, Fig. 9 first.

    Raises:
        UsageError: no such motion.
    """
    seeds: dict[str, tuple[int, ...]] = dict.fromkeys(_shown(library, settings), (0,))
    if settings.trajectory:
        name = library.find(settings.trajectory).name
        seeds = {name: tuple(range(settings.seeds))} | {n: s for n, s in seeds.items() if n != name}
    return [SwitchTask(settings.scene, name, its) for name, its in seeds.items()]


def _shown(library: MotionLibrary, settings: SwitchingSettings) -> list[str]:
    count = len(library) if settings.motions is None else settings.motions
    # Those held out together follow each other, so that all processes learn without them at about the same time.
    group = {motion.name: group_of(library, motion, settings.hold_out) for motion in library}
    return sorted(first_of_classes(library, count), key=lambda name: group[name])


def read_fig9(folder: Path) -> dict[str, Any] | None:
    """Return P1's Fig. 9, None if it is not in a folder: `goals`, and costs (steps, goals) by `prediction`, `current`.

    Raises:
        UsageError: a file without the columns variant, step (from 1), goal (from 0), cup and cost, or without a cost
            for every step.
    """
    path = folder / FIG9_BESIDE_LIBRARY
    rows = read_published(path, variant=str, step=int, goal=int, cup=str, cost=float)
    if not rows:
        return None
    names = {goal: cup for _, _, goal, cup, _ in rows}
    found = {(variant, step, goal): cost for variant, step, goal, _, cost in rows}
    steps = range(1, len({step for _, step, *_ in rows}) + 1)
    try:
        costs = {
            key: np.array([[found[name, step, goal] for goal in sorted(names)] for step in steps])
            for key, name in FIG9_VARIANTS.items()
        }
    except KeyError as lacking:
        raise UsageError(
            f"{path}: wanted a cost for every step (from 1) and goal, there is none of {lacking}; complete it"
        ) from lacking
    return {"goals": [names[goal] for goal in sorted(names)]} | costs


def _shown_as(key: str) -> Callable[[dict[str, Any]], str]:
    def text(figures: dict[str, Any]) -> str:
        value = figures[key]
        if isinstance(value, tuple):
            return "{1:.1f} ({0:.1f} .. {2:.1f})".format(*value)
        return f"{value} ({100.0 * value / figures['persons']:.1f} %)"

    return text


_COLUMNS = (Column("by", lambda f: f["variant"]), *(Column(title, _shown_as(key)) for key, title, _ in SUMMARY))


def _figure_tables(
    person: Person, goals: Sequence[str], published: Mapping[str, Any] | None, n_steps: int
) -> list[Table]:
    def cell(curve: Curve, goal: int, step: int) -> str | None:
        if step >= len(curve.costs) or math.isnan(curve.costs[step, goal]):
            return None
        return f"{curve.costs[step, goal]:.4f}{'*' if curve.chosen[step] == goal else ' '}"

    columns = [Column("step", lambda step: step + 1)]
    for curve in curves(person, goals, published):
        columns += [Column(f"{curve.title} {name}", partial(cell, curve, k)) for k, name in enumerate(curve.goals)]
    title = (
        f"P1 Fig. 9: motion {person.motion} in {person.scene}, cost of each goal by replanning step, seed 0; "
        f"chosen: *; right: {person.right}, with nobody there: {person.default}"
    )
    switches = []
    for variant in VARIANTS:
        steps_of = ["never" if r.figures.first_switch is None else str(r.figures.first_switch)
                    for r in person.runs if r.variant == variant]  # fmt: skip
        theirs = published and first_switch(published["current" if variant == CURRENT else "prediction"])
        switches.append((variant, steps_of[0], " ".join(steps_of), theirs))
    return [
        Table(title, range(n_steps), columns),
        Table.of_rows("Step of the first switch", ["by", "seed 0", "all seeds", "published"], switches),
    ]


def draw_switching(
    figure: Person | None,
    goals: Sequence[str],
    published: Mapping[str, Any] | None,
    contested: Sequence[Person],
    n_steps: int,
) -> Figure:
    """Return the plot: the goals' costs as in P1's Fig. 9, and how many steps are gained; parts without data say so."""
    panels = [] if figure is None else curves(figure, goals, published)
    n_rows = max(1, -(-(len(panels) + 1) // _PLOT_COLUMNS))
    drawing = new_figure(3.0 * n_rows)
    cells = drawing.subplots(n_rows, _PLOT_COLUMNS, squeeze=False).ravel()
    positive = np.concatenate([panel.costs[panel.costs > 0.0] for panel in panels] or [np.zeros(0)])
    limits = (positive.min() / 2.0, positive.max() * 2.0) if len(positive) else (0.1, 1.0)
    for axes, panel in zip(cells, panels, strict=False):
        _draw_goal_costs(axes, panel, limits)
    gained = {
        variant: [steps_earlier(p.run(variant).figures, p.run(CURRENT).figures, n_steps) for p in contested]
        for variant in VARIANTS
        if variant != CURRENT
    }
    _draw_gained(cells[len(panels)], gained if contested else {})
    for axes in cells[len(panels) + 1 :]:
        axes.remove()
    return drawing


def _draw_goal_costs(axes: Axes, curve: Curve, limits: tuple[float, float]) -> None:
    colours = goal_colours(curve.goals)
    for k, goal in enumerate(curve.goals):
        costs = curve.costs[:, k]
        axes.plot(
            np.arange(1, len(costs) + 1), np.where(costs > 0.0, costs, np.nan), color=colours[goal],
            linestyle=DASHES[k % len(DASHES)], marker=MARKERS[k % len(MARKERS)], markersize=3.0, label=goal,
        )  # fmt: skip
    if curve.switch is not None:
        axes.axvline(curve.switch, color=INK, linewidth=1.0)
        axes.annotate(f" switch: {curve.switch}", (curve.switch, limits[1]), va="top", fontsize=8.0)
    axes.set_yscale("log")
    plain_powers(axes.yaxis)
    axes.set_ylim(*limits)
    axes.set_xlim(0.5, max(20, len(curve.costs)) + 0.5)
    axes.set_title(curve.title)
    axes.set_xlabel("replanning step")
    axes.set_ylabel("cost")
    axes.legend(loc="lower left")


def _draw_gained(axes: Axes, gained: Mapping[str, Sequence[int]]) -> None:
    if not gained:
        note(axes, "no motion was shown in which\nsomething is to be decided")
        return
    everything = np.concatenate([np.asarray(steps) for steps in gained.values()])
    axes.hist(
        [np.asarray(steps) for steps in gained.values()],
        bins=(np.arange(everything.min(), everything.max() + 2) - 0.5).tolist(),
        color=list(SERIES[: len(gained)]),
        label=[f"{variant}, median {np.median(steps):g}" for variant, steps in gained.items()],
    )
    axes.set_title("right earlier than current")
    axes.set_xlabel("replanning steps")
    axes.set_ylabel("motions that take the default goal")
    axes.legend()
