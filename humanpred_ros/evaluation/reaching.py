"""`humanpred evaluate reaching`: P2's Tables I to III and Figs. 7 and 10, beside predictors that anybody can write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

from humanpred_ros.evaluation.framework import Begin, Column, Report, Table
from humanpred_ros.evaluation.reaching_plot import draw_reaching
from humanpred_ros.evaluation.reaching_predictors import BETTER
from humanpred_ros.evaluation.reaching_runs import (
    DISTANCES,
    ITSELF,
    TABLE1,
    YARDSTICK,
    Paths,
    ReachingSettings,
    by_group,
    evaluate,
    many,
    means,
    published_of,
    score_of,
    wins,
)
from humanpred_ros.evaluation.reaching_weights import IMPROVED, PUBLISHED, STATISTICS
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.features import FEATURE_NAMES

#: Where the papers' data folder keeps the interference case, relative to the folder of the demonstrations.
INTERFERENCE_BESIDE_DEMOS = "interference_case"
_TITLES = ("joint", "task as coded", "task")
#: Titles of `STATISTICS` but the mean.
_SPREAD = ("sd", "least", "largest")


def measure(settings: ReachingSettings, begin: Begin) -> Report:
    """Evaluate the recordings of a folder.

    Raises:
        HumanPredError: unusable recordings, or unknown predictors.
    """
    model = HumanModel.mocap23()
    recordings = load_reach_recordings(settings.demos, model)
    folder: Path | None = Path(settings.demos).resolve().parent / INTERFERENCE_BESIDE_DEMOS
    if settings.interference is not None:
        folder = None if settings.interference == "none" else Path(settings.interference)
    elif folder is not None and not folder.is_dir():
        folder = None
    interference = load_reach_recordings(folder, model) if folder is not None else ()
    return report_of(*evaluate(recordings, interference, settings, begin, model))


def report_of(figures: dict[str, Any], paths: Paths) -> Report:
    """Return tables, figures, notes and plot."""
    demos = figures["sets"][0]
    tables = [
        Table.of_rows(
            "Predictors",
            ("predictor", "kind", "what it does"),
            [(p["name"], p["group"], p["description"]) for p in by_group(demos)],
        )
    ]
    if figures["weights"] is not None:
        tables.append(_weights_table(figures["weights"]))
    if (own := score_of(demos, "own")) is not None:
        tables.append(_own_table(demos, own))
    if figures["recovery"] is not None:
        tables.append(_recovery_table(figures["recovery"]))
    tables += [_left_out_table(each) for each in (figures["weights"] or {"left_out": ()})["left_out"]]
    for entry in figures["sets"]:
        tables.append(_averages_table(entry))
        if len(entry["recordings"]) > 1:
            tables += [_each_table(entry, which) for which in range(len(DISTANCES))]
    sets = ", ".join(f"{many(entry)}, {entry['title']}" for entry in figures["sets"])
    return Report(
        f"Reaches predicted: {sets}", tables, figures, tuple(_notes(figures)), partial(draw_reaching, figures, paths)
    )


def _distance_columns() -> Iterator[Column]:
    """Yield the columns of records (name, statistics by distance, published by distance, runs, ms)."""

    def printed(distance: str, record: Any) -> Any:
        return record[2].get(distance)

    def statistic(distance: str, what: str, record: Any) -> Any:
        return record[1][distance][what] if what == "mean" or record[3] > 1 else None  # single runs have no spread

    for distance, title in zip(DISTANCES, _TITLES, strict=True):
        if distance != "task_m":
            yield Column(f"P2 {title}", partial(printed, distance), ".2f")
        yield Column(title, partial(statistic, distance, "mean"), ".2f")
        for what, word in zip(STATISTICS[1:], _SPREAD, strict=True):
            yield Column(f"{title} {word}", partial(statistic, distance, what), ".1f")


_NAME = itemgetter(0)
_DISTANCES = tuple(_distance_columns())


def _own_table(demos: Mapping[str, Any], own: Mapping[str, Any]) -> Table:
    records = [
        (r["recording"], r["figures"], dict(zip(DISTANCES, TABLE1.get(r["recording"], ()), strict=False)), own["runs"])
        for r in own["recordings"]
    ]
    records.append(("mean", own["average"], published_of(demos, "own"), own["runs"]))
    title = f"P2 Table I: weights learned from the reach itself; metres, over {own['runs']} runs"
    return Table(title, records, (Column("reach", _NAME), *_DISTANCES))


def _averages_table(entry: Mapping[str, Any]) -> Table:
    records = [
        (p["name"], p["average"], published_of(entry, p["name"]), p["runs"], p["predict_ms"]) for p in by_group(entry)
    ]
    papers = ", ".join(dict.fromkeys(row["table"] for row in entry["published"] if row["predictor"] != "own"))
    title = f"{papers + ': ' if papers else ''}{many(entry)}, {entry['title']}; metres, averages over the reaches"
    prediction = Column("prediction", lambda record: record[4], ".1f", "ms")
    return Table(title, records, (Column("predictor", _NAME), *_DISTANCES, prediction))


def _each_table(entry: Mapping[str, Any], which: int) -> Table:
    """Return one distance of every reach, their mean, the mean without marked jumps, and wins over the yardstick."""
    distance, recordings = DISTANCES[which], entry["recordings"]
    marked = any(facts["unfit"] for facts in recordings)
    heads = [(f"{facts['name']}{'*' if facts['unfit'] else ''}", ".2f") for facts in recordings]
    rows: list[list[Any]] = []
    if which < 2 and any(facts["name"] in TABLE1 for facts in recordings):
        theirs = [TABLE1[facts["name"]][which] if facts["name"] in TABLE1 else None for facts in recordings]
        rows.append(["P2 Table I (own)", *theirs, published_of(entry, "own").get(distance), None, None])
    for p in by_group(entry):
        fit = p["average_fit"][distance]["mean"] if marked and p["average_fit"] else None
        won = None if p["name"] in (YARDSTICK, ITSELF) else wins(entry, p["name"], distance)
        rows.append([p["name"], *means(p, distance), p["average"][distance]["mean"], fit, won])
    return Table.of_rows(
        f"Each reach: {_TITLES[which]}, metres; wins: on how many it is better than {YARDSTICK}",
        ("predictor", *heads, ("mean", ".2f"), ("mean without *", ".2f"), "wins"),
        rows,
    )


def _weights_table(weights: Mapping[str, Any]) -> Table:
    columns, upper = weights["columns"], f"{weights['upper']:g}"
    shown: list[Column] = [Column("feature", FEATURE_NAMES.__getitem__)]
    for column in columns:
        # Weights of normalised features are of all sizes; their influence says more.
        if column["name"] != IMPROVED:
            shown.append(Column(column["name"], column["weights"].__getitem__, ".1f"))
            if column["spread"] is not None:
                shown.append(Column(f"{column['name']} ±", column["spread"].__getitem__, ".0f"))
    shown += [Column(f"{column['name']} influence", column["influence"].__getitem__, ".1%") for column in columns]
    note = (
        f"{PUBLISHED}, alone and the authors have the same features, scales and bounds 0 to {upper}, and are "
        "comparable as they stand. Influence: weight x standard deviation of its feature over samples around the "
        "demonstrations, as a share of the sum: comparable among all. "
    )
    note += " ".join(f"{column['name']}: {column['description']}." for column in columns)
    for column in columns:
        if stopped := column["at_upper"]:
            note += (
                f" {column['name']}: {len(stopped)} of {len(FEATURE_NAMES)} weights are at their upper bound "
                f"({upper}); the data ask for more, and ± 0 there does not mean certain: {', '.join(stopped)}."
            )
    return Table("Weights of P2's features", range(len(FEATURE_NAMES)), shown, note)


def _recovery_table(figures: Mapping[str, Any]) -> Table:
    curves = {f"learned as {how}": values for how, values in figures["learned"].items()}
    curves["best of the samples"] = figures["best_sample"]
    rows = [
        [str(count), *(values[k][what] for values in curves.values() for what in STATISTICS)]
        for k, count in enumerate(figures["samples"])
    ]
    line = [figures["line"][what] for what in STATISTICS]
    rows.append(["straight line", *line, *[None] * (len(STATISTICS) * (len(curves) - 1))])
    heads = [(name if word == "mean" else f"{name}, {word}", ".2f") for name in curves for word in ("mean", *_SPREAD)]
    return Table.of_rows(
        f"P2 Fig. 7: {figures['demonstrations']} reaches planned with known weights, weights learned from them, and "
        "planned again; by how much that costs more by the known weights, % of the cost of the demonstrations",
        ("samples each", *heads), rows,
        "Mean over the demonstrations, then over repetitions. The straight line is what baseline 0 plans.",
    )  # fmt: skip


def _left_out_table(left_out: Mapping[str, Any]) -> Table:
    """Return P2 Fig. 10: weights learned leaving out one recording each; of normalised features, their influence."""
    how = left_out["how"]
    what, key, spec = "weights", "weights", ".1f"
    if how != PUBLISHED:
        what, key, spec = "influence (weights are in the JSON file)", "influence", ".1%"
    values = left_out[key]
    rows = [
        [feature, *values[:, k], values[:, k].mean(), values[:, k].std()] for k, feature in enumerate(FEATURE_NAMES)
    ]
    heads: list[str | tuple[str, ...]] = [
        "feature",
        *((name, spec) for name in left_out["recordings"]),
        ("mean", spec),
        ("sd", spec),
    ]
    return Table.of_rows(f"P2 Fig. 10: learned as {how}, leaving out one recording each: {what}", heads, rows)


def _notes(figures: Mapping[str, Any]) -> Iterator[str]:
    sets, weights = figures["sets"], figures["weights"]
    yield (
        "Distances by time warping, metres summed over frames (P2: 100 Hz). joint: centres of pelvis, torso, shoulder, "
        "elbow, wrist; task: palm and its orientation; as coded: with the sign error of P2's code, to compare with P2."
    )
    if not figures["obstacles"]:
        yield "No hand comes near P2's table: learned and planned with only the partner as an obstacle."
    if weights is not None:
        # Other ways to learn say nearly the same.
        yield from (f"learning: {text}" for text in next(iter(weights["notes"].values())))
    for entry in sets:
        for facts in entry["recordings"]:
            yield from (f"{facts['name']} {text}" for text in facts["notes"])
            if facts["unfit"]:
                yield f"* {facts['unfit']}: tested; learned from only where P2 is reproduced"
    yield from _caution(sets)
    if times := figures["times"]:
        yield (
            f"One prediction of {times[0]['recording']}, {times[0]['duration_s']:.2f} s, by one process: "
            + ", ".join(f"{each['predictor']} {each['median_ms']:.1f} ms" for each in times)
        )
    if weights is not None:
        spent = (f"{how} {learn_s:.1f} s" for how, learn_s in weights["learn_s"].items())
        yield f"Learning from all recordings, bootstrap included: {', '.join(spent)}"
    yield f"{figures['elapsed_s']:.0f} s in all"


def _caution(sets: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield that some predictors were designed on P2's seven reaches, and their scores elsewhere."""
    chosen = [p["name"] for p in sets[0]["predictors"] if p["group"] == BETTER or p["name"] == "bow"]
    if not chosen or not sets[0]["published"]:
        return
    yield (
        f"Caution: {', '.join(chosen)} were designed while looking at these seven reaches, and leaving one out does "
        "not make up for that. Expect less elsewhere."
    )
    for entry in sets[1:]:
        found = [predictor for name in (*chosen, YARDSTICK) if (predictor := score_of(entry, name)) is not None]
        yield f"Fairer, though only {many(entry)}: {entry['title']}; joint / task: " + ", ".join(
            f"{p['name']} {p['average']['joint_m']['mean']:.2f} / {p['average']['task_m']['mean']:.2f}" for p in found
        )
