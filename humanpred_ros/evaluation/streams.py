"""Does the system know, in a stream of standing and reaching, when a reach begins and ends, and still recognise it?

The motions with one index, one of each class, are a recording round. A stream is made of each round, and the classifier
has learned from all other rounds: a stream holds many motions, none of which may have been learned from.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.evaluation.framework import Advance, Begin, LibrarySettings, Report, chosen_names
from humanpred_ros.evaluation.leave_one_out import UpdateLog, answers
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.recognition import ClassifierChoice, evaluated_names, given_known
from humanpred_ros.evaluation.recognition_scores import advice_beside, decided_right
from humanpred_ros.evaluation.stream_composed import (
    Placed,
    Stream,
    StreamBuilder,
    returns_home,
    standing_noise,
    standing_stream,
)
from humanpred_ros.evaluation.stream_report import (
    FALSE_STARTS,
    announcements,
    onset_figures,
    score_events,
    stream_plot,
    stream_tables,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.onset import BodyPoints, MotionState, OnsetDetector, OnsetSettings
from humanpred_ros.recognition.stream import StreamClassifier
from humanpred_ros.settings import setting

#: Advice (in the file beside a library) that says a motion is mistracked, or may be.
_FLAGS = ("exclude", "suspect")
#: Where in the recorded motion recognition is looked at.
PERCENTS = (20, 40, 60, 80, 100)
#: How streams are shown: frames sooner after the last one than this are dropped, s. The first is the one that figures
#: without a name are of.
VARIANTS = {"as recorded": 0.0, "at 30 Hz": 1.0 / 30.0}
RECORDED = next(iter(VARIANTS))


class StreamSettings(LibrarySettings):
    """Settings of `humanpred evaluate streams`."""

    classifier: str = setting(DEFAULT_CLASSIFIER, "classifier by name, or reaching; none for onsets and ends only")
    standing: float = setting(30.0, "mere standing, on which false starts are counted", unit="min", low=0.01)
    tolerance: float = setting(0.2, "an onset announced within this of the true one is in time", unit="s", low=0.001)

    def check(self) -> None:
        """Raise UsageError for an unknown classifier."""
        chosen_names((self.classifier,), ("none", *evaluated_names()), "classifier")


@dataclass(frozen=True, eq=False)
class StreamRuns:
    """Makes streams of one round and looks at what is announced on them; called with the round's index.

    Can be sent to other processes.
    """

    library: MotionLibrary  #: whose motions with one index are one round
    #: classifier, seed (of pauses, noise and order; each round has its own generator), and how much mere standing there
    #: is in all rounds together
    settings: StreamSettings

    def __call__(self, index: int) -> dict[str, Any]:
        """Run one round.

        Returns:
            `variants`: by name, what `_onsets` returns; `detector_us`: (T,) time of each detector update on the stream
            as recorded; and what `_recognition` returns, nothing without a classifier.
        """
        logs = {name: UpdateLog() for name in VARIANTS}
        variants = {name: self._onsets(index, name, log) for name, log in logs.items()}
        recognition = {} if self.settings.classifier == "none" else self._recognition(index)
        return {"variants": variants, "detector_us": 1e-3 * np.array(logs[RECORDED].update_ns), **recognition}

    @cached_property
    def human(self) -> HumanModel:
        return human_with(self.library.dof_names)

    @cached_property
    def come_back(self) -> bool:
        return returns_home(self.library, self.human)

    def streams(self, index: int, variant: str) -> tuple[Stream, Stream]:
        """Return the stream of one round, and one of standing, in one variant."""
        rng = np.random.default_rng((self.settings.seed, index))
        motions = [motion for motion in self.library if motion.index == index]
        motions = [motions[k] for k in rng.permutation(len(motions))]
        # Of every other round, this one among them: what settings were chosen on stays apart.
        half = [motion for motion in self.library if (motion.index - index) % 2 == 0]
        try:
            noise = standing_noise(half, self.human)
        except LibraryFormatError:
            noise = standing_noise(self.library.motions, self.human)
        noise = noise.near(index)
        made = StreamBuilder(self.human, noise, rng, self.come_back).build(motions)
        # The most usual of the round's starts: one of them may be mistracked.
        starts = np.stack([motion.q[0] for motion in motions])
        start = starts[np.abs(starts - np.median(starts, axis=0)).sum(axis=1).argmin()]
        standing_s = 60.0 * self.settings.standing / len({motion.index for motion in self.library})
        standing = standing_stream(start, standing_s, noise, rng)
        return _thinned(made, VARIANTS[variant]), _thinned(standing, VARIANTS[variant])

    def _onsets(self, index: int, variant: str, log: UpdateLog) -> dict[str, Any]:
        """Return `scores` and `false_starts` of `score_events`, durations, and onsets while standing."""
        made, standing = self.streams(index, variant)
        scores, false_starts = score_events(made.placed, announcements(self._states(made, log)))
        still = announcements(self._states(standing, UpdateLog()))
        return {
            "scores": scores,
            "false_starts": false_starts,
            "stream_s": float(made.t_s[-1] - made.t_s[0]),
            "standing_starts": sum(event.moving for event in still),
            "standing_s": float(standing.t_s[-1] - standing.t_s[0]),
        }

    def _states(self, shown: Stream, log: UpdateLog) -> list[MotionState]:
        """Return what a detector says after each posture."""
        detector, points, states = OnsetDetector(), BodyPoints(self.human), []
        for q, t_s in zip(shown.q, shown.t_s.tolist(), strict=True):
            begun = time.perf_counter_ns()
            states.append(detector.update(points(q), t_s))
            log.update_ns.append(time.perf_counter_ns() - begun)
        return states

    def _recognition(self, index: int) -> dict[str, Any]:
        """Learn from the other rounds and return what is recognised.

        Returns:
            `recognised`: of each motion its name, and whether its class alone was the most probable one at each of
            `PERCENTS`, in the stream and by itself; `refused`: postures refused in the stream; `stream_us`: (T,) time
            of each update.
        """
        rest = self.library.select(lambda motion: motion.index != index)
        classifier = StreamClassifier(ClassifierChoice(self.settings.classifier).make(self.human)).fit(rest)
        made, _ = self.streams(index, RECORDED)
        log = UpdateLog()
        known = np.array([given_known(said, rest.labels) for said in answers(classifier, made.q, made.t_s, log)])
        recognised = []
        for placed in made.placed:
            if placed.made or placed.label not in rest.labels:
                continue
            motion, column = self.library.find(placed.name), rest.labels.index(placed.label)
            said = answers(classifier.classifier, motion.q, motion.t_s, UpdateLog())
            alone = np.array([given_known(posterior, rest.labels) for posterior in said])
            frames = [len(motion) * percent // 100 - 1 for percent in PERCENTS]
            in_stream = _right(known[_frames_at(made.t_s, placed)], column)
            recognised.append((placed.name, in_stream, _right(alone[frames], column)))
        return {"recognised": recognised, "refused": log.refused, "stream_us": 1e-3 * np.array(log.update_ns)}


def _right(known: FloatArray, column: int) -> list[bool]:
    right: list[bool] = decided_right(known[None], np.array([column]))[0].tolist()
    return right


def _frames_at(t_s: FloatArray, placed: Placed) -> list[int]:
    """Return the last frame seen at each percent of the recorded piece of a motion."""
    first = int(np.searchsorted(t_s, placed.start_s - 1e-9))
    n = int(np.searchsorted(t_s, placed.stop_s + 1e-9)) - first
    return [first + n * percent // 100 - 1 for percent in PERCENTS]


def _thinned(shown: Stream, least_step_s: float) -> Stream:
    """Return the stream a slower sensor would deliver."""
    kept, last_s = [], -np.inf
    for k, t_s in enumerate(shown.t_s.tolist()):
        if t_s - last_s >= least_step_s - 1e-4:  # stamps are rounded
            kept.append(k)
            last_s = t_s
    return Stream(shown.t_s[kept], shown.q[kept], shown.placed)


def evaluate_streams(
    library: MotionLibrary,
    settings: StreamSettings,
    *,
    flagged: frozenset[str] = frozenset(),
    progress: Advance | None = None,
) -> dict[str, Any]:
    """Make a stream of each recording round, left out of learning, and look at what is announced on it.

    Args:
        library: whose motions are all in the streams.
        settings: how; its library is not read.
        flagged: motions (`class/index`) that somebody knows to be mistracked. All count; figures without them and of
            them alone are given beside.
        progress: is called with the number of rounds done.

    Returns:
        Figures by name, as in the JSON file.

        - `variants`, the first as recorded: `onset_figures` by group of recorded motions (None of empty ones), and of
          the returns that were `made`; `false_starts` (`score_events`) and duration of all streams; onsets announced
          while the person only stood, the duration of that, and what that is in ten minutes;
        - `recognition`: share of motions recognised at each of `percents`, in the stream and each alone, by group, and
          postures refused; None without a classifier;
        - `motions`: of each recorded motion in the streams as recorded, what was announced (`score_events`);
        - `detector_us`, `stream_us`: median and 99th percentile of an update, detection only and with the classifier;
          `most_us`: longest update with the classifier (where an onset is found, it is shown the buffered postures);
          `wall_s`: duration of the evaluation.

    Raises:
        LibraryFormatError: a library without labels, or of one round, or what the classifier cannot learn.
    """
    begun = time.perf_counter()
    rounds = check_rounds(library)
    found = map_processes(StreamRuns(library, settings), rounds, settings.jobs, progress, settings.scheduler)
    names = {motion.name for motion in library}
    groups = {"all": names} | ({"not flagged": names - flagged, "flagged": names & flagged} if flagged else {})
    timed = settings.classifier != "none"
    stream_us = np.concatenate([outcome["stream_us"] for outcome in found]) if timed else np.zeros(0)
    recorded = [outcome["variants"][RECORDED]["scores"] for outcome in found]
    return {
        "variants": [_variant(name, found, groups, settings.tolerance) for name in VARIANTS],
        "recognition": _recognition(found, groups) if timed else None,
        "motions": [score for scores in recorded for score in scores if not score["made"]],
        "detector_us": np.percentile(np.concatenate([outcome["detector_us"] for outcome in found]), [50, 99]).tolist(),
        "stream_us": np.percentile(stream_us, [50, 99]).tolist() if timed else None,
        "most_us": float(stream_us.max()) if timed else None,
        "wall_s": time.perf_counter() - begun,
    }


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
    name: str, found: Sequence[dict[str, Any]], groups: Mapping[str, set[str]], tolerance_s: float
) -> dict[str, Any]:
    outcomes = [outcome["variants"][name] for outcome in found]
    scores = [score for outcome in outcomes for score in outcome["scores"]]
    parts = {
        group: [score for score in scores if not score["made"] and score["name"] in names]
        for group, names in groups.items()
    }
    starts, standing_s, streams_s = (
        sum(outcome[key] for outcome in outcomes) for key in ("standing_starts", "standing_s", "stream_s")
    )
    return {
        "name": name,
        "groups": {group: onset_figures(some, tolerance_s) for group, some in parts.items()},
        "made": onset_figures([score for score in scores if score["made"]], tolerance_s),
        "false_starts": {what: sum(outcome["false_starts"][what] for outcome in outcomes) for what in FALSE_STARTS},
        "streams_s": streams_s,
        "standing_starts": starts,
        "standing_s": standing_s,
        "false_starts_per_ten_minutes": 600.0 * starts / standing_s,
    }


def _recognition(found: Sequence[dict[str, Any]], groups: Mapping[str, set[str]]) -> dict[str, Any]:
    recognised = [one for outcome in found for one in outcome["recognised"]]
    members = {group: [one for one in recognised if one[0] in names] for group, names in groups.items()}
    filled = {group: chosen for group, chosen in members.items() if chosen}
    in_stream, alone = (
        {group: np.mean([one[which] for one in chosen], axis=0) for group, chosen in filled.items()} for which in (1, 2)
    )
    return {
        "percents": PERCENTS,
        "n_motions": {group: len(chosen) for group, chosen in filled.items()},
        "in_stream": in_stream,
        "alone": alone,
        "refused": sum(outcome["refused"] for outcome in found),
    }


def measure(settings: StreamSettings, begin: Begin) -> Report:
    """Evaluate on the library.

    Raises:
        HumanPredError: an unusable library, or what the classifier cannot learn.
    """
    path, library = settings.library_path, settings.read_library()
    flagged = frozenset(name for name, advice in advice_beside(path, library.name).items() if advice in _FLAGS)
    advance = begin("rounds", len(check_rounds(library)))
    found = evaluate_streams(library, settings, flagged=flagged, progress=advance)
    return Report(
        f"{library.name}: motions in streams with pauses, {found['variants'][0]['streams_s'] / 60:.0f} min",
        tuple(stream_tables(found, settings.classifier, settings.tolerance)),
        {"library": library_facts(library), "onset": OnsetSettings(), "flagged": sorted(flagged), **found},
        draw=lambda: stream_plot(found),
    )
