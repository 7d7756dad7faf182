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
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros.errors import UsageError
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
)
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.run_plots import draw_interference
from humanpred_ros.evaluation.simulation import METHODS, RunSettings, SimulationSettings, first_of_classes
from humanpred_ros.motion.csv_files import read_records
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.settings import setting

#: Table I's scene.
TABLE_SCENE = "side_by_side"
#: Where the papers' data folder keeps Table I, relative to the folder that a library lies in, and its name of ours.
TABLE1_BESIDE_LIBRARY = Path("reference") / "table1_runs.csv"
_PUBLISHED_OURS = "least_penetration"
#: A person's way crosses the arm's if basic STOMP comes closer than this.
CROSSING_M = 0.10
#: So many are listed of what may be many: contacts of methods that do not predict, and runs that reach no goal.
_LISTED = 20


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


def read_table1(folder: Path) -> dict[int, dict[str, float]]:
    """Return P1's Table I by global id: mean and sd of both planners and their ratio; empty if it is not in a folder.

    Raises:
        UsageError: a file without the columns human_traj_id, planner, run and cost.
        LibraryFormatError: a file that cannot be read, or is empty.
    """
    path = folder / TABLE1_BESIDE_LIBRARY
    if not path.is_file():
        return {}
    costs: dict[int, dict[str, list[float]]] = {}
    try:
        for row in read_records(path):
            planner = "ours" if row["planner"] == _PUBLISHED_OURS else "basic"
            costs.setdefault(int(row["human_traj_id"]), {"ours": [], "basic": []})[planner].append(float(row["cost"]))
        if not all(len(values) for of_motion in costs.values() for values in of_motion.values()):
            raise ValueError("a trajectory with the runs of one planner only")
    except (KeyError, ValueError) as trouble:
        raise UsageError(
            f"{path}: wanted a CSV file with the columns human_traj_id, planner ({_PUBLISHED_OURS} and another), run "
            f"and cost, got {type(trouble).__name__}: {trouble}; correct or remove it"
        ) from trouble
    rows = {}
    for number, of_motion in costs.items():
        rows[number] = {f"{name}_mean": float(np.mean(values)) for name, values in of_motion.items()}
        for name, values in of_motion.items():
            rows[number][f"{name}_sd"] = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
        rows[number]["ratio"] = rows[number]["basic_mean"] / rows[number]["ours_mean"]
    return rows


Pairs = Sequence[tuple[RunTask, PersonOutcome]]


def _table1(
    library: MotionLibrary, settings: InterferenceSettings, pairs: Pairs, published: Mapping[int, dict[str, float]]
) -> list[dict[str, Any]]:
    # The papers' global id: the running number over the sorted classes.
    ordered = sorted(library, key=lambda motion: (-1 if motion.label is None else motion.label, motion.index))
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
