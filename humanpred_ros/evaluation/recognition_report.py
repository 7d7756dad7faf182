"""The tables and the plot of the evaluation of recognition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from humanpred_ros.evaluation.framework import Column, Table
from humanpred_ros.evaluation.recognition_scores import PERCENTS, REFUSAL_THRESHOLD
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, MUTED, SERIES, new_figure, note

_PANEL_IN = (4.3, 3.9)
#: Area of the marker of a bin that holds everything, in square points.
_FULL_AREA = 420.0
_LEAST_AREA = 14.0
_NAME = Column("classifier", "name")


def recognition_tables(
    results: Sequence[dict[str, Any]], labels: Sequence[str], reference: Mapping[str, Any] | None
) -> Iterator[Table]:
    """Give the tables of classifiers side by side, and of what the default one takes each class for.

    Args:
        results: figures of the classifiers (`evaluate_classifier`).
        labels: classes of the library.
        reference: the published curve (`read_reference`).
    """
    yield _curve_table(results, reference)
    yield Table(
        "How good the probabilities are",
        results,
        (
            _NAME,
            *(Column(f"log-loss, clipped at {clip}", f"log_loss/{clip}", ".3f") for clip in results[0]["log_loss"]),
            Column("Brier score", "brier", ".3f"),
            Column("calibration error", "calibration/error_mean", ".3f"),
            Column("  its floor", "calibration/floor_mean", ".3f"),
            Column("  percents pooled", "calibration/error_pooled", ".3f"),
            Column("  floor of that", "calibration/floor_pooled", ".3f"),
            Column("  no class counted", "calibration_with_unknown/error_mean", ".3f"),
            Column("  its own floor", "calibration_with_unknown/floor_mean", ".3f"),
        ),
        "Calibration error: mean over the motion. Floor: what perfect calibration would show with so few motions.",
    )
    if results[0]["speeds"]:
        yield Table(
            "The same motions done faster or slower",
            [{"name": result["name"], **score} for result in results for score in result["speeds"]],
            (
                _NAME,
                Column("speed", "speed", "g"),
                Column("points lost", "worst_drop_points", ".1f"),
                Column("at", "worst_drop_percent", "d", "%"),
            ),
            "Points lost: percentage points below the rate at the recorded speed, at worst, beyond 40 % of the motion.",
        )
    on_known = [(p, f"unknown_on_known/{p}") for p in results[0]["unknown_on_known"]]
    yield Table(
        "Motions of no known class",
        results,
        (
            _NAME,
            *(Column(f"p of no class, known motions, {p} %", path, ".0%") for p, path in on_known),
            Column("AUROC at 60 %", "unknown/auroc_at_60", ".3f"),
            Column("unknown refused at 60 %", lambda r: _if_it_speaks(r, "refused_unknown"), ".1%"),
            Column("known refused at 60 %", lambda r: _if_it_speaks(r, "refused_known"), ".1%"),
        ),
        f"Refused: the probability of no class is at least {REFUSAL_THRESHOLD:g}.",
    )
    yield Table(
        "Times",
        results,
        (
            _NAME,
            Column("postures refused", "refused_postures"),
            Column("fit of the whole library", "timing/fit_s", ".2f", "s"),
            Column("one posture", "timing/update_us", ".0f", "µs"),
            Column("99 % below", "timing/update_us_p99", ".0f", "µs"),
            Column("evaluation", "timing/wall_s", ".0f", "s"),
            Column("processor time", "timing/cpu_s", ".0f", "s"),
        ),
    )
    shown = next((result for result in results if result["name"] == DEFAULT_CLASSIFIER), results[0])
    counts = shown["confusion_at_60"]
    taken_for = [*labels] + ["undecided"] * bool(counts[:, -1].any())
    yield Table.of_rows(
        f"{shown['name']}: true class (rows) taken for, at 60 % of the motion",
        ("true class", *taken_for),
        [(f"class {label}", *row[: len(taken_for)].tolist()) for label, row in zip(labels, counts, strict=True)],
    )


def _curve_table(results: Sequence[dict[str, Any]], reference: Mapping[str, Any] | None) -> Table:
    records: list[dict[str, Any]] = []
    for result in results:
        records.append(result)
        for group in result["groups"]:
            name = f"{result['name']}, {group['group']} ({group['n_motions']})"
            records.append({"name": name, "figures": group["figures"], "learned_of_class": None, "reference_rms": None})
    if reference is not None:
        records.append({**reference, "name": "published", "learned_of_class": None, "reference_rms": None})
    note = "Recognised from: percent of the motion seen, from which on it stays so."
    if results[0]["groups"]:
        note += " Excluded, suspect: flagged in outliers.csv beside the library; all other figures count every motion."
    if any(result["name"] == "reaching" for result in results):
        note += (
            " reaching has seen no motion of the class it is tested on, only where its other motions go; the others "
            "learned from the class's other motions. Unknown motions: it does not know the place either."
        )
    columns = (
        _NAME,
        Column("known of the class", "learned_of_class"),
        Column("half recognised from", lambda r: r["figures"]["first_50_percent"] or "never", unit="%"),
        Column("90 % recognised from", lambda r: r["figures"]["first_90_percent"] or "never", unit="%"),
        Column("recognised at 60 %", "figures/rate_at_60", ".1%"),
        Column("least from 80 % on", "figures/least_from_80", ".1%"),
        Column("rms to published", "reference_rms", ".3f"),
    )
    return Table("Motions recognised", records, columns, note)


def _if_it_speaks(result: dict[str, Any], name: str) -> float | None:
    """Return a share at 60 % of the motion; None of classifiers that give all motions one probability of no class."""
    unknown = result["unknown"]
    return float(unknown[name][5]) if unknown is not None and unknown["says_something"] else None


def recognition_plot(results: Sequence[dict[str, Any]], reference: Mapping[str, Any] | None = None) -> Figure:
    """Return recognition rate (as P1 Fig. 6), reliability, and the probability of no class, side by side.

    Args:
        results: figures of the classifiers, in the order of the legend.
        reference: the published curve.
    """
    speaking = [r for r in results if r["unknown"] is not None and r["unknown"]["says_something"]]
    n_panels = 2 + max(1, len(speaking))
    figure = new_figure(_PANEL_IN[1], _PANEL_IN[0] * n_panels)
    rates, reliability, *others = figure.subplots(1, n_panels, squeeze=False)[0]
    _draw_rates(rates, results, reference)
    _draw_reliability(reliability, results)
    for axes, result in zip(others, speaking, strict=False):
        _draw_unknown(axes, result)
    if not speaking:
        others[0].set_title("probability of no class")
        note(others[0], "no unknown motions were tried,\nor no classifier here\nsays anything about them")
    for axes in figure.axes:
        axes.set_xlim(0, 100)
        axes.set_ylim(-1, 101)
    return figure


def _style(k: int) -> dict[str, Any]:
    return {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[(k // len(SERIES)) % len(DASHES)]}


def _draw_rates(axes: Axes, results: Sequence[dict[str, Any]], reference: Mapping[str, Any] | None) -> None:
    axes.set(title="motions recognised", xlabel="part of the motion seen in %", ylabel="recognised in %")
    axes.axhline(50, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    curves = [(result["name"], result, _style(k)) for k, result in enumerate(results)]
    if reference is not None:
        curves.insert(0, ("published", dict(reference), {"color": INK, "linewidth": 1.4, "linestyle": DASHES[1]}))
    for name, curve, style in curves:
        first = curve["figures"]["first_50_percent"]
        text = f"{name}: never" if first is None else f"{name}: {first} %"
        axes.plot(PERCENTS, 100 * curve["rate"], label=text, **style)
        if first is not None:
            axes.plot([first], [50], marker="o", markersize=5, color=style["color"], zorder=4)
    axes.legend(loc="lower right", title="half recognised from", title_fontsize=8.5, alignment="left")


def _draw_reliability(axes: Axes, results: Sequence[dict[str, Any]]) -> None:
    axes.set(title="reliability, over the whole motion")
    axes.set(xlabel="probability of the most probable class in %", ylabel="it is the true class in %")
    axes.plot([0, 100], [0, 100], color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    for k, result in enumerate(results):
        bins, style, marker = result["calibration"], _style(k), MARKERS[k % len(MARKERS)]
        used = bins["count"] > 0
        x, y = 100 * bins["confidence"][used], 100 * bins["right"][used]
        area = np.maximum(_LEAST_AREA, _FULL_AREA * bins["count"][used] / bins["count"].sum())
        axes.plot(x, y, linewidth=1.2, **style)
        look = {"color": style["color"], "marker": marker, "alpha": 0.75, "linewidths": 0, "zorder": 3}
        axes.scatter(x, y, s=area, clip_on=False, **look)
        axes.plot([], [], marker=marker, label=f"{result['name']}: ECE {bins['error_pooled']:.3f}", **style)
    axes.legend(loc="upper left", title="size: how often", title_fontsize=8.5, alignment="left")


def _draw_unknown(axes: Axes, result: dict[str, Any]) -> None:
    axes.set(title=f"{result['name']}: probability of no class", xlabel="part of the motion seen in %", ylabel="in %")
    for label, quartiles, colour, dashes in (
        ("motions of classes never learned", result["unknown"]["quartiles"], SERIES[1], DASHES[0]),
        ("motions of learned classes", result["unknown_quartiles"], SERIES[0], DASHES[1]),
    ):
        axes.fill_between(PERCENTS, 100 * quartiles[0], 100 * quartiles[2], color=colour, alpha=0.18, linewidth=0)
        axes.plot(PERCENTS, 100 * quartiles[1], color=colour, linestyle=dashes, label=label)
    axes.legend(loc="best", title="median, and quartiles shaded", title_fontsize=8.5, alignment="left")
