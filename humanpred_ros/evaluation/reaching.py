"""`humanpred evaluate reaching`: P2's Tables I to III and Figs. 7 and 10, beside predictors that anybody can write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from humanpred_ros.evaluation.framework import Begin, Report, Table, present
from humanpred_ros.evaluation.reaching_plot import draw_reaching
from humanpred_ros.evaluation.reaching_predictors import BETTER, GROUPS
from humanpred_ros.evaluation.reaching_runs import ReachingResult, ReachingSettings, evaluate
from humanpred_ros.evaluation.reaching_scores import DISTANCES, ITSELF, TABLE1, YARDSTICK, ReachingSet, Scores
from humanpred_ros.evaluation.reaching_weights import IMPROVED, LEARNING, PUBLISHED, STATISTICS, influence
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.features import FEATURE_NAMES

#: Where the papers' data folder keeps the interference case, relative to the folder of the demonstrations.
INTERFERENCE_BESIDE_DEMOS = "interference_case"
_DISTANCE_TITLES = ("joint", "task as coded", "task")
_SPREAD = ("sd", "least", "largest")


def measure(settings: ReachingSettings, begin: Begin) -> Report:
    """Evaluate the recordings of a folder.

    Raises:
        HumanPredError: unusable recordings, or unknown predictors.
    """
    model = HumanModel.mocap23()
    recordings = load_reach_recordings(settings.demos, model)
    folder = _interference_folder(settings)
    interference = load_reach_recordings(folder, model) if folder is not None else ()
    return report_of(evaluate(recordings, interference, settings, begin, model))


def _interference_folder(settings: ReachingSettings) -> Path | None:
    if settings.interference is not None:
        return None if settings.interference == "none" else Path(settings.interference)
    beside = Path(settings.demos).resolve().parent / INTERFERENCE_BESIDE_DEMOS
    return beside if beside.is_dir() else None


def run(settings: ReachingSettings, console: Console) -> int:
    """Evaluate, print and write the files that were asked for; return 0 (HumanPredError for what cannot be done)."""
    return present(settings, console, measure)


def report_of(result: ReachingResult) -> Report:
    """Return tables, figures, notes and plot."""
    demos = result.sets[0]
    tables = [
        Table.of_rows(
            "Predictors",
            ("predictor", "kind", "what it does"),
            [(s.name, s.group, s.description) for s in _by_group(demos)],
        )
    ]
    if result.columns:
        tables.append(_weights_table(result))
    if (own := demos.of("own")) is not None:
        tables.append(_own_table(demos, own))
    if result.recovery is not None:
        tables.append(_recovery_table(result))
    tables += [_left_out_table(result, how) for how in (PUBLISHED, IMPROVED) if how in result.learned]
    for entry in result.sets:
        tables.append(_averages_table(entry))
        if len(entry.names) > 1:
            tables += [_each_table(entry, which) for which in range(len(DISTANCES))]
    title = f"Reaches predicted: {', '.join(f'{_many(entry)}, {entry.title}' for entry in result.sets)}"
    return Report(title, tables, json_of(result), tuple(_notes(result)), partial(draw_reaching, result))


def _by_group(entry: ReachingSet) -> list[Scores]:
    return sorted(entry.scores, key=lambda scores: GROUPS.index(scores.group))


def _many(entry: ReachingSet) -> str:
    return "1 reach" if len(entry.names) == 1 else f"{len(entry.names)} reaches"


_DISTANCE_HEADS = (
    ("P2 joint", ".2f"), ("joint", ".2f"), *((f"joint {what}", ".1f") for what in _SPREAD),
    ("P2 task as coded", ".2f"), ("task as coded", ".2f"), *((f"as coded {what}", ".1f") for what in _SPREAD),
    ("task", ".2f"), *((f"task {what}", ".1f") for what in _SPREAD),
)  # fmt: skip


def _cells(values: FloatArray, published: tuple[float, float] | None, runs: int) -> list[float | None]:
    """Return the figures for `_DISTANCE_HEADS` of statistics (4, 3); single runs have no spread."""
    three = [[float(values[0, k]), *(float(values[s, k]) if runs > 1 else None for s in (1, 2, 3))] for k in range(3)]
    joint, task = published or (None, None)
    return [joint, *three[0], task, *three[1], *three[2]]


def _own_table(demos: ReachingSet, own: Scores) -> Table:
    rows: list[list[Any]] = [
        [name, *_cells(values, TABLE1.get(name), own.runs)]
        for name, values in zip(demos.names, own.values, strict=True)
    ]
    row = demos.published_of("own")
    rows.append(["mean", *_cells(own.average, (row.joint_m, row.task_as_coded_m) if row else None, own.runs)])
    title = f"P2 Table I: weights learned from the reach itself; metres, over {own.runs} runs"
    return Table.of_rows(title, ("reach", *_DISTANCE_HEADS), rows)


def _averages_table(entry: ReachingSet) -> Table:
    rows = []
    for scores in _by_group(entry):
        row = entry.published_of(scores.name)
        published = (row.joint_m, row.task_as_coded_m) if row else None
        rows.append([scores.name, *_cells(scores.average, published, scores.runs), scores.predict_ms])
    papers = ", ".join(dict.fromkeys(row.table for row in entry.published if row.predictor != "own"))
    title = f"{papers + ': ' if papers else ''}{_many(entry)}, {entry.title}; metres, averages over the reaches"
    return Table.of_rows(title, ("predictor", *_DISTANCE_HEADS, ("prediction", ".1f", "ms")), rows)


def _each_table(entry: ReachingSet, which: int) -> Table:
    """Return one distance of every reach, their mean, the mean without marked jumps, and wins over the yardstick."""
    marked = any(facts["unfit"] for facts in entry.recordings)
    heads = [(f"{facts['name']}{'*' if facts['unfit'] else ''}", ".2f") for facts in entry.recordings]
    rows: list[list[Any]] = []
    if which < 2 and any(name in TABLE1 for name in entry.names):
        row = entry.published_of("own")
        mean = None if row is None else (row.joint_m, row.task_as_coded_m)[which]
        rows.append(
            ["P2 Table I (own)", *(TABLE1[n][which] if n in TABLE1 else None for n in entry.names), mean, None, None]
        )
    for scores in _by_group(entry):
        fit = entry.average_fit(scores) if marked else None
        wins = None if scores.name in (YARDSTICK, ITSELF) else entry.wins(scores.name, which)
        rows.append(
            [
                scores.name, *scores.values[:, 0, which], scores.average[0, which],
                None if fit is None else fit[0, which], wins,
            ]
        )  # fmt: skip
    return Table.of_rows(
        f"Each reach: {_DISTANCE_TITLES[which]}, metres; wins: on how many it is better than {YARDSTICK}",
        ("predictor", *heads, ("mean", ".2f"), ("mean without *", ".2f"), "wins"),
        rows,
    )


def _weights_table(result: ReachingResult) -> Table:
    heads: list[tuple[str, ...]] = []
    # Weights of normalised features are of all sizes; their influence says more.
    for column in result.columns:
        if column.name != IMPROVED:
            heads.append((column.name, ".1f"))
            heads.append((f"{column.name} ±", ".0f"))
    heads += [(f"{column.name} influence", ".1%") for column in result.columns]
    rows = []
    for k, feature in enumerate(FEATURE_NAMES):
        row: list[Any] = [feature]
        for column in result.columns:
            if column.name != IMPROVED:
                row += [column.weights[k], None if column.spread is None else column.spread[k]]
        rows.append(row + [column.influence[k] for column in result.columns])
    upper = f"{LEARNING[PUBLISHED].piirl.upper:g}"
    note = (
        f"{PUBLISHED}, alone and the authors have the same features, scales and bounds 0 to {upper}, and are "
        "comparable as they stand. Influence: weight x standard deviation of its feature over samples around the "
        "demonstrations, as a share of the sum: comparable among all. "
    )
    note += " ".join(f"{column.name}: {column.description}." for column in result.columns)
    for column in result.columns:
        if column.at_upper:
            note += (
                f" {column.name}: {len(column.at_upper)} of {len(FEATURE_NAMES)} weights are at their upper bound "
                f"({upper}); the data ask for more, and ± 0 there does not mean certain: {', '.join(column.at_upper)}."
            )
    return Table.of_rows("Weights of P2's features", ("feature", *heads), rows, note)


def _recovery_table(result: ReachingResult) -> Table:
    assert result.recovery is not None
    figures = result.recovery
    curves = {f"learned as {how}": values for how, values in figures["learned"].items()}
    curves["best of the samples"] = figures["best_sample"]
    rows = [
        [str(count), *(values[k][what] for values in curves.values() for what in STATISTICS)]
        for k, count in enumerate(figures["samples"])
    ]
    line = figures["line"]
    rows.append(["straight line", *([line[what] for what in STATISTICS] + [None] * 4 * (len(curves) - 1))])
    heads = [
        (name if what == "mean" else f"{name}, {word}", ".2f")
        for name in curves for what, word in zip(STATISTICS, ("mean", *_SPREAD), strict=True)
    ]  # fmt: skip
    return Table.of_rows(
        f"P2 Fig. 7: {figures['demonstrations']} reaches planned with known weights, weights learned from them, and "
        "planned again; by how much that costs more by the known weights, % of the cost of the demonstrations",
        ("samples each", *heads), rows,
        "Mean over the demonstrations, then over repetitions. The straight line is what baseline 0 plans.",
    )  # fmt: skip


def _left_out_table(result: ReachingResult, how: str) -> Table:
    """Return P2 Fig. 10: weights learned leaving out one recording each; of normalised features, their influence."""
    left_out = result.learned[how].table.left_out
    values = np.array(list(left_out.values()))
    title, spec = f"P2 Fig. 10: learned as {how}, leaving out one recording each: weights", ".1f"
    if how != PUBLISHED:
        values, spec = influence(values, result.deviation), ".1%"
        title = title.replace("weights", "influence (weights are in the JSON file)")
    rows = [
        [feature, *values[:, k], values[:, k].mean(), values[:, k].std()] for k, feature in enumerate(FEATURE_NAMES)
    ]
    return Table.of_rows(title, ("feature", *((name, spec) for name in left_out), ("mean", spec), ("sd", spec)), rows)


def _notes(result: ReachingResult) -> Iterator[str]:
    yield (
        "Distances by time warping, metres summed over frames (P2: 100 Hz). joint: centres of pelvis, torso, shoulder, "
        "elbow, wrist; task: palm and its orientation; as coded: with the sign error of P2's code, to compare with P2."
    )
    if not result.obstacles:
        yield "No hand comes near P2's table: learned and planned with only the partner as an obstacle."
    for learned in list(result.learned.values())[:1]:  # other ways to learn say nearly the same
        yield from (f"learning: {text}" for text in learned.notes)
    for entry in result.sets:
        for facts in entry.recordings:
            yield from (f"{facts['name']} {text}" for text in facts["notes"])
            if facts["unfit"]:
                yield f"* {facts['unfit']}: tested; learned from only where P2 is reproduced"
    yield from _caution(result.sets)
    if result.times:
        first = result.times[0]
        yield (
            f"One prediction of {first['recording']}, {first['duration_s']:.2f} s, by one process: "
            + ", ".join(f"{each['predictor']} {each['median_ms']:.1f} ms" for each in result.times)
        )
    if result.learned:
        yield "Learning from all recordings, bootstrap included: " + ", ".join(
            f"{how} {each.learn_s:.1f} s" for how, each in result.learned.items()
        )
    yield f"{result.elapsed_s:.0f} s in all"


def _caution(sets: Sequence[ReachingSet]) -> Iterator[str]:
    """Yield that some predictors were designed on P2's seven reaches, and their scores elsewhere."""
    demos = sets[0]
    chosen = [scores.name for scores in demos.scores if scores.group == BETTER or scores.name == "bow"]
    if not chosen or not demos.published:
        return
    yield (
        f"Caution: {', '.join(chosen)} were designed while looking at these seven reaches, and leaving one out does "
        "not make up for that. Expect less elsewhere."
    )
    for entry in sets[1:]:
        found = [scores for name in (*chosen, YARDSTICK) if (scores := entry.of(name)) is not None]
        yield f"Fairer, though only {_many(entry)}: {entry.title}; joint / task: " + ", ".join(
            f"{s.name} {s.average[0, 0]:.2f} / {s.average[0, 2]:.2f}" for s in found
        )


def json_of(result: ReachingResult) -> dict[str, Any]:
    """Return every figure as plain values, by the names of the JSON file."""

    def distances(values: FloatArray) -> dict[str, Any]:
        return {name: dict(zip(STATISTICS, values[:, k], strict=True)) for k, name in enumerate(DISTANCES)}

    def predictor(entry: ReachingSet, scores: Scores) -> dict[str, Any]:
        fit = entry.average_fit(scores)
        return {
            "name": scores.name,
            "description": scores.description,
            "group": scores.group,
            "runs": scores.runs,
            "recordings": [
                {"recording": name, "figures": distances(values)}
                for name, values in zip(entry.names, scores.values, strict=True)
            ],
            "average": distances(scores.average),
            "average_fit": None if fit is None else distances(fit),
            "predict_ms": scores.predict_ms,
        }

    return {
        "obstacles": result.obstacles,
        "sets": [
            {
                "title": entry.title,
                "recordings": entry.recordings,
                "predictors": [predictor(entry, scores) for scores in entry.scores],
                "published": [asdict(row) for row in entry.published],
                "left_out": entry.left_out,
            }
            for entry in result.sets
        ],
        "table1": {name: TABLE1[name] for name in result.sets[0].names if name in TABLE1},
        "weights": None if not result.columns else _weights_json(result),
        "recovery": result.recovery,
        "times": result.times,
        "elapsed_s": result.elapsed_s,
    }


def _weights_json(result: ReachingResult) -> dict[str, Any]:
    return {
        "features": FEATURE_NAMES,
        "deviation": result.deviation,
        "upper": LEARNING[PUBLISHED].piirl.upper,
        "columns": result.columns,
        "left_out": [
            {
                "how": how,
                "recordings": list(each.table.left_out),
                "weights": (values := np.array(list(each.table.left_out.values()))),
                "influence": influence(values, result.deviation),
            }
            for how, each in result.learned.items()
            if how in (PUBLISHED, IMPROVED)
        ],
        "provenance": {how: each.everything.provenance for how, each in result.learned.items()},
        "notes": {how: each.notes for how, each in result.learned.items()},
        "learn_s": {how: each.learn_s for how, each in result.learned.items()},
        "processor_s": {how: each.processor_s for how, each in result.learned.items()},
    }
