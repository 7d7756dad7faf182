"""The offline stage: from a library to all that the online stage needs, as one immutable object (P1 III and IV)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

import humanpred_ros
from humanpred_ros import plugins
from humanpred_ros.errors import ArrayError, HumanModelError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.class_mixtures import ClassMixtures, fit_class_mixtures
from humanpred_ros.recognition.classifier import Classifier
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.forest_config import ForestSettings
from humanpred_ros.recognition.forest_model import ForestModel, fit_forest
from humanpred_ros.recognition.gmm_classifier import GmmClassifier
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.recognition.mixture import GaussianMixture
from humanpred_ros.recognition.regression import regress

#: Link of the human that reaches; every model of this package has it.
REACHING_LINK = "right_palm"


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """What was learned from a library, and from which: immutable.

    Attributes:
        config: settings of P1's classifier.
        classes: of P1's classifier: C labels and their mixtures, DoF names and nominal duration.
        regressed_q: (C, N, D) the expected motion of each class at N evenly spaced phases, library frame.
        goals_m: (C, 3) where each class reaches to: the palm in the regressed posture in which it is farthest
            from where it was in the first one. For reaches that is the end, for reach and return the turning
            point. Library frame.
        frame_id: frame of the library.
        human_signature: `HumanModel.signature` of the human it was trained for.
        library_name: name of the library.
        forest: the default classifier's model, with the library's postures.
        library_provenance: where the library came from.
        training_motions: names of the motions learned from.
        package_version: version of this package that trained it.

    Raises:
        ArrayError: arrays that do not fit each other, or are not finite.
    """

    config: GmmSettings
    classes: ClassMixtures
    regressed_q: FloatArray
    goals_m: FloatArray
    frame_id: str
    human_signature: str
    library_name: str
    forest: ForestModel
    library_provenance: Mapping[str, str] = field(default_factory=dict)
    training_motions: tuple[str, ...] = ()
    package_version: str = humanpred_ros.__version__

    def __post_init__(self) -> None:
        n_classes, n_dofs = len(self.labels), len(self.dof_names)
        if self.classes.has_phase != self.config.phase_feature:
            raise ArrayError("trained model: settings and mixtures disagree on whether the phase is a feature")
        if self.forest.labels != self.labels:
            raise ArrayError(f"trained model: wanted a forest over classes {self.labels}, got {self.forest.labels}")
        if {mixture.n_components for mixture in self.classes.mixtures} != {self.config.n_components}:
            raise ArrayError(f"trained model: wanted {self.config.n_components} components in every mixture")
        regressed = checked("regressed motions", self.regressed_q, (n_classes, self.config.n_phase_frames, n_dofs))
        object.__setattr__(self, "regressed_q", frozen(regressed))
        object.__setattr__(self, "goals_m", frozen(checked("goals_m", self.goals_m, (n_classes, 3))))
        object.__setattr__(self, "library_provenance", MappingProxyType(dict(self.library_provenance)))
        object.__setattr__(self, "training_motions", tuple(self.training_motions))

    @property
    def labels(self) -> tuple[int, ...]:
        """C class labels; arrays per class are in this order."""
        return self.classes.labels

    @property
    def dof_names(self) -> tuple[str, ...]:
        """D names of the postures' columns."""
        return self.classes.dof_names

    @property
    def nominal_duration_s(self) -> float:
        """Expected duration of a motion: the setting if given, else the library's median."""
        return self.config.nominal_duration_s or self.classes.nominal_duration_s

    def regressed_motion(self, label: int) -> Motion:
        """Return the expected motion of one class, over the nominal duration.

        Raises:
            UsageError: no such class.
        """
        if label not in self.labels:
            raise UsageError(f"trained model: wanted one of the classes {self.labels}, got {label}")
        q = self.regressed_q[self.labels.index(label)]
        t_s = np.linspace(0.0, self.nominal_duration_s, len(q))
        return Motion(t_s, q, self.dof_names, label, 0, self.frame_id)

    def classifier(self, name: str, human: HumanModel, **online: object) -> Classifier:
        """Return a classifier by name, ready for use, nothing observed yet.

        Args:
            name: of a classifier that was trained.
            human: whose postures come.
            online: settings that differ from those trained with (`Classifier.online_settings`).

        Raises:
            UsageError: unknown name, a classifier that was not trained, or a setting that a trained one cannot change.
        """
        plugins.check_name(plugins.CLASSIFIERS, name)
        if name == "gmm":
            return self.gmm_classifier(human, **online)
        if name != "forest":
            raise UsageError(f"trained model: wanted one with the classifier {name}, got one with forest and gmm")
        if online:
            raise UsageError(
                f"classifier {name}: wanted no settings, got {', '.join(online)}; a trained one cannot change them"
            )
        return self.forest_classifier(human)

    def gmm_classifier(self, human: HumanModel, **online: object) -> GmmClassifier:
        """Return P1's classifier ready for use, nothing observed yet; `online` changes settings (see `GmmSettings`)."""
        return GmmClassifier(human, self.config.with_online(**online), self.classes)

    def forest_classifier(self, human: HumanModel) -> ForestClassifier:
        """Return the default classifier ready for use, nothing observed yet."""
        return ForestClassifier(human, model=self.forest)


def train_model(
    library: MotionLibrary,
    human: HumanModel,
    config: GmmSettings | None = None,
    forest_config: ForestSettings | None = None,
) -> TrainedModel:
    """Learn both classifiers, expected motions and goals from a library.

    Same library, settings and seed give the same model.

    Raises:
        LibraryFormatError: a library that does not suffice (see `fit_class_mixtures`).
        HumanModelError: a library of other DoFs than the human's.
    """
    config = GmmSettings() if config is None else config
    human.check_dofs(library.dof_names)
    classes = fit_class_mixtures(library, config)
    phase = np.arange(config.n_phase_frames, dtype=np.float64)
    regressed_q = np.stack([regress(mixture, phase).mean for mixture in _joint_mixtures(library, config, classes)])
    return TrainedModel(
        config,
        classes,
        regressed_q,
        np.stack([farthest_palm_m(human, q) for q in regressed_q]),
        library.frame_id,
        human.signature,
        library.name,
        fit_forest(library, human, ForestSettings() if forest_config is None else forest_config),
        library.provenance,
        tuple(motion.name for motion in library),
    )


def farthest_palm_m(human: HumanModel, q: FloatArray) -> FloatArray:
    """Return the (3,) position of the reaching palm that is farthest from its first, for postures (T, D).

    Raises:
        HumanModelError: the human has no such link.
    """
    links = human.forward(q)
    if REACHING_LINK not in links:
        raise HumanModelError(
            f"human model {human.name}: wanted a link named {REACHING_LINK}, got {', '.join(links)}; name the palm so"
        )
    palm = links[REACHING_LINK]
    farthest: FloatArray = palm[np.argmax(np.linalg.norm(palm - palm[0], axis=1))]
    return farthest


def _joint_mixtures(library: MotionLibrary, config: GmmSettings, classes: ClassMixtures) -> tuple[GaussianMixture, ...]:
    """Return mixtures over phase and posture; a classifier without the phase needs them beside its own."""
    if classes.has_phase:
        return classes.mixtures
    return fit_class_mixtures(library, config.with_phase()).mixtures
