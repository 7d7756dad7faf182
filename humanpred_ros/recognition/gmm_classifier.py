"""P1's classifier: how likely is the part of the motion seen so far under each class's Gaussian mixture (P1 III)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError, LibraryFormatError, MotionError, SettingsError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.labels import number_of
from humanpred_ros.motion.motion import Motion, MotionLibrary, is_angle, unwrap_angles
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior, check_trainable
from humanpred_ros.recognition.mixture import GaussianMixtures, fit_mixture, regress
from humanpred_ros.settings import LARGEST_SEED, Settings, setting

_TURN = 2 * np.pi


class GmmSettings(Settings):
    """Settings of the classifier `gmm` (P1 III); some may change after training (`GmmClassifier.online_settings`)."""

    n_components: int = setting(
        40, "Gaussians per class; the published models have 40, P1's text states 20", low=1, high=10_000
    )
    phase_feature: bool = setting(True, "make the frame number a feature beside the posture, unscaled, as P1 does")
    unwrap_angles: bool = setting(
        False,
        "make every angle of a motion continuous from its first posture on, offline and online; false as the authors, "
        "who used their recordings as they came, with jumps of a whole turn",
    )
    covariance_floor: float = setting(1e-5, "added to the diagonal of every covariance", low=0.0, high=1e6)
    n_phase_frames: int = setting(
        100, "postures a motion is resampled to; phases run from 0 to one less", low=2, high=100_000
    )
    seed: int = setting(
        0, "seed of the samples that k-means starts from; each class has its own stream", low=0, high=LARGEST_SEED
    )
    max_iterations: int = setting(200, "EM stops after so many iterations at the latest", low=1)
    tolerance: float = setting(1e-4, "EM stops when the mean log density of a sample changes by less", low=0.0)
    evidence: Literal["sum", "mean"] = setting(
        "sum",
        "sum adds the log densities of the observed postures (P1 III); mean averages them, as the published code does, "
        "which leaves the decision the same and the posterior much softer",
    )
    window_frames: int | None = setting(
        None, "count only the last so many postures; none counts all; the published code did 10", low=1, high=100_000
    )
    frame_log_density_floor: float | None = setting(
        None, "no posture counts less than this; the published code had -708; none sets no floor"
    )
    prior: Literal["uniform", "frequency"] = setting(
        "uniform", "probability of the classes at first: uniform (P1), or their frequency in the library"
    )
    nominal_duration_s: float | None = setting(
        None,
        "expected duration of a motion, from which the phase follows; none takes the library's median",
        unit="s",
        high=1e6,
    )

    def check(self) -> None:
        if self.nominal_duration_s is not None and not self.nominal_duration_s > 0.0:
            raise SettingsError(
                f"GmmSettings nominal_duration_s: wanted a positive time or none, got {self.nominal_duration_s}"
            )


@dataclass(frozen=True, eq=False)
class ClassMixtures:
    """A library's classes as mixtures: immutable.

    Raises:
        ArrayError: lengths that do not agree, labels twice, a duration that is not positive.
    """

    labels: tuple[str, ...]  #: C class labels
    #: one a class, over F features: the postures' D, with the phase before them if it is a feature
    mixtures: GaussianMixtures
    motions_per_class: tuple[int, ...]  #: C counts of the motions learned from
    dof_names: tuple[str, ...]  #: D names
    nominal_duration_s: float  #: median duration of the motions learned from

    def __post_init__(self) -> None:
        n = len(self.labels)
        n_mixtures, n_features = len(self.mixtures.weights), self.mixtures.n_features
        if len(set(self.labels)) != n or n_mixtures != n or len(self.motions_per_class) != n:
            raise ArrayError(
                f"class mixtures: wanted one mixture and one count for each of different labels, got labels "
                f"{self.labels}, {n_mixtures} mixtures and {len(self.motions_per_class)} counts"
            )
        if n_features - len(self.dof_names) not in (0, 1):
            raise ArrayError(
                f"class mixtures: wanted {len(self.dof_names)} features, or one more with the phase, got {n_features}"
            )
        if min(self.motions_per_class) < 1 or not 0 < self.nominal_duration_s < np.inf:
            raise ArrayError(
                "class mixtures: wanted positive motion counts and a positive duration, "
                f"got {self.motions_per_class} and {self.nominal_duration_s} s"
            )

    @property
    def has_phase(self) -> bool:
        """Whether the first feature is the phase."""
        return self.mixtures.n_features == len(self.dof_names) + 1


def fit_class_mixtures(
    library: MotionLibrary, settings: GmmSettings, *, known: ClassMixtures | None = None, changed: str | None = None
) -> ClassMixtures:
    """Fit one mixture per class of a library (P1 III).

    The mixture of a class depends on the motions of this class and on the seed, on nothing else; neither the
    order of the library nor the other classes change it.

    Args:
        library: to learn from.
        settings: how.
        known: of a library that differs in one class only, and the same settings; the other classes are taken over.
        changed: label of that class.

    Raises:
        LibraryFormatError: motions without a label, one class only, a class of one motion, a class that does not
            move, too little data for the number of components, or other classes than those of `known`.
    """
    check_trainable(library)
    if known is not None and library.labels != known.labels:
        raise LibraryFormatError(
            f"library {library.name}: wanted the classes {known.labels} that were learned before, got "
            f"{library.labels}; fit anew"
        )
    mixtures = [
        known.mixtures[k] if known is not None and label != changed else _fit_class(library, label, settings)
        for k, label in enumerate(library.labels)
    ]
    return ClassMixtures(
        library.labels,
        GaussianMixtures.joined(mixtures),
        tuple(len(library.of_class(label)) for label in library.labels),
        library.dof_names,
        float(np.median([motion.duration_s for motion in library])),
    )


def _fit_class(library: MotionLibrary, label: str, settings: GmmSettings) -> GaussianMixtures:
    samples = np.vstack([training_samples(motion, settings) for motion in library.of_class(label)])
    rng = np.random.default_rng([settings.seed, number_of(label)])
    try:
        return fit_mixture(
            samples,
            settings.n_components,
            rng,
            covariance_floor=settings.covariance_floor,
            tolerance=settings.tolerance,
            max_iterations=settings.max_iterations,
        )
    except LibraryFormatError as trouble:
        raise LibraryFormatError(f"library {library.name}, class {label}: {trouble}") from trouble


def training_samples(motion: Motion, settings: GmmSettings) -> FloatArray:
    """Return the (n_phase_frames, F) samples a motion contributes to its class; F = D, or 1 + D with phase first.

    They are evenly spaced in time, each the last posture recorded by then. Nothing is interpolated, as P1's code does
    (docs/papers.md, P1 library): the mean of two angles on both sides of a wrap is a posture that did not occur.
    """
    motion = unwrap_angles(motion) if settings.unwrap_angles else motion
    wanted_s = np.linspace(0.0, motion.duration_s, settings.n_phase_frames)
    # Stamps are whole nanoseconds; half of one keeps a posture that lies exactly on a wanted time.
    postures = motion.q[np.searchsorted(motion.t_s - motion.t_s[0], wanted_s + 0.5e-9, side="right") - 1]
    if not settings.phase_feature:
        return postures
    return np.column_stack([np.arange(settings.n_phase_frames, dtype=np.float64), postures])


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

    P(C_m | x_1 .. x_t) follows from the sum (P1) or the mean (published code) of ln p(x_i | C_m). Each posture is
    judged on its own, so one update costs the same whatever came before; a window is a ring buffer of the last log
    densities.

    Attributes:
        classes: what was learned, None before `fit`.
    """

    settings_type = GmmSettings
    online_settings = ("evidence", "window_frames", "frame_log_density_floor", "prior", "nominal_duration_s")
    settings: GmmSettings

    def __init__(self, human: HumanModel, settings: Settings | None = None) -> None:
        super().__init__(human, settings)
        self.classes: ClassMixtures | None = None
        #: What mixtures with the phase are fitted to when expected motions are asked for; empty if these have it.
        self._motions: tuple[Motion, ...] = ()
        self._expected_q: FloatArray | None = None

    def fit(self, library: MotionLibrary) -> GmmClassifier:
        """Learn one mixture per class; return self. Raises LibraryFormatError if the library does not suffice."""
        self._remember(library)
        return self._take(fit_class_mixtures(library, self.settings))

    def fit_without(self, library: MotionLibrary, name: str) -> GmmClassifier:
        """Return a classifier learned from `library` without one motion; only that motion's class is learned anew."""
        label = library.find(name).label
        rest = library.select(lambda motion: motion.name != name)
        other = GmmClassifier(self.human, self.settings)
        if label is None:
            return other.fit(rest)
        other._remember(rest)
        return other._take(fit_class_mixtures(rest, self.settings, known=self._fitted(), changed=label))

    def fresh(self, settings: Settings | None = None) -> GmmClassifier:
        other = GmmClassifier(self.human, settings or self.settings)
        other._motions, other._expected_q = self._motions, self._expected_q
        return other._take(self._fitted())

    def state(self) -> dict[str, NDArray[Any]]:
        classes = self._fitted()
        return {
            "labels": np.array(classes.labels),
            "weights": classes.mixtures.weights,
            "means": classes.mixtures.means,
            "covariances": classes.mixtures.covariances,
            "motions_per_class": np.array(classes.motions_per_class, dtype=np.int64),
            "nominal_duration_s": np.array(classes.nominal_duration_s),
            "expected_q": self.expected_q,
        }

    @classmethod
    def from_state(cls, human: HumanModel, settings: Settings, state: Mapping[str, NDArray[Any]]) -> GmmClassifier:
        self = cls(human, settings)
        self._take(
            ClassMixtures(
                tuple(str(label) for label in state["labels"]),
                GaussianMixtures(state["weights"], state["means"], state["covariances"]),
                tuple(int(n) for n in state["motions_per_class"]),
                human.dof_names,
                float(state["nominal_duration_s"]),
            )
        )
        found = state["weights"].shape[1]
        if found != self.settings.n_components:
            raise ArrayError(f"gmm: wanted {self.settings.n_components} components in every mixture, got {found}")
        shape = (len(state["labels"]), self.settings.n_phase_frames, len(human.dof_names))
        self._expected_q = checked("expected motions", state["expected_q"], shape)
        return self

    @property
    def expected_q(self) -> FloatArray:
        """(C, n_phase_frames, D) the expected motion of each class (P1 III, GMR), in the library's frame.

        Settings without the phase need mixtures with it beside their own, which are fitted when this is first asked.
        """
        if self._expected_q is None:
            classes = self._fitted()
            if not classes.has_phase:
                library = MotionLibrary("the library learned from", self._motions)
                classes = fit_class_mixtures(library, self.settings.replaced(phase_feature=True))
            phase = np.arange(self.settings.n_phase_frames, dtype=np.float64)
            self._expected_q = regress(classes.mixtures, phase)
        return self._expected_q

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
        turns = before.turns + np.round((q - before.q) / _TURN) * self._unwrapped
        x = q - _TURN * turns
        if classes.has_phase:
            # P1's phase is the frame number of a motion resampled to 100 postures. Online the end is not known; the
            # duration is the one expected of a motion of this library.
            last = self.settings.n_phase_frames - 1
            phase = np.clip((t_s - before.first_s) * (last / self.nominal_duration_s), 0.0, float(last))
            x = np.concatenate([[phase], x])
        log_density = classes.mixtures.log_density(x)
        if not np.isfinite(log_density).all():
            raise ArrayError(
                "classifier: a posture is so far from everything learned that its density cannot be computed; "
                "check units and order of the degrees of freedom, and the tracker"
            )
        if self.settings.frame_log_density_floor is not None:
            log_density = np.maximum(log_density, self.settings.frame_log_density_floor)

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
        exponent = evidence + self._log_prior
        weight = np.exp(exponent - exponent.max())
        return ClassPosterior(classes.labels, weight / weight.sum(), evidence, t_s, n_frames)

    def _remember(self, library: MotionLibrary) -> None:
        # Not the library itself: its provenance cannot be copied, and classifiers are.
        self._motions = () if self.settings.phase_feature else library.motions

    def _take(self, classes: ClassMixtures) -> GmmClassifier:
        if classes.has_phase != self.settings.phase_feature:
            raise UsageError(
                f"classifier: settings say phase_feature={self.settings.phase_feature}, the mixtures have "
                f"{'a' if classes.has_phase else 'no'} phase; use the settings the mixtures were fitted with"
            )
        self.classes = classes
        #: 1 for degrees of freedom whose whole turns are taken off.
        self._unwrapped = np.array(
            [self.settings.unwrap_angles and is_angle(name) for name in classes.dof_names], float
        )
        window = self.settings.window_frames
        self._ring = None if window is None else np.zeros((window, len(classes.labels)))
        self._log_prior = np.zeros(len(classes.labels))
        if self.settings.prior == "frequency":
            count = np.asarray(classes.motions_per_class, dtype=np.float64)
            self._log_prior = np.log(count / count.sum())
        self.start()
        return self

    def _fitted(self) -> ClassMixtures:
        if self.classes is None:
            raise UsageError("classifier: wanted one that has learned, got a new one; call fit(library) first")
        return self.classes
