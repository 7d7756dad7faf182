"""P1's classifier: how likely is the part of the motion seen so far under each class's Gaussian mixture (P1 III)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from humanpred_ros.errors import ArrayError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, is_angle, unwrap_angles
from humanpred_ros.recognition.class_mixtures import ClassMixtures, fit_class_mixtures, refit_class_mixtures
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.gmm_config import ONLINE_SETTINGS, GmmSettings
from humanpred_ros.recognition.mixture_bank import MixtureBank
from humanpred_ros.recognition.phase import phase_frames

__all__ = ["GmmClassifier", "GmmSettings"]

_TURN = 2 * np.pi


class _Seen(NamedTuple):
    """What the classifier remembers of the motion under way."""

    n_frames: int
    first_s: float
    t_s: float
    q: FloatArray  # (D,) last posture as it came
    turns: FloatArray  # (D,) whole turns to take off it
    total: FloatArray  # (C,) summed log densities


class GmmClassifier(Classifier):
    """P1: a Gaussian mixture per class over phase and posture.

    P(C_m | x_1 .. x_t) follows from the sum (P1) or the mean (published code) of ln p(x_i | C_m).

    Each posture is judged on its own, so one update costs the same whatever came before; a window is a ring
    buffer of the last log densities.

    Attributes:
        settings: online ones take effect at construction.
        classes: what was learned, None before `fit`.
    """

    settings_type = GmmSettings
    online_settings = ONLINE_SETTINGS
    settings: GmmSettings

    def __init__(
        self, human: HumanModel, settings: GmmSettings | None = None, classes: ClassMixtures | None = None
    ) -> None:
        """Make a classifier to fit, or, with `classes`, one that is ready for use.

        Raises:
            UsageError: classes that were learned with the phase and settings without it, or the reverse.
        """
        super().__init__(human, settings)
        self.classes: ClassMixtures | None = None
        if classes is not None:
            self._take(classes)

    def fit(self, library: MotionLibrary) -> GmmClassifier:
        """Learn one mixture per class; return self. Raises LibraryFormatError if the library does not suffice."""
        self._take(fit_class_mixtures(library, self.settings))
        return self

    def fit_without(self, library: MotionLibrary, name: str) -> GmmClassifier:
        """Return a classifier learned from `library` without one motion; only that motion's class is learned anew."""
        label = library.find(name).label
        rest = library.select(lambda motion: motion.name != name)
        if label is None:
            return GmmClassifier(self.human, self.settings).fit(rest)
        return GmmClassifier(
            self.human, self.settings, refit_class_mixtures(self._fitted(), rest, label, self.settings)
        )

    @property
    def nominal_duration_s(self) -> float:
        """Expected duration of a motion: the setting if given, else the library's median."""
        return self.settings.nominal_duration_s or self._fitted().nominal_duration_s

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        self._seen: _Seen | None = None

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` and return the posterior over the classes.

        A call that raises leaves the classifier as it was.

        Raises:
            ArrayError: posture of the wrong shape, not finite, or absurdly far from everything learned.
            MotionError: a stamp that is not finite or not later than the one before.
            UsageError: nothing was learned yet.
        """
        classes, before = self._fitted(), self._seen
        q = checked("posture", q, (len(classes.dof_names),))
        if not math.isfinite(t_s) or (before is not None and t_s <= before.t_s):
            raise MotionError(
                f"classifier: wanted a finite stamp{'' if before is None else f' later than {before.t_s} s'}, "
                f"got {t_s} s; call start() when a new motion begins"
            )
        if before is None:
            before = _Seen(0, t_s, t_s, q, np.zeros(len(q)), np.zeros(len(classes.labels)))
        turns = before.turns + np.round((q - before.q) / _TURN) * self._is_angle
        x = q - _TURN * turns
        if classes.has_phase:
            phase = phase_frames(t_s - before.first_s, self.nominal_duration_s, self.settings.n_phase_frames)
            x = np.concatenate([[phase], x])
        log_density = self._usable(self._bank.log_density(x))

        n_frames = before.n_frames + 1
        if self._ring is None:
            counted, total = n_frames, before.total + log_density
        else:
            self._ring[before.n_frames % len(self._ring)] = log_density
            counted = min(n_frames, len(self._ring))
            # Summed anew: subtracting what leaves the window would pile up rounding for as long as it runs.
            total = self._ring[:counted].sum(axis=0)
        self._seen = _Seen(n_frames, before.first_s, t_s, q.copy(), turns, total)
        evidence = total / counted if self.settings.evidence == "mean" else total.copy()
        return ClassPosterior(classes.labels, self._posterior(evidence), evidence, t_s, n_frames)

    def evidence(self, motion: Motion) -> FloatArray:
        """Return (T, C) the log evidence after each posture of a whole motion, computed at once.

        The same as `update` posture by posture, for evaluations over whole libraries.

        Raises:
            UsageError: nothing was learned yet, or of other DoFs.
        """
        classes = self._fitted()
        if motion.dof_names != classes.dof_names:
            raise UsageError(
                f"classifier: wanted a motion of the DoFs {classes.dof_names}, {motion.name} has {motion.dof_names}"
            )
        postures = unwrap_angles(motion).q if self.settings.unwrap_angles else motion.q
        x = postures
        if classes.has_phase:
            phase = phase_frames(motion.t_s - motion.t_s[0], self.nominal_duration_s, self.settings.n_phase_frames)
            x = np.column_stack([phase, x])
        log_density = self._usable(np.column_stack([mixture.log_density(x) for mixture in classes.mixtures]))
        total = np.cumsum(log_density, axis=0)
        counted = np.arange(1, len(x) + 1)
        if self.settings.window_frames is not None:
            window = min(self.settings.window_frames, len(x))
            windows = np.lib.stride_tricks.sliding_window_view(log_density, window, axis=0)
            total = np.concatenate([total[: window - 1], windows.sum(axis=-1)])
            counted = np.minimum(counted, window)
        return total / counted[:, None] if self.settings.evidence == "mean" else total

    def posteriors(self, motion: Motion) -> FloatArray:
        """Return (T, C) the posterior after each posture of a whole motion, computed at once."""
        return self._posterior(self.evidence(motion))

    def with_online(self, **changes: object) -> GmmClassifier:
        """Return a fresh classifier with the same mixtures and other online settings (see `GmmSettings`)."""
        return GmmClassifier(self.human, self.settings.with_online(**changes), self._fitted())

    def _take(self, classes: ClassMixtures) -> None:
        if classes.has_phase != self.settings.phase_feature:
            raise UsageError(
                f"classifier: settings say phase_feature={self.settings.phase_feature}, the mixtures have "
                f"{'a' if classes.has_phase else 'no'} phase; use the settings the mixtures were fitted with"
            )
        self.classes = classes
        # Turns of what is not an angle, or is not to be unwrapped, count nothing.
        self._is_angle = np.array([self.settings.unwrap_angles and is_angle(name) for name in classes.dof_names], float)
        self._bank = MixtureBank(classes.mixtures)
        window = self.settings.window_frames
        self._ring = None if window is None else np.zeros((window, len(classes.labels)))
        self._log_prior = np.zeros(len(classes.labels))
        if self.settings.prior == "frequency":
            count = np.asarray(classes.motions_per_class, dtype=np.float64)
            self._log_prior = np.log(count / count.sum())
        self.start()

    def _fitted(self) -> ClassMixtures:
        if self.classes is None:
            raise UsageError("classifier: wanted one that has learned, got a new one; call fit(library) first")
        return self.classes

    def _usable(self, log_density: FloatArray) -> FloatArray:
        if not np.isfinite(log_density).all():
            raise ArrayError(
                "classifier: a posture is so far from everything learned that its density cannot be computed; "
                "check units and order of the degrees of freedom, and the tracker"
            )
        floor = self.settings.frame_log_density_floor
        return log_density if floor is None else np.maximum(log_density, floor)

    def _posterior(self, evidence: FloatArray) -> FloatArray:
        """Return the normalised exponentials over the last axis, the largest exponent subtracted first."""
        exponent = evidence + self._log_prior
        weight = np.exp(exponent - exponent.max(axis=-1, keepdims=True))
        normalised: FloatArray = weight / weight.sum(axis=-1, keepdims=True)
        return normalised
