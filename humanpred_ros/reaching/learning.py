"""From recordings to weights, with how sure they are and where they come from."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from humanpred_ros import __version__
from humanpred_ros.checks import FloatArray, checked, frozen
from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, FeatureConfig, ReachFeatures
from humanpred_ros.reaching.piirl import Contrast, PiirlConfig, PiirlSolution, contrasts, learn_weights
from humanpred_ros.reaching.sampling import Collides, SamplingConfig
from humanpred_ros.reaching.splitting import SplittingConfig, demonstrations


@dataclass(frozen=True)
class LearningConfig:
    """How weights are learned from recordings.

    Attributes:
        features: how reaches become features.
        splitting: where reaches are cut; None to learn from whole reaches only.
        sampling: what demonstrations are told apart from.
        piirl: loss, bounds, penalties.
        keep_unfit: learn from recordings with jumps, too, as P2 did.
        bootstrap: weights are learned so many more times, from recordings drawn with replacement.
        seed: of samples and bootstrap.

    Raises:
        UsageError: a negative number.
    """

    features: FeatureConfig = field(default_factory=FeatureConfig)
    splitting: SplittingConfig | None = field(default_factory=SplittingConfig)
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    piirl: PiirlConfig = field(default_factory=PiirlConfig)
    keep_unfit: bool = False
    bootstrap: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        if self.bootstrap < 0 or self.seed < 0:
            raise UsageError(f"learning: wanted bootstrap and seed of 0 or more, got {self.bootstrap}, {self.seed}")


@dataclass(frozen=True, eq=False)
class ReachWeights:
    """What a person minimises while reaching, learned: immutable.

    Attributes:
        weights: (24,) of `FEATURE_NAMES`.
        bootstrap: (B, 24) weights learned from recordings drawn with replacement; how they scatter says how sure a
            weight is.
        at_upper: names of the weights that were stopped by their bound: the data ask for more.
        provenance: what was learned from, how, and by which version.

    Raises:
        MotionError: arrays of another shape.
    """

    weights: FloatArray
    bootstrap: FloatArray
    at_upper: tuple[str, ...]
    provenance: Mapping[str, Any]

    def __post_init__(self) -> None:
        weights = checked("weights", self.weights, (N_FEATURES,), error=MotionError)
        bootstrap = checked("bootstrap", self.bootstrap, ("B", N_FEATURES), error=MotionError)
        object.__setattr__(self, "weights", frozen(weights))
        object.__setattr__(self, "bootstrap", frozen(bootstrap))
        object.__setattr__(self, "at_upper", tuple(self.at_upper))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @property
    def spread(self) -> FloatArray:
        """(24,) standard deviation over the bootstrap; NaN with fewer than two."""
        if len(self.bootstrap) < 2:
            return np.full(N_FEATURES, np.nan)
        spread: FloatArray = self.bootstrap.std(axis=0, ddof=1)
        return spread


class ReachLearner:
    """Learns weights from any choice of some recordings, drawing and evaluating samples once.

    Leave-one-out, bootstrap and single-recording weights are then a few milliseconds each.

    Args:
        recordings: all that will be chosen from.
        model: the human; P2's 23-DoF human if None.
        config: settings.
        collides: says which samples are impossible; None if all are possible.

    Raises:
        MotionError: all samples around a demonstration collide.
    """

    def __init__(
        self,
        recordings: Sequence[ReachRecording],
        model: HumanModel | None = None,
        config: LearningConfig | None = None,
        collides: Collides | None = None,
    ) -> None:
        self.config = config or LearningConfig()
        features = ReachFeatures(model or HumanModel.mocap23(), self.config.features)
        demos = demonstrations(recordings, features, self.config.splitting, keep_unfit=self.config.keep_unfit)
        rng = np.random.default_rng(self.config.seed)
        self._recordings = {recording.name: recording for recording in recordings}
        self._contrasts = contrasts(demos, features, self.config.sampling, rng, collides)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recordings that something can be learned from."""
        return tuple(dict.fromkeys(contrast.recording for contrast in self._contrasts))

    def learn(self, names: Sequence[str] | None = None, *, bootstrap: bool = True) -> ReachWeights:
        """Return the weights learned from the recordings `names`, all if None.

        Raises:
            UsageError: a name that was not given.
            MotionError: nothing to learn from.
        """
        chosen = tuple(self._recordings) if names is None else tuple(names)
        if unknown := [name for name in chosen if name not in self._recordings]:
            raise UsageError(
                f"learning: wanted names of recordings, got {', '.join(unknown)}; use {', '.join(self._recordings)}"
            )
        mine = [contrast for contrast in self._contrasts if contrast.recording in chosen]
        solution = learn_weights(mine, self.config.piirl)
        draws = self._bootstrap(mine, solution) if bootstrap else np.zeros((0, N_FEATURES))
        return ReachWeights(
            weights=solution.weights,
            bootstrap=draws,
            at_upper=tuple(name for name, stopped in zip(FEATURE_NAMES, solution.at_upper, strict=True) if stopped),
            provenance={
                "package_version": __version__,
                "recordings": list(chosen),
                "left_out": [text for name in chosen if (text := self._recordings[name].unfit)
                             and not self.config.keep_unfit],
                "demonstrations": [contrast.demonstration for contrast in mine],
                "samples": [len(contrast.differences) for contrast in mine],
                "loss": solution.loss,
                "config": dataclasses.asdict(self.config),
            },
        )  # fmt: skip

    def _bootstrap(self, mine: Sequence[Contrast], solution: PiirlSolution) -> FloatArray:
        """Draw recordings, not demonstrations: the cuts of one reach are no independent evidence."""
        rng = np.random.default_rng([self.config.seed, 1])
        by_recording: dict[str, list[Contrast]] = {}
        for contrast in mine:
            by_recording.setdefault(contrast.recording, []).append(contrast)
        groups = list(by_recording.values())
        draws = np.empty((self.config.bootstrap, N_FEATURES))
        for draw in draws:
            some = [contrast for k in rng.integers(len(groups), size=len(groups)) for contrast in groups[k]]
            draw[:] = learn_weights(some, self.config.piirl, start=solution.weights).weights
        return draws
