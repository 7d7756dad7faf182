"""Does the system know, in a stream of standing and reaching, when a reach begins and ends, and still recognise it?

The motions with one index, one of each class, are a recording round. A stream is made of each round, and the classifier
has learned from all other rounds: a stream holds many motions, none of which may have been learned from.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.evaluation.framework import (
    Advance,
    Begin,
    Column,
    LibrarySettings,
    Report,
    Table,
    chosen_names,
    present,
)
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.published import advice_beside
from humanpred_ros.evaluation.recognition_runs import evaluated_names
from humanpred_ros.evaluation.stream_runs import PERCENTS, VARIANTS, Outcome, StreamRuns
from humanpred_ros.evaluation.stream_scores import FalseStarts, MotionScore, OnsetFigures, onset_figures
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.onset import OnsetSettings
from humanpred_ros.settings import setting
from humanpred_ros.viewing.figures import DASHES, MARKERS, SERIES, new_figure, note

#: Advice (in the file beside a library) that says a motion is mistracked, or may be.
_FLAGS = ("exclude", "suspect")


class StreamSettings(LibrarySettings):
    """Settings of `humanpred evaluate streams`."""

    classifier: str = setting(DEFAULT_CLASSIFIER, "classifier by name, or reaching; none for onsets and ends only")
    standing: float = setting(30.0, "mere standing, on which false starts are counted", unit="min", low=0.01)
    tolerance: float = setting(0.2, "an onset announced within this of the true one is in time", unit="s", low=0.001)

    def check(self) -> None:
        """Raise UsageError for an unknown classifier."""
        chosen_names((self.classifier,), ("none", *evaluated_names()), "classifier")


@dataclass(frozen=True)
class VariantResult:
    """Onsets and ends in one kind of streams.

    Attributes:
        name: of the variant.
        groups: figures by group of recorded motions: all, even and odd rounds, flagged or not; None of empty ones.
        made: of the returns that were made, None where motions come back by themselves.
        false_starts: onsets announced in the streams between motions.
        streams_s: duration of all streams.
        standing_starts: onsets announced while the person only stood, by rounds: all, even, odd.
        standing_s: durations of that.
    """

    name: str
    groups: Mapping[str, OnsetFigures | None]
    made: OnsetFigures | None
    false_starts: FalseStarts
    streams_s: float
    standing_starts: Mapping[str, int]
    standing_s: Mapping[str, float]

    def per_ten_minutes(self, rounds: str = "all") -> float | None:
        """Return the false starts per ten minutes of mere standing; None without any."""
        standing_s = self.standing_s[rounds]
        return 600.0 * self.standing_starts[rounds] / standing_s if standing_s else None

    def figures(self) -> dict[str, Any]:
        """Return all of it, by name."""
        rates = {rounds: self.per_ten_minutes(rounds) for rounds, s in self.standing_s.items() if s > 0}
        return {**vars(self), "false_starts_per_ten_minutes": rates}


@dataclass(frozen=True)
class RecognitionResult:
    """Share of motions recognised at each of `percents`, in the stream and each alone, by group."""

    percents: tuple[int, ...]
    n_motions: Mapping[str, int]
    in_stream: Mapping[str, tuple[float, ...]]
    alone: Mapping[str, tuple[float, ...]]
    refused: int


@dataclass(frozen=True)
class StreamEvaluation:
    """Everything an evaluation of streams found.

    Attributes:
        variants: the first is as recorded.
        recognition: None without a classifier.
        motions: of each recorded motion in the streams as recorded, what was announced.
        detector_us, stream_us: median and 99th percentile of an update: detection only, and with the classifier.
        most_us: longest update with the classifier; where an onset is found, it is shown the buffered postures.
        wall_s: duration of the evaluation.
    """

    variants: tuple[VariantResult, ...]
    recognition: RecognitionResult | None
    motions: tuple[MotionScore, ...]
    detector_us: tuple[float, float]
    stream_us: tuple[float, float] | None
    most_us: float | None
    wall_s: float


def evaluate_streams(
    library: MotionLibrary,
    settings: StreamSettings,
    *,
    flagged: frozenset[str] = frozenset(),
    progress: Advance | None = None,
) -> StreamEvaluation:
    """Make a stream of each recording round, left out of learning, and look at what is announced on it.

    Args:
        library: whose motions are all in the streams.
        settings: how; its library is not read.
        flagged: motions (`class/index`) that somebody knows to be mistracked. All count; figures without them and of
            them alone are given beside.
        progress: is called with the number of rounds done.

    Raises:
        LibraryFormatError: a library without labels, or of one round, or what the classifier cannot learn.
    """
    begun = time.perf_counter()
    rounds = check_rounds(library)
    classifier = None if settings.classifier == "none" else settings.classifier
    runs = StreamRuns(library, classifier, OnsetSettings(), settings.seed, 60.0 * settings.standing)
    found = map_processes(runs, rounds, settings.jobs, progress, settings.scheduler)
    outcomes = dict(zip(rounds, found, strict=True))
    names = {motion.name: motion.index for motion in library}
    groups: dict[str, Callable[[str], bool]] = {
        "all": lambda name: True,
        "even rounds": lambda name: names[name] % 2 == 0,
        "odd rounds": lambda name: names[name] % 2 == 1,
        "not flagged": lambda name: name not in flagged,
        "not flagged, odd rounds": lambda name: name not in flagged and names[name] % 2 == 1,
        "flagged": lambda name: name in flagged,
    }
    detector_us = np.concatenate([outcome.detector_us for outcome in outcomes.values()])
    stream_us = np.concatenate([outcome.stream_us for outcome in outcomes.values()])
    timed = len(stream_us) > 0
    recorded = [s for o in outcomes.values() for s in o.variants[VARIANTS[0].name].scores if not s.made]
    return StreamEvaluation(
        variants=tuple(_variant(variant.name, outcomes, groups, settings.tolerance) for variant in VARIANTS),
        recognition=_recognition(outcomes, groups) if classifier is not None else None,
        motions=tuple(recorded),
        detector_us=_median_and_99(detector_us),
        stream_us=_median_and_99(stream_us) if timed else None,
        most_us=float(stream_us.max()) if timed else None,
        wall_s=time.perf_counter() - begun,
    )


def check_rounds(library: MotionLibrary) -> list[int]:
    """Return the indices of the library's rounds; raises LibraryFormatError if none can be left out."""
    unlabelled = [motion.name for motion in library if motion.label is None]
    if unlabelled:
        raise LibraryFormatError(
            f"library {library.name}: wanted a class for every motion, {unlabelled[0]} has none; label it"
        )
    rounds = sorted({motion.index for motion in library})
    if len(rounds) < 3:
        raise LibraryFormatError(
            f"library {library.name}: wanted at least 3 recording rounds (motions of one index), so that two are left "
            f"to learn from, got {len(rounds)}; record more"
        )
    return rounds


def _variant(
    name: str, outcomes: Mapping[int, Outcome], groups: Mapping[str, Callable[[str], bool]], tolerance_s: float
) -> VariantResult:
    found = {index: outcome.variants[name] for index, outcome in outcomes.items()}
    scores = [score for outcome in found.values() for score in outcome.scores]
    halves = {"all": (0, 1), "even rounds": (0,), "odd rounds": (1,)}
    return VariantResult(
        name=name,
        groups={
            group: onset_figures([s for s in scores if not s.made and belongs(s.name)], tolerance_s)
            for group, belongs in groups.items()
        },
        made=onset_figures([s for s in scores if s.made], tolerance_s),
        false_starts=sum((outcome.false_starts for outcome in found.values()), FalseStarts(0, 0, 0)),
        streams_s=sum(outcome.stream_s for outcome in found.values()),
        standing_starts={
            half: sum(outcome.standing_starts for index, outcome in found.items() if index % 2 in parities)
            for half, parities in halves.items()
        },
        standing_s={
            half: sum(outcome.standing_s for index, outcome in found.items() if index % 2 in parities)
            for half, parities in halves.items()
        },
    )


def _recognition(outcomes: Mapping[int, Outcome], groups: Mapping[str, Callable[[str], bool]]) -> RecognitionResult:
    found = [recognition for outcome in outcomes.values() for recognition in outcome.recognition]
    members = {group: [r for r in found if belongs(r.name)] for group, belongs in groups.items()}
    filled = {group: chosen for group, chosen in members.items() if chosen}
    return RecognitionResult(
        percents=PERCENTS,
        n_motions={group: len(chosen) for group, chosen in filled.items()},
        in_stream={group: _shares([r.in_stream for r in chosen]) for group, chosen in filled.items()},
        alone={group: _shares([r.alone for r in chosen]) for group, chosen in filled.items()},
        refused=sum(outcome.refused for outcome in outcomes.values()),
    )


def _shares(right: list[tuple[bool, ...]]) -> tuple[float, ...]:
    return tuple(float(share) for share in np.mean(np.array(right, dtype=np.float64), axis=0))


def _median_and_99(values: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[float, float]:
    median, top = np.percentile(values, [50, 99])
    return float(median), float(top)


def measure(settings: StreamSettings, begin: Begin) -> Report:
    """Evaluate on the library.

    Raises:
        HumanPredError: an unusable library, or what the classifier cannot learn.
    """
    path, library = settings.library_path, settings.read_library()
    flagged = frozenset(name for name, advice in advice_beside(path, library.name).items() if advice in _FLAGS)
    advance = begin("rounds", len(check_rounds(library)))
    evaluation = evaluate_streams(library, settings, flagged=flagged, progress=advance)
    recorded = evaluation.variants[0]
    tables = [_groups_table(recorded, settings), _variants_table(evaluation.variants, settings)]
    if evaluation.recognition is not None:
        tables.append(_recognition_table(evaluation.recognition, settings.classifier))
    figures = {
        "library": library_facts(library),
        "onset": OnsetSettings(),
        "flagged": sorted(flagged),
        **vars(evaluation),
        "variants": [variant.figures() for variant in evaluation.variants],
    }
    return Report(
        f"{library.name}: motions in streams with pauses, {recorded.streams_s / 60:.0f} min",
        (*tables, _times_table(evaluation)),
        figures,
        draw=lambda: _plot(evaluation),
    )


def run(settings: StreamSettings, console: Console) -> int:
    """Evaluate, print, write; return the exit status."""
    return present(settings, console, measure)


def _groups_table(recorded: VariantResult, settings: StreamSettings) -> Table:
    groups = dict(recorded.groups) | {"returns (made)": recorded.made}

    def delay(name: str, number: int) -> Callable[[tuple[str, OnsetFigures]], float]:
        return lambda record: float(getattr(record[1], name)[number])

    columns = [
        Column("motions", lambda record: record[0]),
        Column("number", lambda record: record[1].n_motions),
        Column(f"onsets announced within {settings.tolerance:g} s", lambda record: record[1].in_time, ".1%"),
        Column("onsets missed", lambda record: record[1].missed),
    ]
    for of, title in (("onset", "onset"), ("end", "end")):
        if of == "end":
            columns.append(Column("ends announced before the next", lambda record: record[1].ends_found, ".1%"))
        columns += [
            Column(f"{title} late by, median", delay(f"{of}_delay_s", 0), "+.2f", "s"),
            Column(f"{title} late by, 95 %", delay(f"{of}_delay_s", 1), "+.2f", "s"),
            Column(f"{title} off by, 5 %", delay(f"{of}_error_s", 0), "+.2f", "s"),
            Column(f"{title} off by, median", delay(f"{of}_error_s", 1), "+.2f", "s"),
            Column(f"{title} off by, 95 %", delay(f"{of}_error_s", 2), "+.2f", "s"),
        ]
    columns.append(Column("announced again during the motion", lambda record: record[1].split))
    found = [(name, figures) for name, figures in groups.items() if figures is not None]
    text = "Late by: the announcement after the true time. Off by: the announced time less the true one."
    return Table("As recorded", found, columns, text)


def _variants_table(variants: Sequence[VariantResult], settings: StreamSettings) -> Table:
    within = f"within {settings.tolerance:g} s"
    heads = (
        "streams", (within, ".1%"), (f"{within}, odd rounds", ".1%"), ("missed", "d"), ("late by, median", "+.2f", "s"),
        ("late by, 95 %", "+.2f", "s"), ("starts in recorded rest", "d"), ("after motions", "d"), ("in pauses", "d"),
        ("standing, per 10 min", ".2f"), ("standing, odd rounds", ".2f"),
    )  # fmt: skip
    rows = []
    for variant in variants:
        everything, odd = variant.groups["all"], variant.groups["odd rounds"]
        if everything is not None:
            starts = [variant.per_ten_minutes(which) for which in ("all", "odd rounds")]
            in_time = (everything.in_time, None if odd is None else odd.in_time)
            false = astuple(variant.false_starts)
            rows.append((variant.name, *in_time, everything.missed, *everything.onset_delay_s, *false, *starts))
    text = "False starts: onsets announced when no motion was under way."
    return Table.of_rows("Streams that differ from the recordings", heads, rows, text)


def _recognition_table(result: RecognitionResult, classifier: str) -> Table:
    heads: list[str | tuple[str, ...]] = ["motions", ("number", "d")]
    for percent in result.percents:
        heads += [(f"at {percent} %, in the stream", ".3f"), (f"at {percent} %, alone", ".3f")]
    rows = [
        (group, n, *np.column_stack([result.in_stream[group], result.alone[group]]).ravel().tolist())
        for group, n in result.n_motions.items()
    ]
    return Table.of_rows(f"{classifier}: share recognised, by part of the motion seen", heads, rows)


def _times_table(evaluation: StreamEvaluation) -> Table:
    rows: list[tuple[Any, ...]] = [("detection", *evaluation.detector_us, None)]
    if evaluation.stream_us is not None:
        rows.append(("with the classifier", *evaluation.stream_us, evaluation.most_us))
    heads = ("one posture", ("median", ".0f", "µs"), ("99 % below", ".0f", "µs"), ("longest", ".0f", "µs"))
    return Table.of_rows("Times", heads, rows, f"This evaluation took {evaluation.wall_s:.0f} s.")


def _plot(evaluation: StreamEvaluation) -> Figure:
    """Return how late onsets and ends are announced, and recognition in the stream beside that of single motions."""
    figure = new_figure(3.9)
    late, recognised = figure.subplots(1, 2)
    late.set_title("announcements of motions as recorded")
    for k, (name, delays) in enumerate(
        (
            ("onsets", [m.onset_delay_s for m in evaluation.motions if m.onset_delay_s is not None]),
            ("ends", [m.end_delay_s for m in evaluation.motions if m.end_delay_s is not None]),
        )
    ):
        share = 100.0 * np.arange(1, len(delays) + 1) / max(1, len(evaluation.motions))
        late.step(np.sort(delays), share, where="post", label=name, color=SERIES[k], linestyle=DASHES[k])
    late.set_xlabel("later than the true one by at most, in s")
    late.set_ylabel("motions in %")
    late.set_ylim(0, 101)
    late.legend(loc="lower right")
    recognised.set_title("motions recognised")
    if evaluation.recognition is None:
        note(recognised, "no classifier was asked")
        return figure
    found = evaluation.recognition
    for k, (name, shares) in enumerate((("in the stream", found.in_stream), ("alone", found.alone))):
        if "all" in shares:
            style = {"color": SERIES[k], "linestyle": DASHES[k], "marker": MARKERS[k], "markersize": 4.0}
            recognised.plot(found.percents, [100.0 * share for share in shares["all"]], label=name, **style)
    recognised.set_xlabel("part of the motion seen in %")
    recognised.set_ylabel("recognised in %")
    recognised.set_ylim(0, 101)
    recognised.legend(loc="lower right")
    return figure
