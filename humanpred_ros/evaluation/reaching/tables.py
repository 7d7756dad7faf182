"""The evaluation of reaches as tables in the terminal: published, trivial and predicted side by side."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from humanpred_ros.evaluation.reaching.entry import BETTER, GROUPS
from humanpred_ros.evaluation.reaching.evaluation_result import ReachingEvaluation
from humanpred_ros.evaluation.reaching.result import DISTANCES, DistanceFigures, ReachingSet, Statistic
from humanpred_ros.evaluation.reaching.sets import ITSELF
from humanpred_ros.evaluation.reaching.weight_tables import print_left_out, print_recovery, print_weights
from humanpred_ros.evaluation.target import targets_table
from humanpred_ros.evaluation.text import figure_table, headline, line

_COLUMNS = ("joint", "task as coded", "task")
_YARDSTICK = "minimum_jerk"


def print_reaching(evaluation: ReachingEvaluation, console: Console) -> None:
    """Print weights, distances, what is doubtful about the recordings and about the figures, and the targets."""
    demos = evaluation.sets[0]
    console.print(_legend(demos))
    line(
        console,
        "Distances by time warping, metres summed over frames (P2: 100 Hz). joint: centres of pelvis, torso, shoulder, "
        "elbow, wrist; task: palm and its orientation; as coded: with the sign error of P2's code, to compare with P2.",
    )
    if not evaluation.settings["obstacles"]:
        line(console, "No hand comes near P2's table: learned and planned with nothing but the partner in the way.")
    if evaluation.weights is not None:
        print_weights(evaluation.weights, console)
    _print_own(evaluation, console)
    if evaluation.recovery is not None:
        print_recovery(evaluation.recovery, console)
    if evaluation.weights is not None:
        print_left_out(evaluation.weights, console)
    for entry in evaluation.sets:
        _print_set(evaluation, entry, console)
    _print_caution(evaluation.sets, console)
    if evaluation.times:
        _print_times(evaluation, console)
    if evaluation.targets:
        headline(console, "Reference values (computed elsewhere from the same recordings) and targets")
        console.print(targets_table(evaluation.targets))
    line(console, f"{evaluation.elapsed_s:.0f} s in all, on {evaluation.machine['usable_cores']} cores")


def _legend(demos: ReachingSet) -> Table:
    table = figure_table("predictor", "", "what it does")
    for group in GROUPS:
        for figures in demos.predictors:
            if figures.group == group:
                table.add_row(figures.name, group, figures.description)
    return table


def _print_own(evaluation: ReachingEvaluation, console: Console) -> None:
    """Print P2's Table I: predictions with weights learned from the predicted reach itself."""
    own = evaluation.sets[0].predictor("own")
    if own is None:
        return
    headline(
        console,
        f"P2 Table I: weights learned from the reach itself; average and over {own.runs} runs (sd, least, largest)",
    )
    table = figure_table("", "P2\njoint", "joint", "P2 task\nas coded", "task as coded", "task")
    for entry in own.recordings:
        published = evaluation.table1.get(entry.recording)
        table.add_row(entry.recording, *_beside(entry.figures, published, own.runs))
    row = evaluation.sets[0].published_of("own")
    table.add_section()
    table.add_row("mean", *_beside(own.average, (row.joint_m, row.task_as_coded_m) if row else None, own.runs))
    console.print(table)


def _beside(figures: DistanceFigures, published: tuple[float, float] | None, runs: int) -> list[str]:
    """Return the cells published joint, joint, published task, task as coded, task."""
    joint, task = ("–", "–") if published is None else (f"{value:.2f}" for value in published)
    return [
        joint, _spread(figures.joint_m, runs), task, _spread(figures.task_as_coded_m, runs),
        _spread(figures.task_m, runs),
    ]  # fmt: skip


def _print_set(evaluation: ReachingEvaluation, entry: ReachingSet, console: Console) -> None:
    tables = ", ".join(dict.fromkeys(row.table for row in entry.published if row.predictor != "own"))
    headline(
        console,
        f"{tables + ': ' if tables else ''}{_many(entry)}, {entry.title}; average, and over runs (sd, least, largest)",
    )
    console.print(_averages(entry))
    if len(entry.names) > 1:
        for which, title in enumerate(_COLUMNS):
            headline(console, f"Each reach: {title}; wins: on how many it is better than {_YARDSTICK}")
            console.print(_each(evaluation, entry, which))
    for facts in entry.recordings:
        for text in facts["notes"]:
            line(console, f"{facts['name']} {text}")
        if facts["unfit"]:
            line(console, f"* {facts['unfit']}: tested; learned from only where P2 is reproduced")


def _averages(entry: ReachingSet) -> Table:
    table = figure_table("", "P2\njoint", "joint", "P2 task\nas coded", "task as coded", "task", "ms")
    for group in GROUPS:
        for figures in (found for found in entry.predictors if found.group == group):
            row, average = entry.published_of(figures.name), figures.average
            table.add_row(
                figures.name,
                *_beside(average, (row.joint_m, row.task_as_coded_m) if row else None, figures.runs),
                f"{figures.predict_ms:.1f}" if figures.predict_ms == figures.predict_ms else "–",
            )
        table.add_section()
    return table


def _each(evaluation: ReachingEvaluation, entry: ReachingSet, which: int) -> Table:
    """Return one distance of every reach, their mean, the mean without marked jumps, and wins over minimum jerk."""
    titles = [f"{f['name']}{'*' if f['unfit'] else ''}\n{f['duration_s']:.2f} s" for f in entry.recordings]
    marked = any(facts["unfit"] for facts in entry.recordings)
    table = figure_table("", *titles, "mean", *(["mean\nwithout *"] if marked else []), "wins")
    if which < 2 and any(name in evaluation.table1 for name in entry.names):
        published = [evaluation.table1.get(name) for name in entry.names]
        row = entry.published_of("own")
        mean = "–" if row is None else f"{(row.joint_m, row.task_as_coded_m)[which]:.2f}"
        cells = ["–" if found is None else f"{found[which]:.2f}" for found in published]
        table.add_row("P2 Table I (own)", *cells, mean, *(["–"] if marked else []), "–")
        table.add_section()
    for group in GROUPS:
        for figures in (found for found in entry.predictors if found.group == group):
            wins = entry.better_than(figures.name, _YARDSTICK, DISTANCES[which])
            fit = figures.average_fit
            table.add_row(
                figures.name,
                *(f"{figures.of(name).means[which]:.2f}" for name in entry.names),
                f"{figures.average.means[which]:.2f}",
                *(["–" if fit is None else f"{fit.means[which]:.2f}"] if marked else []),
                "–" if wins is None or figures.name in (_YARDSTICK, ITSELF) else str(wins),
            )
        table.add_section()
    return table


def _print_caution(sets: Sequence[ReachingSet], console: Console) -> None:
    demos = sets[0]
    chosen = [found.name for found in demos.predictors if found.group == BETTER or found.name == "bow"]
    if not chosen or not demos.published:
        return
    line(
        console,
        f"Caution: {', '.join(chosen)} were designed while looking at these seven reaches, and leaving one out does "
        "not make up for that. Expect less elsewhere.",
    )
    for entry in sets[1:]:
        figures = [found for name in (*chosen, _YARDSTICK) if (found := entry.predictor(name)) is not None]
        line(
            console,
            f"Fairer, though only {_many(entry)}: {entry.title}; joint / task: "
            + ", ".join(f"{f.name} {f.average.joint_m.mean:.2f} / {f.average.task_m.mean:.2f}" for f in figures),
        )


def _print_times(evaluation: ReachingEvaluation, console: Console) -> None:
    first = evaluation.times[0]
    line(
        console,
        f"One prediction of {first.recording}, {first.duration_s:.2f} s, by one process, before the others begin: "
        + ", ".join(f"{t.predictor} {t.median_ms:.1f} ms" for t in evaluation.times),
    )
    if evaluation.weights is not None:
        line(
            console,
            "Learning from all recordings, bootstrap included: "
            + ", ".join(f"{how} {learn_s:.1f} s" for how, learn_s in evaluation.weights.learn_s.items()),
        )


def _many(entry: ReachingSet) -> str:
    return "1 reach" if len(entry.names) == 1 else f"{len(entry.names)} reaches"


def _spread(statistic: Statistic, runs: int) -> str:
    if runs == 1:
        return f"{statistic.mean:.2f}"
    return f"{statistic.mean:.2f} ({statistic.sd:.1f}, {statistic.low:.1f}, {statistic.high:.1f})"
