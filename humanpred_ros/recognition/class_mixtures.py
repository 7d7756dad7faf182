"""What P1's classifier learns from a library: one Gaussian mixture per class, and how long a motion takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import ArrayError, LibraryFormatError
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.recognition.mixture import GaussianMixture, fit_mixture
from humanpred_ros.recognition.phase import training_samples


@dataclass(frozen=True, eq=False)
class ClassMixtures:
    """A library's classes as mixtures: immutable.

    Attributes:
        labels: C class labels.
        mixtures: C mixtures over F features: the postures' D, with the phase before them if it is a feature.
        motions_per_class: C counts of the motions learned from.
        dof_names: D names.
        nominal_duration_s: median duration of the motions learned from.

    Raises:
        ArrayError: lengths that do not agree, labels twice, a duration that is not positive.
    """

    labels: tuple[int, ...]
    mixtures: tuple[GaussianMixture, ...]
    motions_per_class: tuple[int, ...]
    dof_names: tuple[str, ...]
    nominal_duration_s: float

    def __post_init__(self) -> None:
        n = len(self.labels)
        if not n or len(set(self.labels)) != n or len(self.mixtures) != n or len(self.motions_per_class) != n:
            raise ArrayError(
                f"class mixtures: wanted one mixture and one count for each of different labels, got labels "
                f"{self.labels}, {len(self.mixtures)} mixtures and {len(self.motions_per_class)} counts"
            )
        if len({mixture.n_features for mixture in self.mixtures}) != 1:
            raise ArrayError("class mixtures: wanted all mixtures over the same features")
        if self.n_features - len(self.dof_names) not in (0, 1):
            raise ArrayError(
                f"class mixtures: wanted {len(self.dof_names)} features, or one more with the phase, "
                f"got {self.n_features}"
            )
        if min(self.motions_per_class) < 1 or not 0 < self.nominal_duration_s < np.inf:
            raise ArrayError(
                "class mixtures: wanted positive motion counts and a positive duration, "
                f"got {self.motions_per_class} and {self.nominal_duration_s} s"
            )

    @property
    def n_features(self) -> int:
        """F, features of every mixture."""
        return self.mixtures[0].n_features

    @property
    def has_phase(self) -> bool:
        """Whether the first feature is the phase."""
        return self.n_features == len(self.dof_names) + 1


def fit_class_mixtures(library: MotionLibrary, config: GmmSettings) -> ClassMixtures:
    """Fit one mixture per class of a library (P1 III).

    The mixture of a class depends on the motions of this class and on the seed, on nothing else; neither the
    order of the library nor the other classes change it.

    Raises:
        LibraryFormatError: motions without a label, one class only, a class of one motion, a class that does not
            move, or too little data for the number of components.
    """
    check_trainable(library)
    return _class_mixtures(library, [_fit_class(library, label, config) for label in library.labels])


def refit_class_mixtures(
    classes: ClassMixtures, library: MotionLibrary, label: int, config: GmmSettings
) -> ClassMixtures:
    """Return what `fit_class_mixtures` would, for a library that differs in one class from the one of `classes`.

    Raises:
        LibraryFormatError: as `fit_class_mixtures`, and if the library has other classes than `classes`.
    """
    check_trainable(library)
    if library.labels != classes.labels:
        raise LibraryFormatError(
            f"library {library.name}: wanted the classes {classes.labels} that were learned before, "
            f"got {library.labels}; fit anew"
        )
    kept = zip(classes.labels, classes.mixtures, strict=True)
    return _class_mixtures(library, [_fit_class(library, m, config) if m == label else old for m, old in kept])


def _fit_class(library: MotionLibrary, label: int, config: GmmSettings) -> GaussianMixture:
    samples = np.vstack([training_samples(motion, config) for motion in library.of_class(label)])
    rng = np.random.default_rng([config.seed, label % 2**64])  # a seed sequence takes no negative labels
    try:
        return fit_mixture(samples, config.mixture, rng)
    except LibraryFormatError as trouble:
        raise LibraryFormatError(f"library {library.name}, class {label}: {trouble}") from trouble


def _class_mixtures(library: MotionLibrary, mixtures: list[GaussianMixture]) -> ClassMixtures:
    return ClassMixtures(
        library.labels,
        tuple(mixtures),
        tuple(len(library.of_class(label)) for label in library.labels),
        library.dof_names,
        float(np.median([motion.duration_s for motion in library])),
    )


def check_trainable(library: MotionLibrary) -> None:
    """Raise LibraryFormatError unless there are two classes or more, each of two motions or more, all different."""
    unlabelled = [motion.name for motion in library if motion.label is None]
    if unlabelled:
        raise LibraryFormatError(
            f"library {library.name}: wanted a class for every motion to learn from, {unlabelled[0]} and "
            f"{len(unlabelled) - 1} more have none; label them or leave them out"
        )
    if len(library.labels) < 2:
        raise LibraryFormatError(
            f"library {library.name}: wanted at least two classes to tell apart, got only class {library.labels[0]}"
        )
    for label in library.labels:
        motions = library.of_class(label)
        if len(motions) < 2:
            raise LibraryFormatError(
                f"library {library.name}: wanted at least two motions per class, class {label} has only "
                f"{motions[0].name}; record more or leave the class out"
            )
        if not any(_moves(motion) for motion in motions):
            raise LibraryFormatError(
                f"library {library.name}: wanted motions that move, in class {label} no degree of freedom ever changes"
            )
    seen: dict[bytes, Motion] = {}
    for motion in library:
        # A recording counted twice weighs twice, and leaving one of the two out would test on the other.
        twin = seen.setdefault(motion.q.tobytes(), motion)
        if twin is not motion:
            raise LibraryFormatError(
                f"library {library.name}: wanted every motion once, {twin.name} and {motion.name} have the same "
                "postures; leave one of them out"
            )


def _moves(motion: Motion) -> bool:
    return bool(np.ptp(motion.q, axis=0).any())
