"""Predicts recorded reaches with every predictor and scores them: the work of `humanpred evaluate reaching`.

Every recorded reach is predicted from its first and last posture, its duration and the partner beside it, by a
predictor that may have learned from all other recordings (leave one out), and compared by time warping with what the
person did. Recordings with marker jumps are tested like the others.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros.errors import GoalUnreachableError, SettingsError, UsageError
from humanpred_ros.evaluation.framework import Begin, EvaluationSettings, chosen_names
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.reach_distances import ReachDistance, reach_distance
from humanpred_ros.evaluation.reaching_predictors import (
    GROUPS,
    REACHING_PREDICTORS,
    REFERENCE,
    WRIST,
    ReachingMaterial,
    reaching_entry,
)
from humanpred_ros.evaluation.reaching_weights import (
    ALL,
    STATISTICS,
    learn_all,
    recover,
    recovery_figures,
    spread,
    weight_figures,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.between_ends import PostureBounds
from humanpred_ros.reaching.planner import ReachTask
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.settings import setting

#: The distances, in the order of columns.
DISTANCES = ReachDistance._fields
#: The row that compares each recording with itself: what a perfect prediction scores.
ITSELF = "itself"
#: The predictor that others are compared with.
YARDSTICK = "minimum_jerk"
#: P2's seven demonstrations in its order, by the names of their files, and its Table I: joint and task as coded, of
#: weights learned from the demonstration itself.
TABLE1: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "0446-0578": (33.17, 44.44),
        "0525-0657": (37.20, 53.08),
        "0444-0585": (53.37, 76.26),
        "0489-0589": (20.95, 31.39),
        "0780-0871": (21.59, 26.50),
        "1537-1608": (10.12, 23.62),
        "2711-2823": (25.56, 45.69),
    }
)
DEMONSTRATIONS = tuple(TABLE1)
#: The motion of P2's Table III and Fig. 11, as far as can be told.
INTERFERENCE_CASE = "7395-7595"


class PublishedRow(NamedTuple):
    """Averages over the demonstrations, of 10 runs each, as printed in P2; which predictor of ours is made that way."""

    predictor: str
    what: str
    table: str
    joint_m: float
    task_as_coded_m: float


PUBLISHED_ROWS: tuple[PublishedRow, ...] = (
    PublishedRow("own", "own weights", "P2 Table I", 28.85, 42.99),
    PublishedRow("learned", "leave-one-out weights", "P2 Table II", 30.98, 42.18),
    PublishedRow("baseline_0", "baseline 0", "P2 Table II", 34.06, 45.81),
    PublishedRow("baseline_1", "baseline 1", "P2 Table II", 64.96, 57.78),
    PublishedRow("learned_replanned", "leave-one-out weights, re-planned", "P2 Table II", 35.34, 43.56),
    PublishedRow("baseline_0_replanned", "baseline 0, re-planned", "P2 Table II", 39.55, 48.04),
    PublishedRow("baseline_1_replanned", "baseline 1, re-planned", "P2 Table II", 81.01, 63.11),
)
PUBLISHED_INTERFERENCE: tuple[PublishedRow, ...] = (
    PublishedRow("learned", "learned weights", "P2 Table III", 52.89, 49.22),
    PublishedRow("learned_replanned", "learned weights, re-planned", "P2 Table III", 44.91, 36.20),
)


class ReachingSettings(EvaluationSettings):
    """What is evaluated."""

    demos: str = setting(..., "folder of <name>_active.csv and <name>_passive.csv")
    interference: str | None = setting(
        None,
        "the same of reaches that the partner is in the way of; by default interference_case beside the "
        "demonstrations, if it is there; none to leave it out",
    )
    predictor: tuple[str, ...] = setting(("all",), f"all, or some of {', '.join(REACHING_PREDICTORS)}")
    runs: int = setting(10, "runs of each recording, where the predictor is random", low=1)
    samples: tuple[str, ...] = setting(
        ("3", "10", "30", "100", "300", "700"),
        "numbers of samples from which known weights are learned again (P2 Fig. 7; with the predictor learned only); "
        "none to leave that out",
    )
    repetitions: int = setting(10, "repetitions of learning known weights, with other demonstrations", low=1)

    def check(self) -> None:
        counts = self.sample_counts
        if any(count < 1 for count in counts) or list(counts) != sorted(set(counts)):
            raise SettingsError(f"samples: wanted numbers of at least 1, ascending, got {', '.join(self.samples)}")

    @property
    def sample_counts(self) -> tuple[int, ...]:
        """Numbers of samples; () for none."""
        if self.samples == ("none",):
            return ()
        try:
            return tuple(int(part) for part in self.samples)
        except ValueError:
            raise SettingsError(f"samples: wanted none, or whole numbers, got {', '.join(self.samples)}") from None


class RecordingTask(NamedTuple):
    """One recording to predict with one predictor, by name, `runs` times."""

    predictor: str
    recording: ReachRecording
    runs: int

    def __str__(self) -> str:
        return f"{self.predictor} on {self.recording.name}"


class RecordingOutcome(NamedTuple):
    """Distances (3, runs) of one task, the wrist's path (n, 3) in the first run, and the time of each run, s."""

    distances_m: FloatArray
    wrist_m: FloatArray
    times_s: tuple[float, ...]


#: Paths (n, 3) of the wrist by predictor and recording; those of `ITSELF` are the recorded ones.
Paths = Mapping[tuple[str, str], FloatArray]


def predict_recording(material: ReachingMaterial, seed: int, task: RecordingTask) -> RecordingOutcome:
    """Predict and compare; the predictor has not seen the recording, unless it is one `of_tested`.

    Run k of any recording and predictor draws from (seed, k).
    """
    predictor = reaching_entry(task.predictor).make(material, task.recording.name)
    reach, reaches, times_s = ReachTask.of(task.recording), [], []
    for run in range(task.runs):
        rng = np.random.default_rng([seed, run])
        begin = time.perf_counter()
        reaches.append(predictor.predict(reach, rng))
        times_s.append(time.perf_counter() - begin)
    return _compared(reaches, task.recording, material.model, tuple(times_s))


def _compared(
    reaches: Sequence[FloatArray], recording: ReachRecording, model: HumanModel, times_s: tuple[float, ...]
) -> RecordingOutcome:
    distances = np.array([reach_distance(model, q, recording.active.q) for q in reaches])
    return RecordingOutcome(distances.T, model.forward(reaches[0])[WRIST], times_s)


def evaluate(
    recordings: Sequence[ReachRecording],
    interference: Sequence[ReachRecording],
    settings: ReachingSettings,
    begin: Begin,
    model: HumanModel,
) -> tuple[dict[str, Any], Paths]:
    """Predict all recordings with all predictors; return the figures, as in the JSON file, and the wrists' paths.

    Args:
        recordings: demonstrations, each predicted from the others.
        interference: reaches that the partner is in the way of, predicted from all demonstrations; may be none.
        settings: what is evaluated.
        begin: begins a line of progress.
        model: the human.

    Raises:
        UsageError: fewer than two recordings, so that none could be left out, or unknown predictors.
        MotionError: recordings that nothing can be learned from.
    """
    began_s = time.perf_counter()
    if len(recordings) < 2:
        raise UsageError(
            f"evaluation: wanted at least 2 recordings, to leave one out, got {len(recordings)}; add others"
        )
    known = {recording.name for recording in recordings}
    if twice := [recording.name for recording in interference if recording.name in known]:
        raise UsageError(f"interference case: wanted recordings not learned from, got {', '.join(twice)} again")
    predictors = chosen_names(settings.predictor, REACHING_PREDICTORS, "predictors")
    ordered = sorted(recordings, key=_papers_order)
    surroundings = Surroundings.around_hands(np.concatenate([model.forward(r.active.q)[WRIST] for r in ordered]))
    ways = dict.fromkeys(how for how in (reaching_entry(name).learns for name in predictors) if how is not None)
    learned = {how: learn_all(ordered, model, how, settings.seed, surroundings) for how in ways}
    weights = {how: {ALL: found.everything.weights, **found.each} for how, found in learned.items()}
    material = ReachingMaterial(ordered, model, weights, surroundings)

    tasks = sorted(_tasks(ordered, interference, predictors, settings.runs), key=_length, reverse=True)
    predict, advance = partial(predict_recording, material, settings.seed), begin("predicted", len(tasks))
    outcomes = map_processes(predict, tasks, settings.jobs, advance, settings.scheduler)
    found = {(task.predictor, task.recording.name): done for task, done in zip(tasks, outcomes, strict=True)}
    found |= {
        (ITSELF, each.name): _compared([each.active.q], each, model, (np.nan,)) for each in (*ordered, *interference)
    }
    recovery = None
    if "learned" in predictors and settings.sample_counts:
        runs = map_processes(
            partial(recover, ordered, model, settings.sample_counts, settings.seed), range(settings.repetitions),
            settings.jobs, begin("known weights learned", settings.repetitions), settings.scheduler,
        )  # fmt: skip
        recovery = recovery_figures(runs, settings.sample_counts)

    facts = partial(_facts, learned_from=ordered, model=model)
    rows = PUBLISHED_ROWS if known == set(DEMONSTRATIONS) else ()
    sets = [_set_of("each predicted from the others", list(map(facts, ordered)), found, predictors, rows, True)]
    if interference:
        rows = PUBLISHED_INTERFERENCE if [each.name for each in interference] == [INTERFERENCE_CASE] else ()
        title = "partner in the way, predicted from all the demonstrations"
        sets.append(_set_of(title, list(map(facts, interference)), found, predictors, rows, False))
    figures = {
        "obstacles": [obstacle.name for obstacle in surroundings.obstacles],
        "sets": sets,
        "table1": {recording.name: TABLE1[recording.name] for recording in ordered if recording.name in TABLE1},
        "weights": weight_figures(learned) if learned else None,
        "recovery": recovery,
        "elapsed_s": time.perf_counter() - began_s,
    }
    return figures, {key: outcome.wrist_m for key, outcome in found.items()}


def _papers_order(recording: ReachRecording) -> tuple[int, str]:
    known = recording.name in DEMONSTRATIONS
    return (DEMONSTRATIONS.index(recording.name) if known else len(DEMONSTRATIONS), recording.name)


def _tasks(
    recordings: Sequence[ReachRecording], interference: Sequence[ReachRecording], predictors: Sequence[str], runs: int
) -> Iterator[RecordingTask]:
    """Yield every recording with every predictor that can be tested on it."""
    for name in predictors:
        entry = reaching_entry(name)
        for recording in (*recordings, *(() if entry.of_tested else interference)):
            yield RecordingTask(name, recording, runs if entry.by_chance else 1)


def _length(task: RecordingTask) -> float:
    """Return about how long a task takes; a single plan takes as long for any duration, re-plans come every 0.1 s."""
    entry = reaching_entry(task.predictor)
    return task.runs * (task.recording.active.duration_s if entry.step_s else 0.1 if entry.by_chance else 0.0)


def _facts(recording: ReachRecording, learned_from: Sequence[ReachRecording], model: HumanModel) -> dict[str, Any]:
    """Return what is told of a recording; a goal beyond what predictors have seen is predicted all the same."""
    others = [other for other in learned_from if other.name != recording.name]
    try:
        beyond = PostureBounds.from_recordings(others, model).check_goal(recording.name, recording.active.q[-1])
    except GoalUnreachableError as far:
        beyond = (str(far),)
    return {
        "name": recording.name,
        "n_frames": len(recording.active),
        "duration_s": recording.active.duration_s,
        "unfit": recording.unfit,
        "notes": [*recording.notes, *(text.removeprefix(f"{recording.name}: ") for text in beyond)],
    }


def _set_of(
    title: str,
    recordings: Sequence[Mapping[str, Any]],
    found: Mapping[tuple[str, str], RecordingOutcome],
    predictors: Sequence[str],
    published: Sequence[PublishedRow],
    left_out: bool,
) -> dict[str, Any]:
    """Return the scores of all predictors on some recordings, and of each recording compared with itself.

    `left_out` says whether predictors had learned from all recordings but the tested one; otherwise from others.
    """

    def scores(name: str, description: str, group: str) -> dict[str, Any]:
        outcomes = [found[name, facts["name"]] for facts in recordings]
        values = np.array([spread(outcome.distances_m) for outcome in outcomes])
        return {
            "name": name,
            "description": description,
            "group": group,
            "runs": len(outcomes[0].times_s),
            "recordings": [
                {"recording": facts["name"], "figures": _by_distance(each)}
                for facts, each in zip(recordings, values, strict=True)
            ],
            # Averages over the recordings, which is how P2's averages are made.
            "average": _by_distance(values.mean(axis=0)),
            "predict_ms": 1e3 * float(np.median(np.concatenate([outcome.times_s for outcome in outcomes]))),
        }

    entries = {name: reaching_entry(name) for name in predictors}
    tested = [(name, e.description, e.group) for name, e in entries.items() if left_out or not e.of_tested]
    tested.append((ITSELF, "the recording itself: a perfect prediction", REFERENCE))
    return {
        "title": title,
        "recordings": recordings,
        "predictors": [scores(*each) for each in tested],
        "published": [row._asdict() for row in published],
        "left_out": left_out,
    }


def _by_distance(values: FloatArray) -> dict[str, dict[str, float]]:
    """Return statistics (4, 3) of the distances by name."""
    return {name: dict(zip(STATISTICS, values[:, k].tolist(), strict=True)) for k, name in enumerate(DISTANCES)}


def by_group(entry: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the scores of a set's predictors, those of one kind side by side."""
    return sorted(entry["predictors"], key=lambda predictor: GROUPS.index(predictor["group"]))


def score_of(entry: Mapping[str, Any], name: str) -> dict[str, Any] | None:
    """Return the scores of a predictor in a set, None if it was not run."""
    return next((predictor for predictor in entry["predictors"] if predictor["name"] == name), None)


def published_of(entry: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return what P2 published of a predictor that is made the same way; empty if nothing."""
    return next((row for row in entry["published"] if row["predictor"] == name), {})


def many(entry: Mapping[str, Any]) -> str:
    """Return how many reaches a set has, in words."""
    return "1 reach" if len(entry["recordings"]) == 1 else f"{len(entry['recordings'])} reaches"


def means(predictor: Mapping[str, Any], distance: str) -> list[float]:
    """Return a predictor's distance of each recording, mean over the runs."""
    return [each["figures"][distance]["mean"] for each in predictor["recordings"]]
