"""Learned weights as tables in the terminal, beside the published ones (P2 Table I, Figs. 7 and 10)."""

from __future__ import annotations

import numpy as np
from rich.console import Console

from humanpred_ros.evaluation.reaching.learned import IMPROVED, PUBLISHED
from humanpred_ros.evaluation.reaching.recovery import RecoveryFigures
from humanpred_ros.evaluation.reaching.result import Statistic
from humanpred_ros.evaluation.reaching.weights import WeightColumn, WeightFigures
from humanpred_ros.evaluation.text import figure_table, headline, line
from humanpred_ros.reaching.features import N_SMOOTHNESS


def print_weights(figures: WeightFigures, console: Console) -> None:
    """Print weights and influence of every feature."""
    headline(
        console,
        f"Weights of P2's features. Those of {PUBLISHED}, alone and the authors have the same features, scales and "
        f"bounds 0 to {figures.upper:g}, and are comparable as they stand. Influence (%): weight x standard deviation "
        "of its feature over samples around the demonstrations, as a share of the sum: comparable among all.",
    )
    for column in figures.columns:
        line(console, f"  {column.name}: {column.description}")
    # Weights of normalised features are of all sizes; their influence says more.
    shown = [column for column in figures.columns if column.name != IMPROVED]
    titles = [column.name.replace("_", "\n") for column in figures.columns]
    table = figure_table(
        "weight, and influence in %",
        *(column.name.replace("_", "\n") for column in shown),
        *(f"{title}\n%" if "\n" in title else f"{title}\n\n%" for title in titles),
    )
    for k, feature in enumerate(figures.features):
        table.add_row(
            feature,
            *(_weight(column, k, feature) for column in shown),
            *(f"{100.0 * column.influence[k]:.1f}" for column in figures.columns),
        )
        if k == N_SMOOTHNESS - 1:
            table.add_section()
    console.print(table)
    for column in figures.columns:
        if column.at_upper:
            line(
                console,
                f"* {column.name}: {len(column.at_upper)} of {len(figures.features)} weights are at their upper bound "
                f"({figures.upper:g}); the data ask for more, and ± 0 there does not mean sure: "
                f"{', '.join(column.at_upper)}",
            )
    for notes in list(figures.notes.values())[:1]:  # other ways to learn say nearly the same
        for text in notes:
            line(console, f"learning: {text}")


def print_recovery(figures: RecoveryFigures, console: Console) -> None:
    """Print what P2's Fig. 7 shows."""
    many = f"{figures.demonstrations} reaches"
    headline(
        console,
        f"P2 Fig. 7: {many} planned with known weights, weights learned from them, planned again. How much more that "
        "costs by the known weights, % of the cost of the demonstrations; mean over these, average over repetitions "
        "(sd, least, largest)",
    )
    table = figure_table("samples each", *(f"learned as {how}" for how in figures.learned), "best of the samples")
    for k, count in enumerate(figures.samples):
        table.add_row(
            str(count), *(_percent(found[k]) for found in figures.learned.values()), _percent(figures.best_sample[k])
        )
    console.print(table)
    line(console, f"  for comparison: straight line, which is what baseline 0 plans, {_percent(figures.line)}")


def print_left_out(figures: WeightFigures, console: Console) -> None:
    """Print what P2's Fig. 10 shows, a column for each recording that was left out."""
    for found in figures.left_out:
        published = found.how == PUBLISHED
        headline(
            console,
            f"P2 Fig. 10: learned as {found.how}, leaving out one recording each: "
            + ("weights" if published else "influence, % (weights are in the JSON file)"),
        )
        values = found.weights if published else 100.0 * found.influence
        table = figure_table("left out", *found.recordings, "mean", "sd")
        for k, feature in enumerate(figures.features):
            row = values[:, k]
            table.add_row(feature, *(f"{value:.1f}" for value in (*row, np.mean(row), np.std(row))))
            if k == N_SMOOTHNESS - 1:
                table.add_section()
        console.print(table)


def _weight(column: WeightColumn, k: int, feature: str) -> str:
    text = f"{column.weights[k]:.1f}"
    if column.spread is not None and np.isfinite(column.spread[k]):
        text += f" ± {column.spread[k]:.0f}"
    return text + ("*" if feature in column.at_upper else "")


def _percent(statistic: Statistic) -> str:
    return f"{statistic.mean:.2f} ({statistic.sd:.2f}, {statistic.low:.2f}, {statistic.high:.2f})"
