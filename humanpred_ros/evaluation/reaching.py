"""`humanpred evaluate reaching`: P2's Tables I to III and Figs. 7 and 10, beside predictors that anybody can write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from humanpred_ros.evaluation.framework import Begin, Column, Report, Table
from humanpred_ros.evaluation.reaching_predictors import GROUPS
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
)
from humanpred_ros.evaluation.reaching_weights import IMPROVED, PUBLISHED, STATISTICS
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.features import FEATURE_NAMES, NAMED_WEIGHTS
from humanpred_ros.viewing.figures import INK, MARKERS, MUTED, SERIES, new_figure, note

#: Where the papers' data folder keeps the interference case, relative to the folder of the demonstrations.
INTERFERENCE_BESIDE_DEMOS = "interference_case"
_TITLES = ("joint", "task as coded", "task")
#: Titles of `STATISTICS` but the mean.
_SPREAD = ("sd", "least", "largest")
#: Predictors whose paths are drawn; more would hide each other.
_DRAWN = ("minimum_jerk", "learned", "improved")
_MOST_DRAWN = 4
_COLUMNS, _PATHS_IN, _ROW_IN = 4, 3.6, 0.19
_GROUP_COLOURS = (MUTED, SERIES[4], SERIES[0], SERIES[1], INK)
_PUBLISHED_MARK: dict[str, Any] = {"markersize": 4.0, "markerfacecolor": "white", "markeredgecolor": INK}


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


def draw_reaching(figures: Mapping[str, Any], paths: Paths) -> Figure:
    """Return the plot: wrists from above and their height over time, distances, weights."""
    sets, weights, recovery = figures["sets"], figures["weights"], figures["recovery"]
    drawn = [(entry, facts["name"]) for entry in sets for facts in entry["recordings"]]
    path_rows = -(-len(drawn) // _COLUMNS)
    heights = [_PATHS_IN] * path_rows + [1.0 + _ROW_IN * len(entry["predictors"]) for entry in sets]
    left_out = [each["weights"] for each in (weights or {"left_out": ()})["left_out"] if each["how"] == PUBLISHED]
    if weights is not None or recovery is not None:
        heights.append(0.9 + _ROW_IN * (len(FEATURE_NAMES) if left_out else 12))
    figure = new_figure(sum(heights) + 0.3)
    figure.set_facecolor("white")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    names = list(dict.fromkeys(name for entry in sets for name in _drawn(entry)))
    styles: dict[str, dict[str, Any]] = {
        name: {"color": SERIES[k % len(SERIES)], "linestyle": "--" if k >= len(SERIES) else "-"}
        for k, name in enumerate(names)
    }
    for row in range(path_rows):
        cells = grid[row].subgridspec(2, _COLUMNS, height_ratios=[3, 2])
        for column, (entry, recording) in enumerate(drawn[row * _COLUMNS : (row + 1) * _COLUMNS]):
            above, over_time = (figure.add_subplot(cells[part, column]) for part in (0, 1))
            above.set_title(recording)
            _draw_path(above, over_time, paths[ITSELF, recording], {"color": INK, "linewidth": 2.4})
            above.plot(*paths[ITSELF, recording][0, :2], "o", color=INK, markersize=4.0)
            for name in _drawn(entry):
                _draw_path(above, over_time, paths[name, recording], {"linewidth": 1.4, **styles[name]})
            above.set_aspect("equal", adjustable="datalim")
            above.set_xlabel("from above: x, m")
            over_time.set_xlabel("% of the duration")
            if column == 0:
                above.set_ylabel("y, m")
                over_time.set_ylabel("wrist height, m")
    for row, entry in enumerate(sets, start=path_rows):
        cells = grid[row].subgridspec(1, len(DISTANCES))
        _draw_distances([figure.add_subplot(cells[k]) for k in range(len(DISTANCES))], entry)
    if weights is not None or recovery is not None:
        cells = grid[len(heights) - 1].subgridspec(1, 2)
        _draw_recovery(figure.add_subplot(cells[0]), recovery)
        _draw_weights(figure.add_subplot(cells[1]), left_out[0] if left_out else None)
    handles = [Line2D([], [], color=INK, linewidth=2.4, label="real wrist (dot: start)")]
    handles += [Line2D([], [], label=name, **style) for name, style in styles.items()]
    figure.legend(handles=handles, ncols=len(handles), loc="outside upper center")
    return figure


def _drawn(entry: Mapping[str, Any]) -> list[str]:
    names = [predictor["name"] for predictor in entry["predictors"] if predictor["name"] != ITSELF]
    return [name for name in _DRAWN if name in names] or names[:_MOST_DRAWN]


def _draw_path(above: Axes, over_time: Axes, path: FloatArray, style: Mapping[str, Any]) -> None:
    above.plot(path[:, 0], path[:, 1], **style)
    over_time.plot(np.linspace(0.0, 100.0, len(path)), path[:, 2], **style)


def _draw_distances(panels: Sequence[Axes], entry: Mapping[str, Any]) -> None:
    """Draw one panel for each distance; bars that would dwarf all others are cut off, with their value."""
    ordered, rows = by_group(entry), np.arange(len(entry["predictors"]))
    titles = [
        f"{many(entry)} ({entry['published'][-1]['table']}): joint" if entry["published"] else f"{many(entry)}: joint"
    ]
    titles += ["task as coded", "task"]
    units = ("m summed over frames (◇: published)", "m (line: least to largest run)", f"m (dotted: {YARDSTICK})")
    for which, (axes, distance) in enumerate(zip(panels, DISTANCES, strict=True)):
        published = [published_of(entry, predictor["name"]).get(distance, np.nan) for predictor in ordered]
        averages = [predictor["average"][distance] for predictor in ordered]
        end = _end([average["high"] for average in averages] + published)
        for row, (predictor, average, printed) in enumerate(zip(ordered, averages, published, strict=True)):
            value, least, largest = (average[what] for what in ("mean", "low", "high"))
            axes.barh(row, min(value, end), 0.75, color=_GROUP_COLOURS[GROUPS.index(predictor["group"])])
            if largest > least:
                axes.plot([least, largest], [row, row], color=INK, linewidth=0.9)
            if np.isfinite(printed):
                axes.plot(printed, row, "D", **_PUBLISHED_MARK)
            if value >= end:
                axes.text(end, row, f"{value:.1f} ", va="center", ha="right", color="white", fontsize=7.0)
            else:
                offset: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 7.0}
                axes.annotate(f"{value:.1f}", (np.nanmax([largest, printed]), row), (5.0, 0.0), **offset)
        if (yardstick := score_of(entry, YARDSTICK)) is not None:
            axes.axvline(yardstick["average"][distance]["mean"], color=INK, linewidth=0.9, linestyle=":")
        axes.set_title(titles[which])
        axes.set_xlabel(units[which])
        axes.set_yticks(rows, [predictor["name"] if which == 0 else "" for predictor in ordered])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.12 * end)
        axes.grid(axis="y", visible=False)


def _draw_recovery(axes: Axes, figures: Mapping[str, Any] | None) -> None:
    """Draw averages with bands from the least to the largest repetition."""
    axes.set_title("known weights learned again (P2 Fig. 7)")
    if figures is None:
        note(axes, "left out")
        return
    samples = figures["samples"]
    curves = {f"learned as {how}": values for how, values in figures["learned"].items()}
    for k, (name, values) in enumerate({**curves, "best of the samples": figures["best_sample"]}.items()):
        mean, low, high = ([value[what] for value in values] for what in ("mean", "low", "high"))
        axes.plot(samples, mean, color=SERIES[k], marker=MARKERS[k], markersize=4.0, label=name)
        axes.fill_between(samples, low, high, color=SERIES[k], alpha=0.15)
    axes.axhline(figures["line"]["mean"], color=INK, linewidth=1.0, linestyle=":", label="straight line")
    axes.set_xscale("log")
    axes.set_xticks(samples, [str(count) for count in samples])
    axes.minorticks_off()
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("samples around each demonstration")
    axes.set_ylabel("cost above the demonstrations', %")
    axes.legend(loc="upper right")


def _draw_weights(axes: Axes, left_out: FloatArray | None) -> None:
    """Draw a row for each feature: a dot for each recording left out (R, 24), a mark for the authors' weight."""
    axes.set_title("weights leaving one out (P2 Fig. 10)")
    if left_out is None:
        note(axes, "nothing was learned as published")
        return
    rows = np.arange(len(FEATURE_NAMES))
    for k, (offset, weights) in enumerate(zip(np.linspace(-0.3, 0.3, len(left_out)), left_out, strict=True)):
        label = "learned, one dot for each left out" if k == 0 else None
        axes.plot(weights, rows + offset, "o", color=SERIES[0], markersize=2.6, linestyle="none", label=label)
    label = "authors, mean of single ones"
    axes.plot(NAMED_WEIGHTS["authors_static"], rows, "D", linestyle="none", label=label, **_PUBLISHED_MARK)
    axes.set_yticks(rows, list(FEATURE_NAMES))
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel("weight")
    axes.margins(x=0.04)
    axes.legend(loc="upper center", bbox_to_anchor=(0.3, -0.1), ncols=2)


def _end(values: Sequence[float]) -> float:
    """Return where to end the axis: at the largest value, unless that is far beyond the others."""
    finite = sorted(value for value in values if np.isfinite(value))
    if len(finite) < 3:
        return finite[-1] if finite else 1.0
    second = finite[-2] if finite[-2] < finite[-1] else finite[-3]
    return float(finite[-1] if finite[-1] < 1.5 * second else 1.15 * second)
