"""Onsets and ends announced on a stream against those that really were: figures, tables and the plot.

The figures are returned by name, as they stand in the JSON file of `humanpred evaluate streams`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from humanpred_ros.evaluation.framework import Column, Table
from humanpred_ros.evaluation.stream_composed import Placed
from humanpred_ros.recognition.onset import MotionState
from humanpred_ros.viewing.figures import DASHES, MARKERS, SERIES, new_figure, note

#: Where onsets of no motion are announced, and how tables call it.
FALSE_STARTS = {"recorded_rest": "in recorded rest", "after_motion": "after motions", "pause": "in pauses"}
#: An announcement up to this long before what it announces still counts as one of it.
EARLY_S = 0.2
#: An end announced no earlier than this before the true one is it; before, it splits the motion in two.
EARLY_END_S = 0.3
#: An onset announced this soon after the true end is the rest of that motion, found again.
AFTER_S = 0.5


def announcements(states: Iterable[MotionState]) -> list[MotionState]:
    """Return those states of a detector in which it says something new: an onset, or an end."""
    found, before = [], MotionState(False, 0.0, 0.0, 0)
    for state in states:
        if state.moving != before.moving or (state.moving and state.n_motions != before.n_motions):
            found.append(state)
        before = state
    return found


def score_events(placed: Sequence[Placed], events: Sequence[MotionState]) -> tuple[list[dict[str, Any]], Counter[str]]:
    """Return what was announced of each motion, and how many onsets belong to none.

    Args:
        placed: the motions of a stream, in order.
        events: announcements on it.

    Returns:
        Of each motion its `name`; `made`: a return that was not recorded but made; `onset_delay_s`, `onset_error_s`:
        time of the announcement, and the announced time, less the true onset, None if none was announced between 0.2 s
        before it and the end; `end_delay_s`, `end_error_s`: the same of the end, None if none was announced before the
        next motion began; `extra_onsets`: announced during the motion after the first one, which cut it in two.
        And the number of false starts: in `recorded_rest`, with which a recording begins, before its true onset
        (mistracked, or a first stir); `after_motion`, within half a second of the end of a motion; in a `pause`.
    """
    others = [event for event in events if event.moving]
    scores = []
    for k, motion in enumerate(placed):
        following_s = placed[k + 1].onset_s - EARLY_S if k + 1 < len(placed) else float("inf")
        from_s = max(motion.onset_s - EARLY_S, placed[k - 1].end_s if k else -float("inf"))
        until_s = min(motion.end_s, following_s)
        onsets = [event for event in events if event.moving and from_s <= event.found_s < until_s]
        ends = [e for e in events if not e.moving and motion.end_s - EARLY_END_S <= e.found_s < following_s]
        others = [onset for onset in others if onset not in onsets]
        scores.append(
            {
                "name": motion.name,
                "made": motion.made,
                "onset_delay_s": onsets[0].found_s - motion.onset_s if onsets else None,
                "onset_error_s": onsets[0].since_s - motion.onset_s if onsets else None,
                "end_delay_s": ends[0].found_s - motion.end_s if ends else None,
                "end_error_s": ends[0].since_s - motion.end_s if ends else None,
                "extra_onsets": max(0, len(onsets) - 1),
            }
        )
    stirs = sum(any(m.start_s <= onset.found_s < m.onset_s for m in placed) for onset in others)
    after = sum(any(m.end_s <= onset.found_s < m.end_s + AFTER_S for m in placed) for onset in others)
    return scores, Counter(recorded_rest=stirs, after_motion=after, pause=len(others) - stirs - after)


def onset_figures(scores: Sequence[dict[str, Any]], tolerance_s: float) -> dict[str, Any] | None:
    """Return the figures of some motions; None of none.

    Quantiles are over the motions of which an onset, or end, was announced at all.

    Args:
        scores: of `score_events`.
        tolerance_s: an onset announced within this of the true one is in time.

    Returns:
        `n_motions`; `in_time`: share with an onset in time; `missed`: motions with no onset announced;
        `onset_delay_s`: median and 95th percentile of how late onsets are announced; `onset_error_s`: 5th percentile,
        median and 95th of the estimated onset's error; `ends_found`: share of the motions with an end announced before
        the next motion; `end_delay_s`, `end_error_s`: as for onsets; `split`: extra onsets during these motions.
    """
    if not scores:
        return None

    def quantiles(name: str, *percents: int) -> list[float]:
        values = [score[name] for score in scores if score[name] is not None]
        return np.percentile(values, percents).tolist() if values else [float("nan")] * len(percents)

    delays = [score["onset_delay_s"] for score in scores]
    return {
        "n_motions": len(scores),
        "in_time": float(np.mean([delay is not None and abs(delay) <= tolerance_s for delay in delays])),
        "missed": delays.count(None),
        "onset_delay_s": quantiles("onset_delay_s", 50, 95),
        "onset_error_s": quantiles("onset_error_s", 5, 50, 95),
        "ends_found": float(np.mean([score["end_delay_s"] is not None for score in scores])),
        "end_delay_s": quantiles("end_delay_s", 50, 95),
        "end_error_s": quantiles("end_error_s", 5, 50, 95),
        "split": sum(score["extra_onsets"] for score in scores),
    }


def stream_tables(found: Mapping[str, Any], classifier: str, tolerance_s: float) -> Iterator[Table]:
    """Yield the tables of an evaluation of streams.

    Args:
        found: its figures (`evaluate_streams`).
        classifier: its name.
        tolerance_s: an onset announced within this of the true one is in time.
    """
    rows = [
        {"name": f"{variant['name']}, {group}", **figures}
        for variant in found["variants"]
        for group, figures in (*variant["groups"].items(), ("returns (made)", variant["made"]))
        if figures is not None
    ]
    late = {
        what: [
            Column(f"{what} {word}", f"{what}_{key}", "+.2f", "s")
            for word, key in (
                ("late by, median", "delay_s/0"), ("late by, 95 %", "delay_s/1"),
                ("off by, 5 %", "error_s/0"), ("off by, median", "error_s/1"), ("off by, 95 %", "error_s/2"),
            )
        ]
        for what in ("onset", "end")
    }  # fmt: skip
    yield Table(
        "Motions in the streams",
        rows,
        (
            Column("streams, motions", "name"),
            Column("number", "n_motions"),
            Column(f"onsets announced within {tolerance_s:g} s", "in_time", ".1%"),
            Column("onsets missed", "missed"),
            *late["onset"],
            Column("ends announced before the next", "ends_found", ".1%"),
            *late["end"],
            Column("announced again during the motion", "split"),
        ),
        "Late by: the announcement after the true time. Off by: the announced time less the true one.",
    )
    yield Table(
        "False starts: onsets announced when no motion was under way",
        found["variants"],
        (
            Column("streams", "name"),
            *(Column(title, f"false_starts/{key}", "d") for key, title in FALSE_STARTS.items()),
            Column("standing, per 10 min", "false_starts_per_ten_minutes", ".2f"),
        ),
    )
    recognition = found["recognition"]
    if recognition is not None:
        columns = [Column("motions", "name"), Column("number", "n_motions", "d")]
        for k, percent in enumerate(recognition["percents"]):
            columns.append(Column(f"at {percent} %, in the stream", f"in_stream/{k}", ".3f"))
            columns.append(Column(f"at {percent} %, alone", f"alone/{k}", ".3f"))
        groups = [
            {"name": group, **{key: recognition[key][group] for key in ("n_motions", "in_stream", "alone")}}
            for group in recognition["n_motions"]
        ]
        yield Table(f"{classifier}: share recognised, by part of the motion seen", groups, columns)
    times = [("detection", *found["detector_us"], None)]
    if found["stream_us"] is not None:
        times.append(("with the classifier", *found["stream_us"], found["most_us"]))
    heads = ("one posture", ("median", ".0f", "µs"), ("99 % below", ".0f", "µs"), ("longest", ".0f", "µs"))
    yield Table.of_rows("Times", heads, times, f"This evaluation took {found['wall_s']:.0f} s.")


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
