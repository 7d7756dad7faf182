"""The tables and the plot of the evaluation of streams."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from humanpred_ros.evaluation.framework import Column, Table
from humanpred_ros.viewing.figures import DASHES, MARKERS, SERIES, new_figure, note


def stream_tables(found: Mapping[str, Any], classifier: str, tolerance_s: float) -> list[Table]:
    """Return the tables of an evaluation of streams.

    Args:
        found: its figures (`evaluate_streams`).
        classifier: its name.
        tolerance_s: an onset announced within this of the true one is in time.
    """
    recorded = found["variants"][0]
    within = f"within {tolerance_s:g} s"
    groups = [{"name": name, **of} for name, of in recorded["groups"].items() if of is not None]
    if recorded["made"] is not None:
        groups.append({"name": "returns (made)", **recorded["made"]})
    late = [
        [
            Column(f"{what} late by, median", f"{what}_delay_s/0", "+.2f", "s"),
            Column(f"{what} late by, 95 %", f"{what}_delay_s/1", "+.2f", "s"),
            Column(f"{what} off by, 5 %", f"{what}_error_s/0", "+.2f", "s"),
            Column(f"{what} off by, median", f"{what}_error_s/1", "+.2f", "s"),
            Column(f"{what} off by, 95 %", f"{what}_error_s/2", "+.2f", "s"),
        ]
        for what in ("onset", "end")
    ]
    of_groups = (
        Column("motions", "name"),
        Column("number", "n_motions"),
        Column(f"onsets announced {within}", "in_time", ".1%"),
        Column("onsets missed", "missed"),
        *late[0],
        Column("ends announced before the next", "ends_found", ".1%"),
        *late[1],
        Column("announced again during the motion", "split"),
    )
    of_variants = (
        Column("streams", "name"),
        Column(within, "groups/all/in_time", ".1%"),
        Column(f"{within}, odd rounds", "groups/odd rounds/in_time", ".1%"),
        Column("missed", "groups/all/missed", "d"),
        Column("late by, median", "groups/all/onset_delay_s/0", "+.2f", "s"),
        Column("late by, 95 %", "groups/all/onset_delay_s/1", "+.2f", "s"),
        Column("starts in recorded rest", "false_starts/recorded_rest", "d"),
        Column("after motions", "false_starts/after_motion", "d"),
        Column("in pauses", "false_starts/pause", "d"),
        Column("standing, per 10 min", "false_starts_per_ten_minutes/all", ".2f"),
        Column("standing, odd rounds", lambda v: v["false_starts_per_ten_minutes"].get("odd rounds"), ".2f"),
    )
    note_of_groups = "Late by: the announcement after the true time. Off by: the announced time less the true one."
    note_of_variants = "False starts: onsets announced when no motion was under way."
    tables = [
        Table("As recorded", groups, of_groups, note_of_groups),
        Table("Streams that differ from the recordings", found["variants"], of_variants, note_of_variants),
    ]
    recognition = found["recognition"]
    if recognition is not None:
        columns = [Column("motions", "name"), Column("number", "n_motions", "d")]
        for k, percent in enumerate(recognition["percents"]):
            columns.append(Column(f"at {percent} %, in the stream", f"in_stream/{k}", ".3f"))
            columns.append(Column(f"at {percent} %, alone", f"alone/{k}", ".3f"))
        rows = [
            {"name": group, **{key: recognition[key][group] for key in ("n_motions", "in_stream", "alone")}}
            for group in recognition["n_motions"]
        ]
        tables.append(Table(f"{classifier}: share recognised, by part of the motion seen", rows, columns))
    times = [("detection", *found["detector_us"], None)]
    if found["stream_us"] is not None:
        times.append(("with the classifier", *found["stream_us"], found["most_us"]))
    heads = ("one posture", ("median", ".0f", "µs"), ("99 % below", ".0f", "µs"), ("longest", ".0f", "µs"))
    tables.append(Table.of_rows("Times", heads, times, f"This evaluation took {found['wall_s']:.0f} s."))
    return tables


def stream_plot(found: Mapping[str, Any]) -> Figure:
    """Return how late onsets and ends are announced, and recognition in the stream beside that of single motions."""
    figure = new_figure(3.9)
    late, recognised = figure.subplots(1, 2)
    late.set(title="announcements of motions as recorded")
    late.set(xlabel="later than the true one by at most, in s", ylabel="motions in %")
    for k, what in enumerate(("onset", "end")):
        delays = [delay for motion in found["motions"] if (delay := motion[f"{what}_delay_s"]) is not None]
        share = 100.0 * np.arange(1, len(delays) + 1) / max(1, len(found["motions"]))
        late.step(np.sort(delays), share, where="post", label=f"{what}s", color=SERIES[k], linestyle=DASHES[k])
    recognised.set(title="motions recognised")
    if found["recognition"] is None:
        note(recognised, "no classifier was asked")
    else:
        recognised.set(xlabel="part of the motion seen in %", ylabel="recognised in %")
        for k, (name, key) in enumerate((("in the stream", "in_stream"), ("alone", "alone"))):
            style: dict[str, Any] = {"color": SERIES[k], "linestyle": DASHES[k], "marker": MARKERS[k]}
            shares = 100.0 * found["recognition"][key].get(
                "all", np.full(len(found["recognition"]["percents"]), np.nan)
            )
            recognised.plot(found["recognition"]["percents"], shares, label=name, markersize=4.0, **style)
    for axes in figure.axes:
        if axes.get_lines():
            axes.set_ylim(0, 101)
            axes.legend(loc="lower right")
    return figure
