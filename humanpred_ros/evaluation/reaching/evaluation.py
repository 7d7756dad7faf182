"""How well is a reach predicted that was never seen? P2's Tables I to III, beside predictors that anybody can write.

Every recorded reach is predicted from its first and last posture, its duration and the partner beside it, by a
predictor that may have learned from all other recordings (leave one out), and compared by time warping with what the
person really did. Recordings with marker jumps are tested like the others.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.outputs import machine_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.reaching.entry import ReachingMaterial
from humanpred_ros.evaluation.reaching.evaluation_result import ReachingEvaluation
from humanpred_ros.evaluation.reaching.learned import LearnedWeights, learn_all
from humanpred_ros.evaluation.reaching.predictors import REACHING_PREDICTORS, reaching_entry
from humanpred_ros.evaluation.reaching.recovery import Recovery, RecoveryConfig, RecoveryFigures
from humanpred_ros.evaluation.reaching.reference import (
    DEMONSTRATIONS,
    INTERFERENCE_CASE,
    PUBLISHED,
    PUBLISHED_INTERFERENCE,
    TABLE1,
    PublishedRow,
)
from humanpred_ros.evaluation.reaching.runs import (
    WRIST,
    RecordingOutcome,
    RecordingRuns,
    RecordingTask,
    Spread,
    long_first,
)
from humanpred_ros.evaluation.reaching.sets import set_of
from humanpred_ros.evaluation.reaching.targets import targets_of
from humanpred_ros.evaluation.reaching.timing import prediction_times
from humanpred_ros.evaluation.reaching.weights import weight_figures
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.surroundings import Surroundings


@dataclass(frozen=True)
class ReachingConfig:
    """What is run.

    Attributes:
        predictors: names of `REACHING_PREDICTORS`.
        runs: of each recording, for predictors that chance plays a part in (P2: 10).
        recovery: how known weights are learned again, if "learned" is among the predictors.
        seed: of learning and of the runs.
        jobs: processes; nothing but times depends on it.

    Raises:
        UsageError: names or numbers that cannot be.
    """

    predictors: tuple[str, ...] = tuple(REACHING_PREDICTORS)
    runs: int = 10
    recovery: RecoveryConfig = field(default_factory=RecoveryConfig)
    seed: int = 0
    jobs: int = 1

    def __post_init__(self) -> None:
        for name in self.predictors or ("",):
            reaching_entry(name)
        if self.runs < 1 or self.seed < 0 or self.jobs < 1:
            raise UsageError(
                "evaluation: wanted at least one run, a seed >= 0 and at least one process, got "
                f"{self.runs}, {self.seed} and {self.jobs}"
            )

    @property
    def repetitions(self) -> list[int]:
        """Numbers of the repetitions of recovering known weights; none if that is left out."""
        return self.recovery.tasks if "learned" in self.predictors else []

    @property
    def complete(self) -> bool:
        """Whether this is everything that P2 shows, and as often."""
        return set(self.predictors) == set(REACHING_PREDICTORS) and self.runs >= 10 and bool(self.repetitions)


def evaluate_reaching(
    recordings: Sequence[ReachRecording],
    interference: Sequence[ReachRecording] = (),
    config: ReachingConfig | None = None,
    *,
    model: HumanModel | None = None,
    spread: Spread = map_processes,
    progress: Callable[[int], None] | None = None,
) -> ReachingEvaluation:
    """Predict all recordings with all predictors and return the figures.

    Args:
        recordings: demonstrations, each predicted from the others.
        interference: reaches that the partner is in the way of, predicted from all demonstrations.
        config: what is run.
        model: the human; P2's 23-DoF human if None.
        spread: does the predictions, by default in processes.
        progress: called with the number of tasks done, of `steps_of`.

    Raises:
        UsageError: no recordings, or fewer than two, of which none could be left out.
        MotionError: recordings that nothing can be learned from.
    """
    begin = time.perf_counter()
    config = config or ReachingConfig()
    if len(recordings) < 2:
        raise UsageError(
            f"evaluation: wanted at least 2 recordings, to leave one out, got {len(recordings)}; add others"
        )
    known = {recording.name for recording in recordings}
    if twice := [recording.name for recording in interference if recording.name in known]:
        raise UsageError(f"interference case: wanted recordings not learned from, got {', '.join(twice)} again")
    model = model or HumanModel.mocap23()
    ordered = sorted(recordings, key=_papers_order)
    hands_m = [model.forward(recording.active.q)[WRIST] for recording in ordered]
    scene = Surroundings.around_hands(np.concatenate(hands_m))
    learned = _learned(ordered, model, config, scene)
    material = ReachingMaterial(ordered, model, {how: entry.table for how, entry in learned.items()}, scene)
    times = prediction_times(config.predictors, ordered, material)

    tasks = list(tasks_of(ordered, interference, config))
    outcomes = _spread_out(spread, RecordingRuns(material, config.seed), tasks, config.jobs, progress)
    found = {(task.predictor, task.recording.name): outcome for task, outcome in zip(tasks, outcomes, strict=True)}
    recovery = None
    if repetitions := config.repetitions:
        runs = spread(
            Recovery(ordered, model, config.recovery, config.seed), repetitions, config.jobs,
            None if progress is None else lambda done: progress(len(tasks) + done),
        )  # fmt: skip
        recovery = RecoveryFigures.of(runs, config.recovery)

    seven = known == set(DEMONSTRATIONS)
    table2: Sequence[PublishedRow] = PUBLISHED if seven else ()
    sets = [
        set_of(
            "each predicted from the others",
            ordered,
            found,
            config.predictors,
            model,
            table2,
            left_out=True,
            learned_from=ordered,
        )
    ]
    if interference:
        papers = [recording.name for recording in interference] == [INTERFERENCE_CASE]
        title = "partner in the way, predicted from all the demonstrations"
        table3: Sequence[PublishedRow] = PUBLISHED_INTERFERENCE if papers else ()
        sets.append(
            set_of(title, interference, found, config.predictors, model, table3, left_out=False, learned_from=ordered)
        )
    weights = weight_figures(learned, ordered, model, config.seed) if learned else None
    elapsed_s = time.perf_counter() - begin
    return ReachingEvaluation(
        settings={
            "config": asdict(config),
            "human": model.name,
            "human_signature": model.signature,
            "obstacles": [obstacle.name for obstacle in scene.obstacles],
        },
        machine=machine_facts(),
        sets=tuple(sets),
        table1={recording.name: TABLE1[recording.name] for recording in ordered if recording.name in TABLE1},
        weights=weights,
        recovery=recovery,
        times=times,
        elapsed_s=elapsed_s,
        targets=targets_of(
            sets[0], sets[1] if len(sets) > 1 else None, weights, times, elapsed_s if config.complete else None
        ),
    )


def tasks_of(
    recordings: Sequence[ReachRecording], interference: Sequence[ReachRecording], config: ReachingConfig
) -> Iterator[RecordingTask]:
    """Yield what is predicted: every recording with every predictor that can be tested on it."""
    for name in config.predictors:
        entry = reaching_entry(name)
        for recording in (*recordings, *(() if entry.of_tested else interference)):
            yield RecordingTask(name, recording, config.runs if entry.by_chance else 1)


def steps_of(
    recordings: Sequence[ReachRecording], interference: Sequence[ReachRecording], config: ReachingConfig
) -> int:
    """Return how many tasks there are in all."""
    return sum(1 for _ in tasks_of(recordings, interference, config)) + len(config.repetitions)


def _learned(
    recordings: Sequence[ReachRecording], model: HumanModel, config: ReachingConfig, scene: Surroundings
) -> dict[str, LearnedWeights]:
    wanted = dict.fromkeys(reaching_entry(name).learns for name in config.predictors)
    return {how: learn_all(recordings, model, how, config.seed, scene) for how in wanted if how is not None}


def _spread_out(
    spread: Spread,
    runs: RecordingRuns,
    tasks: Sequence[RecordingTask],
    jobs: int,
    progress: Callable[[int], None] | None,
) -> list[RecordingOutcome]:
    """Return the outcomes in the order of the tasks; long ones are done first."""
    order = long_first(tasks)
    done = spread(runs, [tasks[k] for k in order], jobs, progress)
    outcomes = dict(zip(order, done, strict=True))
    return [outcomes[k] for k in range(len(tasks))]


def _papers_order(recording: ReachRecording) -> tuple[int, str]:
    known = recording.name in DEMONSTRATIONS
    return (DEMONSTRATIONS.index(recording.name) if known else len(DEMONSTRATIONS), recording.name)
