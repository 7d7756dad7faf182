"""Does learning find weights that are known, and from how many samples? What P2's Fig. 7 shows.

The recorded people's weights are unknown, so demonstrations are made: reaches planned with known weights between the
recorded ends, beside the recorded partners. From these weights are learned, with more and more samples around each
demonstration; reaches planned with the learned weights should then cost no more than the demonstrations, by the known
weights. Demonstration and reach are planned with the same chance, so what they differ by is due to the weights alone;
and without obstacles, which no weight is learned for. Planning is the one that predicts.

P2's own weights for this figure are not known completely: its distance weights (facts section 4) are used with the
smoothness of its baselines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.reaching.learned import IMPROVED, LEARNING, PUBLISHED
from humanpred_ros.evaluation.reaching.result import Statistic
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.demonstrations import Demonstration, demonstration
from humanpred_ros.reaching.features import N_SMOOTHNESS, NAMED_WEIGHTS, ReachFeatures
from humanpred_ros.reaching.first_guess import straight_line
from humanpred_ros.reaching.piirl import Contrast, PiirlSettings, contrasts, learn_weights
from humanpred_ros.reaching.planner import ReachPlanner, ReachPlannerConfig
from humanpred_ros.reaching.posture_bounds import PostureBounds

#: P2's hand-tuned weights of the 16 distances (facts section 4).
_KNOWN_DISTANCES = (
    0.1, 8.0, 5.0, 8.0, 5.0, 1.0, 2.0, 5.0,
    5.0, 2.0, 5.0, 5.0, 5.0, 5.0, 5.0, 2.0,
)  # fmt: skip
#: Ways to learn that are compared. Who is known to mind the partner's nearness can only be learned from with it.
METHODS: Mapping[str, PiirlSettings] = MappingProxyType(
    {
        PUBLISHED: LEARNING[PUBLISHED].piirl,
        f"{IMPROVED}, distances too": LEARNING[IMPROVED].piirl.replaced(without=()),
    }
)


@dataclass(frozen=True)
class RecoveryConfig:
    """What is tried.

    Attributes:
        samples: numbers of samples around each demonstration, ascending; P2 settles for 700. Empty: nothing is tried.
        repetitions: with other demonstrations and samples.

    Raises:
        UsageError: numbers that cannot be.
    """

    samples: tuple[int, ...] = (3, 10, 30, 100, 300, 700)
    repetitions: int = 10

    def __post_init__(self) -> None:
        if any(count < 1 for count in self.samples) or list(self.samples) != sorted(set(self.samples)):
            raise UsageError(
                f"numbers of samples: wanted some of at least 1, ascending, got {', '.join(map(str, self.samples))}"
            )
        if self.repetitions < 1:
            raise UsageError(f"samples: wanted at least one repetition, got {self.repetitions}")

    @property
    def tasks(self) -> list[int]:
        """Numbers of the repetitions; none if nothing is to be tried."""
        return list(range(self.repetitions)) if self.samples else []


@dataclass(frozen=True, eq=False)
class RecoveryRun:
    """One repetition; what reaches cost more than the demonstrations by the known weights, as shares of their cost.

    Attributes:
        learned: (K, D) of reaches planned with learned weights, by method.
        best_sample: (K, D) of the best sample.
        line: (D,) of the straight line that planning begins with, which is also what baseline 0 plans.
    """

    learned: Mapping[str, FloatArray]
    best_sample: FloatArray
    line: FloatArray


@dataclass(frozen=True)
class RecoveryFigures:
    """P2's Fig. 7: cost differences, in percent of the demonstrations' cost.

    Statistics are over repetitions, of the mean over demonstrations.

    Attributes:
        samples: numbers of samples around each demonstration.
        demonstrations: how many.
        learned: one statistic for each number of samples, by method.
        best_sample: the same of the best of the samples.
        line: of the straight line.
    """

    samples: tuple[int, ...]
    demonstrations: int
    learned: Mapping[str, tuple[Statistic, ...]]
    best_sample: tuple[Statistic, ...]
    line: Statistic

    @classmethod
    def of(cls, runs: Sequence[RecoveryRun], config: RecoveryConfig) -> RecoveryFigures:
        """Return the figures of at least one repetition."""
        count = range(len(config.samples))

        def over(pick: Callable[[RecoveryRun], FloatArray]) -> Statistic:
            return Statistic.of([100.0 * float(pick(run).mean()) for run in runs])

        return cls(
            config.samples,
            len(runs[0].line),
            {
                how: tuple(over(lambda run, k=k, how=how: run.learned[how][k]) for k in count)  # type: ignore[misc]
                for how in runs[0].learned
            },
            tuple(over(lambda run, k=k: run.best_sample[k]) for k in count),  # type: ignore[misc]
            over(lambda run: run.line),
        )


class Recovery:
    """Does repetitions; a process keeps it.

    Args:
        recordings: ends, durations and partners of the demonstrations to make.
        model: the human.
        config: what is tried.
        seed: repetition r draws from (seed, r, ..).
    """

    def __init__(
        self, recordings: Sequence[ReachRecording], model: HumanModel, config: RecoveryConfig, seed: int
    ) -> None:
        self._recordings, self._model, self._config, self._seed = tuple(recordings), model, config, seed
        self._bounds = PostureBounds.from_recordings(recordings, model)

    def __call__(self, repetition: int) -> RecoveryRun:
        """Make demonstrations, learn from more and more samples, plan again and compare."""
        features, known = ReachFeatures(self._model), known_weights()
        demos = []
        for number, recording in enumerate(self._recordings):
            situation = demonstration(recording, features).situation
            q = self._planned(known, number, repetition)
            demos.append(Demonstration(recording.name, 0, q, situation))
        costs = np.array([features.values(demo.q, demo.situation) @ known for demo in demos])

        def more(reaches: Sequence[FloatArray]) -> FloatArray:
            found = [features.values(q, demo.situation) @ known for q, demo in zip(reaches, demos, strict=True)]
            shares: FloatArray = np.array(found) / costs - 1.0
            return shares

        sampling = LEARNING[PUBLISHED].sampling.replaced(n_samples=max(self._config.samples))
        drawn = contrasts(demos, features, sampling, np.random.default_rng([self._seed, repetition]))
        learned: dict[str, list[FloatArray]] = {how: [] for how in METHODS}
        best = []
        for count in self._config.samples:
            some = [Contrast(c.demonstration, c.recording, c.differences[:count]) for c in drawn]
            best.append(np.array([(c.differences @ known).min() for c in some]) / costs)
            for how, piirl in METHODS.items():
                weights = learn_weights(some, piirl).weights
                learned[how].append(more([self._planned(weights, d, repetition) for d in range(len(demos))]))
        phase = np.linspace(0.0, 1.0, features.settings.n_waypoints)
        return RecoveryRun(
            learned={how: np.array(shares) for how, shares in learned.items()},
            best_sample=np.array(best),
            line=more([straight_line(demo.q[0], demo.q[-1], phase) for demo in demos]),
        )

    def _planned(self, weights: FloatArray, number: int, repetition: int) -> FloatArray:
        recording = self._recordings[number]
        planner = ReachPlanner(self._model, weights, self._bounds, config=ReachPlannerConfig(obstacle_weight=0.0))
        rng = np.random.default_rng([self._seed, repetition, number])
        ends, partner = recording.active.q[[0, -1]], planner.partner(recording.passive.q[0])
        return planner.plan(ends[0], ends[1], recording.active.duration_s, partner, rng).q


def known_weights() -> FloatArray:
    """Return the weights (24,) that made demonstrations minimise."""
    weights = NAMED_WEIGHTS["baseline_0"].copy()
    weights[N_SMOOTHNESS:] = _KNOWN_DISTANCES
    return frozen(weights)  # type: ignore[return-value]
