"""`humanpred evaluate reaching`: P2's Tables I to III and Figs. 7 and 10, beside predictors that anybody can write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

from humanpred_ros.evaluation.framework import Begin, Column, Report, Table
from humanpred_ros.evaluation.reaching_plot import draw_reaching
from humanpred_ros.evaluation.reaching_runs import (
    DISTANCES,
    TABLE1,
    Paths,
    ReachingSettings,
    by_group,
    evaluate,
    many,
    means,
    published_of,
    score_of,
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
    """Return one distance of every reach, and their mean."""
    distance, recordings = DISTANCES[which], entry["recordings"]
    heads = [(f"{facts['name']}{'*' if facts['unfit'] else ''}", ".2f") for facts in recordings]
    rows: list[list[Any]] = []
    if which < 2 and any(facts["name"] in TABLE1 for facts in recordings):
        theirs = [TABLE1[facts["name"]][which] if facts["name"] in TABLE1 else None for facts in recordings]
        rows.append(["P2 Table I (own)", *theirs, published_of(entry, "own").get(distance)])
    for p in by_group(entry):
        rows.append([p["name"], *means(p, distance), p["average"][distance]["mean"]])
    return Table.of_rows(f"Each reach: {_TITLES[which]}, metres", ("predictor", *heads, ("mean", ".2f")), rows)


def _weights_table(weights: Mapping[str, Any]) -> Table:
    columns, upper = weights["columns"], f"{weights['upper']:g}"
    shown: list[Column] = [Column("feature", FEATURE_NAMES.__getitem__)]
    for column in columns:
        shown.append(Column(column["name"], column["weights"].__getitem__, _spec(column["name"])))
        if column["spread"] is not None:
            shown.append(Column(f"{column['name']} ±", column["spread"].__getitem__, _spec(column["name"])))
    note = (
        f"{PUBLISHED}, alone and the authors have the same features, scales and bounds 0 to {upper}, and are "
        f"comparable as they stand; {IMPROVED} has features in units of their spread. "
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
    """Return P2 Fig. 10: weights learned leaving out one recording each."""
    how, values, spec = left_out["how"], left_out["weights"], _spec(left_out["how"])
    rows = [
        [feature, *values[:, k], values[:, k].mean(), values[:, k].std()] for k, feature in enumerate(FEATURE_NAMES)
    ]
    heads = [(name, spec) for name in (*left_out["recordings"], "mean", "sd")]
    title = f"P2 Fig. 10: weights learned as {how}, leaving out one recording each"
    return Table.of_rows(title, ["feature", *heads], rows)


def _spec(how: str) -> str:
    """Return the format of weights; those of normalised features are of all sizes."""
    return ".2g" if how == IMPROVED else ".1f"


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
    if weights is not None:
        spent = (f"{how} {learn_s:.1f} s" for how, learn_s in weights["learn_s"].items())
        yield f"Learning from all recordings, bootstrap included: {', '.join(spent)}"
    yield f"{figures['elapsed_s']:.0f} s in all"
