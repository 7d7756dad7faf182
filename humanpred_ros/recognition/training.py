"""The offline stage: from a library to all that the online stage needs, as one immutable object (P1 III and IV)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np

from humanpred_ros import __version__, plugins
from humanpred_ros.errors import HumanModelError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, classifier_type
from humanpred_ros.settings import Settings

#: Link of the human that reaches; every human model of this package has it.
REACHING_LINK = "right_palm"
#: Classifiers that the built-in predictors need.
BUILT_IN = ("forest", "gmm")


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """What was learned from a library, and from which: immutable.

    Attributes:
        library: the motions learned from, without their skeleton points.
        human: whose motions they are.
        classifiers: classifiers that were fitted to the library, by name; `classifier` gives one to use. None at all
            serve predictors that need only the library.
        package_version: version of this package that trained it.
    """

    library: MotionLibrary
    human: HumanModel
    classifiers: Mapping[str, Classifier]
    package_version: str = __version__

    def __post_init__(self) -> None:
        object.__setattr__(self, "classifiers", MappingProxyType(dict(self.classifiers)))

    def classifier(self, name: str, **online: object) -> Classifier:
        """Return a classifier by name, ready for use, nothing observed yet.

        Args:
            name: of a classifier that was trained.
            online: settings that differ from those trained with (`Classifier.online_settings`).

        Raises:
            UsageError: unknown name, a classifier that was not trained, or a setting that a trained one cannot change.
            SettingsError: an impossible value.
        """
        plugins.check_name(plugins.CLASSIFIERS, name)
        trained = self.classifiers.get(name)
        if trained is None:
            raise UsageError(
                f"trained model: wanted one with the classifier {name}, got one with "
                f"{', '.join(self.classifiers) or 'none'}; train it: `humanpred train --classifier {name}`"
            )
        before = {key: getattr(trained.settings, key) for key in type(trained.settings).model_fields}
        settings = plugins.settings_of(name, type(trained.settings), {name: {**before, **online}})
        free_to_change = set(trained.online_settings)
        fixed = sorted(key for key in set(online) - free_to_change if getattr(settings, key) != before[key])
        if fixed:
            free = ", ".join(trained.online_settings) or "none"
            raise UsageError(
                f"classifier {name}: a trained one cannot change {', '.join(fixed)}; settings that it can change: "
                f"{free}; train a new model for anything else"
            )
        return trained.fresh(settings)

    @cached_property
    def places(self) -> Mapping[int, FloatArray]:
        """Where each class reaches to, (3,) by label, library's frame: the median of its motions' `farthest_palm_m`."""
        return {
            label: np.median([farthest_palm_m(self.human, motion.q) for motion in self.library.of_class(label)], axis=0)
            for label in self.library.labels
        }


def train_model(
    library: MotionLibrary, human: HumanModel, classifiers: Mapping[str, Settings | None] | None = None
) -> TrainedModel:
    """Fit classifiers to a library; the same library and settings give the same model.

    Args:
        library: to learn from.
        human: whose motions they are.
        classifiers: names with their settings, the default ones if None; all of `BUILT_IN` if None.

    Raises:
        UsageError: unknown name, or settings of another classifier.
        LibraryFormatError: a library that does not suffice.
        HumanModelError: a library of other DoFs than the human's.
    """
    human.check_dofs(library.dof_names)
    chosen = dict.fromkeys(BUILT_IN) if classifiers is None else classifiers
    types = {name: classifier_type(name) for name in chosen}
    fitted = {name: found(human, chosen[name]).fit(library) for name, found in types.items()}
    kept = tuple(motion.with_postures(motion.q) for motion in library)
    return TrainedModel(MotionLibrary(library.name, kept, library.provenance), human, fitted)


def classifier_settings(name: str, seed: int, given: plugins.Given | None = None) -> Settings:
    """Return settings of a classifier: those that were given (`plugins.given_settings`), else a seed and the defaults.

    Raises:
        UsageError: unknown name.
        SettingsError: a setting that it does not have, or a value that cannot be used.
    """
    return plugins.settings_of(name, classifier_type(name).settings_type, given or {}, seed=seed)


def farthest_palm_m(human: HumanModel, q: FloatArray) -> FloatArray:
    """Return the (3,) position of the reaching palm that is farthest from its first, for postures (T, D).

    For a reach that is its end, for reach and return the turning point.

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
