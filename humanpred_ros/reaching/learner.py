"""Learns weights from recordings, and says how certain they are and where they come from (P2 III-C)."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence

import numpy as np

from humanpred_ros import __version__
from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.collisions import DOUBTFUL_M, ReachCollisions
from humanpred_ros.reaching.demonstrations import Demonstration, SamplingSettings, demonstrations
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, N_WAYPOINTS, REACH, ReachFeatures
from humanpred_ros.reaching.piirl import Contrast, PiirlSettings, PiirlSolution, contrasts, learn_weights
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.reaching.weights import ReachWeights
from humanpred_ros.settings import LARGEST_SEED, Settings, setting

_log = logging.getLogger(__name__)


class LearningSettings(Settings):
    """How weights are learned from recordings."""

    n_waypoints: int = setting(N_WAYPOINTS, "Waypoints that a reach is resampled to, evenly in time", low=2 * REACH + 1)
    cut: bool = setting(True, "Also learn from the later parts of reaches, cut at every 0.1 s")
    sampling: SamplingSettings = setting(SamplingSettings(), "How demonstrations are varied")
    collisions: bool = setting(True, "Discard samples that go through table or partner")
    piirl: PiirlSettings = setting(PiirlSettings(), "Loss, bounds, penalties")
    keep_unfit: bool = setting(False, "Also learn from recordings with jumps, as P2 did")
    bootstrap: int = setting(20, "Times that weights are learned again, from recordings drawn with replacement", low=0)
    seed: int = setting(0, "Seed of samples and bootstrap", low=0, high=LARGEST_SEED)


class ReachLearner:
    """Learns weights from any choice of some recordings; samples are drawn and evaluated once.

    Weights of a choice (leave one out, bootstrap, single recordings) are then a few milliseconds each.

    Args:
        recordings: all that will be chosen from.
        model: the human; P2's 23-DoF human if None.
        settings: how to learn.
        surroundings: what samples must not touch, beside the partner; P2's table if None.

    Attributes:
        settings: how it learns.
        names: of the recordings that something can be learned from.

    Raises:
        UsageError: two recordings of one name.
        HumanModelError: recordings of another human.
        MotionError: all samples around a demonstration collide.
    """

    def __init__(
        self,
        recordings: Sequence[ReachRecording],
        model: HumanModel | None = None,
        settings: LearningSettings | None = None,
        surroundings: Surroundings | None = None,
    ) -> None:
        self.settings = s = settings or LearningSettings()
        self._model = model or HumanModel.mocap23()
        features = ReachFeatures(self._model, s.n_waypoints)
        self._recordings = {recording.name: recording for recording in recordings}
        if len(self._recordings) < len(recordings):
            names = [recording.name for recording in recordings]
            twice = sorted({name for name in names if names.count(name) > 1})
            raise UsageError(f"learning: wanted recordings of different names, got {', '.join(twice)} more than once")
        for recording in recordings:
            self._model.check_dofs(recording.active.dof_names)
        demos = demonstrations(recordings, features, cut=s.cut, keep_unfit=s.keep_unfit)
        self._left_out = _left_out(recordings, demos)
        collisions = ReachCollisions(self._model, surroundings) if s.collisions else None
        self._obstacles = [] if collisions is None else [each.name for each in collisions.surroundings.obstacles]
        self._contrasts = contrasts(demos, features, s.sampling, np.random.default_rng(s.seed), collisions)
        self.names = tuple(dict.fromkeys(contrast.recording for contrast in self._contrasts))
        # (name of a recording, a sentence about it)
        self._notes = [*self._left_out.items(), *_unfit_but_used(recordings, demos)]
        self._notes += [*self._touching(), *self._too_few_samples()]

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences, with the recording's name, on what was left out, what touches what, and where samples are missing.

        Those that question the data were also logged as warnings.
        """
        return tuple(text for _, text in self._notes)

    def learn(self, names: Sequence[str] | None = None, *, bootstrap: bool = True) -> ReachWeights:
        """Return the weights learned from the recordings `names`, from all if None.

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
        left_out = [self._left_out[name] for name in chosen if name in self._left_out]
        if not mine:
            why = "; ".join(left_out) or "no recordings"
            raise MotionError(f"learning: wanted at least one demonstration, got none ({why}); add recordings")
        solution = learn_weights(mine, self.settings.piirl)
        return ReachWeights(
            weights=solution.weights,
            bootstrap=self._bootstrap(mine, solution) if bootstrap else np.zeros((0, N_FEATURES)),
            at_upper=tuple(name for name, stopped in zip(FEATURE_NAMES, solution.at_upper, strict=True) if stopped),
            provenance={
                "package_version": __version__,
                "human": self._model.name,
                "human_signature": self._model.signature,
                "recordings": list(chosen),
                "sha256": {name: recording_hash(self._recordings[name]) for name in chosen},
                "left_out": left_out,
                "notes": [text for name, text in self._notes if name in chosen],
                "demonstrations": [contrast.demonstration for contrast in mine],
                "samples": [len(contrast.differences) for contrast in mine],
                "discarded": [contrast.discarded for contrast in mine],
                "obstacles": self._obstacles,
                "loss": solution.loss,
                "config": self.settings.model_dump(),
            },
        )

    def _touching(self) -> list[tuple[str, str]]:
        """Return for each recording where its demonstrations are deepest inside something."""
        deepest: dict[str, Contrast] = {}
        for contrast in self._contrasts:
            known = deepest.get(contrast.recording)
            if contrast.touches and (known is None or contrast.touches[0].depth_m > known.touches[0].depth_m):
                deepest[contrast.recording] = contrast
        notes = []
        for name, contrast in deepest.items():
            touch = contrast.touches[0]
            text = f"{name}: {touch} as recorded (demonstration {contrast.demonstration}); samples may go as deep there"
            if touch.depth_m > DOUBTFUL_M:
                text += "; check that the scene stands where it stood when this was recorded"
                _log.warning(text)
            notes.append((name, text))
        return notes

    def _too_few_samples(self) -> list[tuple[str, str]]:
        wanted = self.settings.sampling.n_samples
        notes = []
        for contrast in self._contrasts:
            if (got := len(contrast.differences)) < wanted:
                text = f"{contrast.recording}: {got} of {wanted} samples for demonstration {contrast.demonstration}, "
                text += f"{contrast.discarded} collide; it counts less"
                _log.warning(text)
                notes.append((contrast.recording, text))
        return notes

    def _bootstrap(self, mine: Sequence[Contrast], solution: PiirlSolution) -> FloatArray:
        """Return weights (B, 24) from recordings drawn with replacement; none from one recording.

        Recordings are drawn, not demonstrations: the cuts of one reach are no independent evidence.
        """
        rng = np.random.default_rng([self.settings.seed, 1])
        by_recording: dict[str, list[Contrast]] = {}
        for contrast in mine:
            by_recording.setdefault(contrast.recording, []).append(contrast)
        groups = list(by_recording.values())
        if len(groups) < 2:
            return np.zeros((0, N_FEATURES))
        draws = np.empty((self.settings.bootstrap, N_FEATURES))
        for draw in draws:
            some = [contrast for k in rng.integers(len(groups), size=len(groups)) for contrast in groups[k]]
            draw[:] = learn_weights(some, self.settings.piirl, start=solution.weights).weights
        return draws


def recording_hash(recording: ReachRecording) -> str:
    """Return the sha256 (hex) of a recording's names of DoFs, stamps and postures: what weights were learned from."""
    digest = hashlib.sha256("\n".join(recording.active.dof_names).encode())
    for motion in (recording.active, recording.passive):
        for array in (motion.t_s, motion.q):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


def _left_out(recordings: Sequence[ReachRecording], demos: Sequence[Demonstration]) -> dict[str, str]:
    """Return why a recording, or a part of it, is not learned from, by its name; each reason is logged."""
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


def _unfit_but_used(recordings: Sequence[ReachRecording], demos: Sequence[Demonstration]) -> list[tuple[str, str]]:
    """Return what is wrong with recordings that are learned from because the settings ask for it."""
    whole = {demo.recording for demo in demos if demo.first_frame == 0}
    return [
        (recording.name, f"{recording.unfit}; learned from all the same")
        for recording in recordings
        if recording.name in whole and recording.unfit
    ]
