"""From recordings to weights, with how sure they are and where they come from."""

from __future__ import annotations

import dataclasses
import hashlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from humanpred_ros import __version__
from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.collisions import CollisionConfig, ReachCollisions, Touch
from humanpred_ros.reaching.demonstrations import Demonstration, SplittingConfig, demonstrations
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, FeatureConfig, ReachFeatures
from humanpred_ros.reaching.piirl import Contrast, PiirlConfig, PiirlSolution, contrasts, learn_weights
from humanpred_ros.reaching.sampling import SamplingConfig
from humanpred_ros.reaching.surroundings import ReachScene

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LearningConfig:
    """How weights are learned from recordings.

    Attributes:
        features: how reaches become features.
        splitting: where reaches are cut; None to learn from whole reaches only.
        sampling: what demonstrations are told apart from.
        collisions: what makes a sample impossible; None keeps samples that run through table and partner.
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
    collisions: CollisionConfig | None = field(default_factory=CollisionConfig)
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
            weight is. B is 0 if there was one recording only.
        at_upper: names of the weights that were stopped by their bound: the data ask for more.
        provenance: what was learned from, how, and by which version.

    Raises:
        MotionError: arrays of another shape, or negative weights.
    """

    weights: FloatArray
    bootstrap: FloatArray
    at_upper: tuple[str, ...]
    provenance: Mapping[str, Any]

    def __post_init__(self) -> None:
        weights = checked("weights", self.weights, (N_FEATURES,), error=MotionError)
        bootstrap = checked("bootstrap", self.bootstrap, ("B", N_FEATURES), error=MotionError)
        if (weights < 0.0).any() or (bootstrap < 0.0).any():
            raise MotionError(f"weights: wanted 0 or more, got {min(weights.min(), bootstrap.min(initial=0.0))}")
        if unknown := sorted(set(self.at_upper) - set(FEATURE_NAMES)):
            raise MotionError(f"weights at their bound: wanted names of features, got {', '.join(unknown)}")
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
        scene: what samples must not run into, beside the partner; P2's table if None.

    Raises:
        UsageError: two recordings of one name.
        HumanModelError: recordings of another human.
        MotionError: all samples around a demonstration collide.
    """

    def __init__(
        self,
        recordings: Sequence[ReachRecording],
        model: HumanModel | None = None,
        config: LearningConfig | None = None,
        scene: ReachScene | None = None,
    ) -> None:
        self.config = config or LearningConfig()
        self._model = model or HumanModel.mocap23()
        features = ReachFeatures(self._model, self.config.features)
        self._recordings = {recording.name: recording for recording in recordings}
        if len(self._recordings) < len(recordings):
            names = [recording.name for recording in recordings]
            twice = sorted({name for name in names if names.count(name) > 1})
            raise UsageError(f"learning: wanted recordings of different names, got {', '.join(twice)} more than once")
        for recording in recordings:
            self._model.check_dofs(recording.active.dof_names)
        demos = demonstrations(recordings, features, self.config.splitting, keep_unfit=self.config.keep_unfit)
        self._left_out = _left_out(recordings, demos)
        # Recordings' names beside what is said of them.
        self._said = [*self._left_out.items(), *_learned_all_the_same(recordings, demos)]
        collisions = None
        if self.config.collisions is not None:
            collisions = ReachCollisions(self._model, scene, self.config.collisions)
        self._obstacles = [] if collisions is None else [obstacle.name for obstacle in collisions.scene.obstacles]
        rng = np.random.default_rng(self.config.seed)
        self._contrasts = contrasts(demos, features, self.config.sampling, rng, collisions)
        self._said += [*self._touching(), *self._scarce()]

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about what was left out, what touches what, and where samples are lacking, by recording's name.

        Those that question the data were logged as warnings, too.
        """
        return tuple(text for _, text in self._said)

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
        chosen = tuple(dict.fromkeys(self._recordings if names is None else names))
        if unknown := [name for name in chosen if name not in self._recordings]:
            raise UsageError(
                f"learning: wanted names of recordings, got {', '.join(unknown)}; use {', '.join(self._recordings)}"
            )
        mine = [contrast for contrast in self._contrasts if contrast.recording in chosen]
        if not mine:
            why = "; ".join(self._left_out[name] for name in chosen if name in self._left_out) or "no recordings"
            raise MotionError(f"learning: wanted at least one demonstration, got none ({why}); add recordings")
        solution = learn_weights(mine, self.config.piirl)
        draws = self._bootstrap(mine, solution) if bootstrap else np.zeros((0, N_FEATURES))
        return ReachWeights(
            weights=solution.weights,
            bootstrap=draws,
            at_upper=tuple(name for name, stopped in zip(FEATURE_NAMES, solution.at_upper, strict=True) if stopped),
            provenance={
                "package_version": __version__,
                "human": self._model.name,
                "human_signature": self._model.signature,
                "recordings": list(chosen),
                "sha256": {name: recording_hash(self._recordings[name]) for name in chosen},
                "left_out": [self._left_out[name] for name in chosen if name in self._left_out],
                "notes": [text for name, text in self._said if name in chosen],
                "demonstrations": [contrast.demonstration for contrast in mine],
                "samples": [len(contrast.differences) for contrast in mine],
                "discarded": [contrast.discarded for contrast in mine],
                "obstacles": self._obstacles,
                "loss": solution.loss,
                "config": dataclasses.asdict(self.config),
            },
        )

    def _touching(self) -> list[tuple[str, str]]:
        """Say once for each recording how deep its demonstrations are in something at most."""
        deepest: dict[str, tuple[Touch, str]] = {}
        for contrast in self._contrasts:
            for touch in contrast.touches[:1]:
                known = deepest.get(contrast.recording)
                if known is None or touch.depth_m > known[0].depth_m:
                    deepest[contrast.recording] = touch, contrast.demonstration
        said = []
        for name, (touch, demonstration) in deepest.items():
            text = f"{name}: {touch} as recorded (demonstration {demonstration}); samples may go as deep there"
            if self.config.collisions is not None and touch.depth_m > self.config.collisions.doubtful_m:
                text += "; check that the scene stands where it stood when this was recorded"
                _log.warning(text)
            said.append((name, text))
        return said

    def _scarce(self) -> list[tuple[str, str]]:
        """Say where fewer samples were found than wanted."""
        wanted = self.config.sampling.n_samples
        said = []
        for contrast in self._contrasts:
            if (got := len(contrast.differences)) < wanted:
                text = f"{contrast.recording}: {got} of {wanted} samples for demonstration {contrast.demonstration}, "
                text += f"{contrast.discarded} collide; it counts less"
                _log.warning(text)
                said.append((contrast.recording, text))
        return said

    def _bootstrap(self, mine: Sequence[Contrast], solution: PiirlSolution) -> FloatArray:
        """Draw recordings, not demonstrations: the cuts of one reach are no independent evidence.

        One recording alone says nothing about how sure its weights are.
        """
        rng = np.random.default_rng([self.config.seed, 1])
        by_recording: dict[str, list[Contrast]] = {}
        for contrast in mine:
            by_recording.setdefault(contrast.recording, []).append(contrast)
        groups = list(by_recording.values())
        if len(groups) < 2:
            return np.zeros((0, N_FEATURES))
        draws = np.empty((self.config.bootstrap, N_FEATURES))
        for draw in draws:
            some = [contrast for k in rng.integers(len(groups), size=len(groups)) for contrast in groups[k]]
            draw[:] = learn_weights(some, self.config.piirl, start=solution.weights).weights
        return draws


def recording_hash(recording: ReachRecording) -> str:
    """Return the sha256 (hex) of a recording's names of DoFs, stamps and postures: what weights were learned from."""
    digest = hashlib.sha256("\n".join(recording.active.dof_names).encode())
    for motion in (recording.active, recording.passive):
        for array in (motion.t_s, motion.q):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


def _left_out(recordings: Sequence[ReachRecording], demos: Sequence[Demonstration]) -> dict[str, str]:
    """Return why nothing, or not all, of a recording is learned from, by its name; each reason is logged."""
    whole = {demo.recording for demo in demos if demo.first_frame == 0}
    parts = [demo.recording for demo in demos]
    found = {}
    for recording in recordings:
        if recording.name in whole:
            continue
        rest = parts.count(recording.name)
        end = f"; only {rest} later part{'s' * (rest > 1)} of it learned from" if rest else "; not learned from"
        found[recording.name] = (recording.unfit or f"{recording.name}: nothing to learn from") + end
        _log.warning(found[recording.name])
    return found


def _learned_all_the_same(
    recordings: Sequence[ReachRecording], demos: Sequence[Demonstration]
) -> list[tuple[str, str]]:
    """Return what speaks against recordings that are learned from because that was asked for."""
    whole = {demo.recording for demo in demos if demo.first_frame == 0}
    return [
        (recording.name, f"{recording.unfit}; learned from all the same")
        for recording in recordings
        if recording.name in whole and recording.unfit
    ]
