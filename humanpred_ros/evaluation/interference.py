"""`humanpred evaluate interference`: how much the arm disturbs the person (P1 Table I), also beside many people.

The arm replans every 5 % of the person's motion and executes meanwhile (P1 lets person and arm move in turns). The last
posture is held until the arm has arrived. What a motion costs is what P1's published code measures (docs/papers.md
1.12): the mean occupancy of the arm's body points, times 87, integrated over the configuration distance of the motion
executed, and 0.002 of its length, under P1's prediction after the last posture. That occupancy is the same for all
methods, and has no margin that a planner keeps. Basic STOMP is the same planner, told that nobody is there. The guard
stops the arm for who comes close and lets them touch an arm that stands: such a contact counts, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from humanpred_ros.evaluation.framework import Begin, Column, Report, Table, chosen_names
from humanpred_ros.evaluation.interference_runs import (
    BASIC,
    PREDICTING,
    TABLE_METHODS,
    Avoidance,
    PersonOutcome,
    Runs,
    RunTask,
    method_figures,
    read_table1,
)
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.simulation import (
    METHODS,
    RunSettings,
    SimulationSettings,
    first_of_classes,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.settings import setting
from humanpred_ros.viewing.figures import ALARM, INK, MUTED, SERIES, new_figure, note, plain_powers

#: Table I's scene.
TABLE_SCENE = "side_by_side"
#: A person's way crosses the arm's if basic STOMP comes closer than this.
CROSSING_M = 0.10
#: So many are listed of what may be many: contacts of methods that do not predict, and runs that reach no goal.
_LISTED = 20
#: What stands for a cost of zero on a logarithmic axis.
_SMALLEST_COST = 1e-4


class InterferenceSettings(SimulationSettings):
    """Settings of `humanpred evaluate interference`."""

    table_motions: tuple[str, ...] = setting(
        ("25", "26", "27", "28", "29"), "human trajectories of Table I, class/index or running number"
    )
    table_runs: int = setting(10, "runs of each of them and each method; 0 leaves Table I out", low=0)
    scenes: tuple[str, ...] = setting((TABLE_SCENE, "face_to_face"), "scenes of the comparison, names or YAML files")
    motions: int = setting(
        7, "first motions of every class in the comparison, each never learned from; 0 leaves it out", low=0
    )
    seeds: int = setting(1, "runs of each of these", low=0)
    methods: tuple[str, ...] = setting(
        ("all",), f"methods of the comparison: all, or some of {', '.join(METHODS)}; basic is always among them"
    )

    def check(self) -> None:
        """Refuse unknown methods."""
        self.compared_methods()

    def compared_methods(self) -> tuple[str, ...]:
        """Return the methods of the comparison in the order of `METHODS`. Raises UsageError for unknown ones."""
        chosen = chosen_names(self.methods, METHODS, "methods")
        return tuple(name for name in METHODS if name in {*chosen, BASIC})


def measure(settings: InterferenceSettings, begin: Begin, run_settings: RunSettings | None = None) -> Report:
    """Make all runs and report their figures.

    Same library, settings and seeds give the same figures, times apart, for any number of processes.

    Raises:
        LibraryFormatError: a library that nothing can be learned from.
        HumanPredError: other DoFs, an unknown scene or motion, or a scene that cannot be planned in.
    """
    library, how = settings.material(run_settings)
    runs = Runs(library, how)
    for scene in settings.scenes:
        runs.world.scene(scene)  # an unknown one shows before any work is done
    tasks = tasks_of(library, settings)
    advance = begin(f"{sum(len(task.runs) for task in tasks)} runs beside persons", len(tasks))
    outcomes = map_processes(Runs(library, how), tasks, settings.jobs, advance, settings.scheduler)
    pairs = list(zip(tasks, outcomes, strict=True))
    table1 = _table1(library, settings, pairs, read_table1(settings.library_path.resolve().parent))
    comparison = _comparison(library, settings, pairs)
    contacts, unreached = _contacts(pairs), _unreached(pairs)
    figures = {
        "library": library_facts(library, held_out_together=how.hold_out),
        "methods_are": {name: what for name, (_, what) in METHODS.items()},
        "compared_motions": first_of_classes(library, settings.motions),
        "table1": table1,
        "comparison": comparison,
        "contacts": contacts,
        "unreached": unreached,
        "runs": [one for outcome in outcomes for one in outcome.runs],
    }
    title = (
        f"{library.name}: what is shown was not learned from, nor were the motions held out with it, {how.hold_out} of "
        "every class; cost: human occupancy under P1's final prediction, integrated over the executed motion, + 0.002 "
        "length"
    )
    tables = [*_table1_tables(table1), *map(_comparison_table, comparison)]
    tables += [*_contact_tables(contacts), *_unreached_tables(unreached)]
    return Report(title, tables, figures, draw=lambda: draw_interference(table1, comparison, figures))


def tasks_of(library: MotionLibrary, settings: InterferenceSettings) -> list[RunTask]:
    """Return what is to be run, one task for each scene and person, those with most runs first.

    Raises:
        UsageError: no such motion.
    """
    wanted: dict[tuple[str, str], dict[tuple[str, int], None]] = {}  # dictionaries keep the order, sets do not
    for motion, seeds in _table_seeds(library, settings).items():
        runs = wanted.setdefault((TABLE_SCENE, motion), {})
        runs.update(dict.fromkeys((method, seed) for method in TABLE_METHODS for seed in seeds))
    for scene in settings.scenes:
        for motion in first_of_classes(library, settings.motions):
            runs = wanted.setdefault((scene, motion), {})
            methods = settings.compared_methods()
            runs.update(dict.fromkeys((method, seed) for method in methods for seed in range(settings.seeds)))
    tasks = [RunTask(scene, motion, tuple(runs)) for (scene, motion), runs in wanted.items() if runs]
    return sorted(tasks, key=lambda task: -len(task.runs))


def _table_seeds(library: MotionLibrary, settings: InterferenceSettings) -> dict[str, range]:
    """Return the seeds of each motion of Table I, by name.

    No two motions share seeds, so that basic STOMP, which does not see the human, is not run alike beside all.
    """
    names = [library.find(motion).name for motion in settings.table_motions]
    n = settings.table_runs
    return {name: range(k * n, (k + 1) * n) for k, name in enumerate(dict.fromkeys(names))} if n else {}


Pairs = Sequence[tuple[RunTask, PersonOutcome]]


def _table1(
    library: MotionLibrary, settings: InterferenceSettings, pairs: Pairs, published: Mapping[int, dict[str, float]]
) -> list[dict[str, Any]]:
    # The papers' global id: the running number over the sorted classes.
    ordered = library.by_class
    numbers = {motion.name: number for number, motion in enumerate(ordered)}
    rows = []
    for motion, seeds in _table_seeds(library, settings).items():
        outcomes = [outcome for task, outcome in pairs if (task.scene, task.motion) == (TABLE_SCENE, motion)]
        runs = [one for outcome in outcomes for one in outcome.runs if one.seed in seeds]
        methods = {method: method_figures(method, runs) for method in TABLE_METHODS}
        number = numbers[motion]
        rows.append({"number": number, "motion": motion, "methods": methods, "published": published.get(number)})
    return rows


def _comparison(library: MotionLibrary, settings: InterferenceSettings, pairs: Pairs) -> list[dict[str, Any]]:
    names, methods = set(first_of_classes(library, settings.motions)), settings.compared_methods()
    persons = [
        (task.scene, [one for one in outcome.runs if one.seed < settings.seeds and one.method in methods], outcome)
        for task, outcome in pairs
        if task.scene in settings.scenes and task.motion in names
    ]
    persons = [person for person in persons if person[1]]
    parts = {"all scenes": persons}
    parts |= {f"scene {scene}": [person for person in persons if person[0] == scene] for scene in settings.scenes}
    parts[f"where basic comes closer than {CROSSING_M:.2f} m in some run"] = [
        person
        for person in persons
        if min(one.least_distance_m for one in person[1] if one.method == BASIC) < CROSSING_M
    ]
    found = []
    for title, some in parts.items():
        if some:
            runs = [one for _, person_runs, _ in some for one in person_runs]
            bound_m = float(np.median([outcome.bound_m for _, _, outcome in some]))
            figures = [method_figures(method, runs) for method in methods]
            found.append({"title": title, "persons": len(some), "bound_m": bound_m, "methods": figures})
    return found


def _contacts(pairs: Pairs) -> list[dict[str, Any]]:
    """Return one record for each run in which the arm's spheres touch the human; `avoidable` None: not looked into."""
    rows = [
        {"scene": task.scene, "motion": one.motion, "method": one.method, "seed": one.seed, "contact": one.contact,
         "avoidance": outcome.avoidance, "avoidable": outcome.avoidance and bool(outcome.avoidance.policy)}
        for task, outcome in pairs for one in outcome.runs if one.contact is not None
    ]  # fmt: skip
    order = list(METHODS)
    return sorted(rows, key=lambda row: (order.index(str(row["method"])), row["scene"], row["motion"], row["seed"]))


def _unreached(pairs: Pairs) -> list[dict[str, Any]]:
    """Return one record for each predicting run that ends at no goal."""
    rows = [
        {"scene": task.scene, "motion": one.motion, "method": one.method, "seed": one.seed, "goal_m": outcome.goal_m,
         "ended": one.ended}
        for task, outcome in pairs for one in outcome.runs if one.goal is None and one.method in PREDICTING
    ]  # fmt: skip
    return sorted(rows, key=lambda row: (row["method"], row["scene"], row["motion"], row["seed"]))


_RUN = Column("run", lambda r: f"{r['method']}, {r['scene']}, {r['motion']}, seed {r['seed']}")
_SAFETY = (
    Column("method", lambda f: f["method"]),
    Column("runs", lambda f: f["runs"]),
    Column("goal reached", lambda f: f["reached"]),
    Column("runs with contact", lambda f: f["contacts"]),
    Column("median least distance to human", lambda f: f["median_distance_m"], ".3f", "m"),
    Column("least of all", lambda f: f["least_distance_m"], ".3f", "m"),
    Column("least clearance to table, objects", lambda f: f["clearance_m"], ".3f", "m"),
    Column(
        "median time to goal",
        lambda f: f["time_to_goal_s"] if np.isfinite(f["time_to_goal_s"]) else "never",
        ".2f",
        "s",
    ),
    Column("median execution time", lambda f: f["execution_s"], ".2f", "s"),
)
_COMPARED = (
    *_SAFETY,
    Column("mean cost", lambda f: f["cost_mean"], ".4f"),
    Column("median cost", lambda f: f["cost_median"], ".4f"),
    Column("basic / this, mean cost", lambda f: f["ratio"], ".1f"),
    Column("  under what was really swept", lambda f: f["ratio_swept"], ".1f"),
    Column("  where both reach a goal", lambda f: f["ratio_reached"], ".1f"),
    Column("time slowed by the guard", lambda f: 100.0 * f["slowed"], ".0f", "%"),
    Column("stopped", lambda f: 100.0 * f["stopped"], ".0f", "%"),
    Column("median replanning step", lambda f: f["step_ms"], ".1f", "ms"),
)


_TABLE1 = (
    Column("id", lambda r: r["number"]),
    Column("published ours", lambda r: _published(r, "ours", 3)),
    Column("published basic", lambda r: _published(r, "basic", 2)),
    Column("published ratio", lambda r: r["published"] and r["published"]["ratio"], ".0f"),
    Column("ours_p1", lambda r: _here(r, "ours_p1", 4)),
    Column("basic", lambda r: _here(r, "basic", 3)),
    Column("ratio ours_p1", lambda r: r["methods"]["ours_p1"]["ratio"], ".0f"),
    Column("ours (default)", lambda r: _here(r, "ours", 4)),
    Column("ratio ours", lambda r: r["methods"]["ours"]["ratio"], ".0f"),
)


def _published(row: Mapping[str, Any], name: str, digits: int) -> str | None:
    theirs = row["published"]
    return theirs and f"{theirs[f'{name}_mean']:.{digits}f} +- {theirs[f'{name}_sd']:.{digits}f}"


def _here(row: Mapping[str, Any], name: str, digits: int) -> str:
    figures = row["methods"][name]
    return f"{figures['cost_mean']:.{digits}f} +- {figures['cost_sd']:.{digits}f}"


def _table1_tables(rows: Sequence[dict[str, Any]]) -> list[Table]:
    if not rows:
        return []
    n_runs = rows[0]["methods"][BASIC]["runs"]
    safety = [f | {"method": f"{row['number']} {name}"} for row in rows for name, f in row["methods"].items()]
    return [
        Table(f"P1 Table I: cost, mean +- sd of {n_runs} runs; ratio basic / ours", rows, _TABLE1),
        Table("The same runs, by human trajectory and method", safety, _SAFETY),
    ]


def _comparison_table(part: Mapping[str, Any]) -> Table:
    title = (
        f"Many motions, {part['title']}: {part['persons']} persons; no run that ends at a goal can keep a median least "
        f"distance above {part['bound_m']:.3f} m"
    )
    return Table(title, part["methods"], _COMPARED)


def _contact_tables(rows: Sequence[dict[str, Any]]) -> list[Table]:
    if not rows:
        return []
    predicting = [row for row in rows if row["method"] in PREDICTING]
    others = [row for row in rows if row["method"] not in PREDICTING]
    columns = (
        _RUN,
        Column("at", lambda r: r["contact"].t_s, ".2f", "s"),
        Column("deepest", lambda r: r["contact"].deepest_m, ".3f", "m"),
        Column("arm's surface", lambda r: r["contact"].surface_m, ".3f", "m"),
        Column("parts", lambda r: f"{r['contact'].robot_link}, {r['contact'].human_body}"),
        Column("moved", lambda r: r["contact"].moved),
        Column("avoidable", lambda r: _verdict(r["avoidance"])),
    )
    rest = len(others) - _LISTED
    more = f"and {rest} more of methods that do not predict" if rest > 0 else ""
    return [Table("Runs in which the arm's spheres touch the human", [*predicting, *others[:_LISTED]], columns, more)]


def _verdict(avoidance: Avoidance | None) -> str:
    if avoidance is None:
        return "not looked into"
    if not avoidance.policy:
        return f"no: best of {avoidance.tried} policies came to {avoidance.best_m:.3f} m"
    until_s = avoidance.latest_departure_s
    return f"yes: {avoidance.policy}" + (f", leaving by {until_s:.2f} s" if np.isfinite(until_s) else "")


def _unreached_tables(rows: Sequence[dict[str, Any]]) -> list[Table]:
    columns = (
        _RUN,
        Column("person leaves at a goal", lambda r: r["goal_m"], ".3f", "m"),
        Column("last decision", lambda r: r["ended"]),
    )
    more = f"and {len(rows) - _LISTED} more" if len(rows) > _LISTED else ""
    title = f"Predicting runs that end at no goal: {len(rows)}"
    return [Table(title, rows[:_LISTED], columns, more)] if rows else []


def draw_interference(
    table1: Sequence[Mapping[str, Any]], comparison: Sequence[Mapping[str, Any]], figures: Mapping[str, Any]
) -> Figure:
    """Return the plot: Table I's costs beside the published, and how close and how late; parts without data say so."""
    figure = new_figure(6.4)
    above, below = figure.subplots(2, 1)
    _draw_costs(above, table1)
    cells = below.get_subplotspec().subgridspec(1, 2)
    below.remove()
    distance, time = (figure.add_subplot(cell) for cell in cells)
    methods = [f["method"] for f in comparison[0]["methods"]] if comparison else []
    motions = set(figures["compared_motions"])
    runs = [[one for one in figures["runs"] if one.method == name and one.motion in motions] for name in methods]
    near = [np.array([one.least_distance_m for one in some]) for some in runs]
    late = [np.array([one.time_to_goal_s for one in some]) for some in runs]
    _draw_runs(distance, methods, near, "least distance to the human, m")
    if methods:
        distance.axvline(0.0, color=ALARM, linewidth=1.0)
    _draw_runs(time, methods, late, "time to goal, s")
    return figure


def _draw_costs(axes: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    axes.set_title("human occupancy of the executed motion (P1 Table I), mean and standard deviation")
    if not rows:
        note(axes, "Table I was left out")
        return
    series = {f"{name}, here": [row["methods"][name] for row in rows] for name in TABLE_METHODS}
    here = {name: [(f["cost_mean"], f["cost_sd"]) for f in values] for name, values in series.items()}
    theirs = {}
    if all(row["published"] for row in rows):
        for name in ("ours", BASIC):
            theirs[f"{name}, published"] = [
                (r["published"][f"{name}_mean"], r["published"][f"{name}_sd"]) for r in rows
            ]
    width = 0.8 / (len(here) + len(theirs))
    for k, (name, values) in enumerate({**theirs, **here}.items()):
        mean, sd = np.array(values).T
        x = np.arange(len(rows)) + (k - (len(here) + len(theirs) - 1) / 2.0) * width
        low = np.minimum(sd, mean - np.maximum(mean / 10.0, _SMALLEST_COST / 2.0))  # an error bar stays on the axis
        faint: dict[str, Any] = {"alpha": 0.45, "hatch": "//"} if name in theirs else {}
        axes.bar(
            x, np.maximum(mean, _SMALLEST_COST), 0.92 * width, yerr=np.stack([np.maximum(low, 0.0), sd]),
            error_kw={"elinewidth": 0.8, "ecolor": INK}, color=SERIES[k % len(SERIES)], edgecolor="white", label=name,
            **faint,
        )  # fmt: skip
    axes.set_yscale("log")
    plain_powers(axes.yaxis)
    axes.set_xticks(np.arange(len(rows)), [str(row["number"]) for row in rows])
    axes.set_xlabel("human trajectory")
    axes.set_ylabel("cost")
    axes.legend(ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.08))


def _draw_runs(axes: Axes, methods: Sequence[str], values: Sequence[FloatArray], label: str) -> None:
    if not methods:
        note(axes, "the comparison was left out")
        return
    for row, (method, all_runs) in enumerate(zip(methods, values, strict=True)):
        finite = all_runs[np.isfinite(all_runs)]
        spread = ((np.arange(len(finite)) * 0.618) % 1.0 - 0.5) * 0.5  # side by side without chance
        axes.plot(finite, row + spread, ".", color=SERIES[row % len(SERIES)], markersize=3.0, alpha=0.6)
        median = float(np.median(all_runs))
        if np.isfinite(median):
            axes.plot([median, median], [row - 0.35, row + 0.35], color=INK, linewidth=2.0)
        never = len(all_runs) - len(finite)
        if never:
            axes.text(0.99, row, f"{never} never", transform=axes.get_yaxis_transform(), ha="right", color=MUTED)
        axes.text(-0.02, row, method, transform=axes.get_yaxis_transform(), ha="right", va="center")
    if not all(np.isfinite(numbers).all() for numbers in values):
        low, high = axes.get_xlim()
        axes.set_xlim(low, high + 0.15 * (high - low))  # room for the runs that never arrive
    axes.set_yticks([])
    axes.set_ylim(len(methods) - 0.4, -0.6)
    axes.set_xlabel(label + "; the bar is the median")
