"""The offline stage: from a library to all that the online stage needs, and the file that hands it on (P1 III and IV).

A model file is written whole or not at all, and refused unless it fits. It is a NumPy .npz archive without pickled
objects, stored uncompressed (every member has a CRC). `metadata` is JSON in UTF-8 bytes. `library/t_s`, `library/q` and
`library/first` hold the motions, one after the other; all other members are arrays of a classifier, `NAME/ARRAY`, as
its `state` gave them. The same model gives the same bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros import __version__, plugins
from humanpred_ros.errors import HumanModelError, HumanPredError, ModelFileError, UsageError
from humanpred_ros.files import json_of, read_arrays
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, classifier_type
from humanpred_ros.resources import cache_root, replacing
from humanpred_ros.settings import Settings

#: Link of the human that reaches; every human model of this package has it.
REACHING_LINK = "right_palm"
#: Classifiers that the built-in predictors need.
BUILT_IN = ("forest", "gmm")
FORMAT = "humanpred_ros trained model"
#: Raised whenever a reader of the old version would misread the new.
FORMAT_VERSION = 3
#: Models kept in the user's cache folder; the one not used for longest goes first.
_KEPT_MODELS = 20


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """What was learned from a library, and from which: immutable."""

    library: MotionLibrary  #: the motions learned from, without their skeleton points
    human: HumanModel  #: whose motions they are
    #: classifiers that were fitted to the library, by name; `classifier` gives one to use. None at all serve predictors
    #: that need only the library.
    classifiers: Mapping[str, Classifier]
    package_version: str = __version__  #: version of this package that trained it

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

    def learned_from(self, motion: Motion) -> str:
        """Return the name of the motion learned from that has these postures, at any place; empty if none has."""
        # A person who stands elsewhere moves in the same way: the pelvis is no difference.
        still = [d for d, name in enumerate(motion.dof_names) if not name.startswith("Pelvis")]
        same = (
            known.name
            for known in self.library
            if known.q.shape == motion.q.shape and np.allclose(known.q[:, still], motion.q[:, still], atol=1e-6)
        )
        return next(same, "")

    @cached_property
    def places(self) -> Mapping[str, FloatArray]:
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


def save_model(model: TrainedModel, path: str | Path) -> None:
    """Write a model file; a reader sees the old file or the new one, never a part.

    Raises:
        ModelFileError: the file cannot be written, or a classifier gives something that it cannot hold.
    """
    path = Path(path)
    arrays = _arrays(model)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as trouble:
        raise ModelFileError(f"{path.parent}: cannot be made ({trouble.strerror}); choose another place") from trouble
    with replacing(path, ModelFileError) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def load_model(path: str | Path, human: HumanModel) -> TrainedModel:
    """Read a model file for a human.

    Raises:
        ModelFileError: missing, unreadable, damaged, of another format version, or made for another human.
    """
    path = Path(path)
    try:
        arrays = read_arrays(path, ModelFileError)
    except ModelFileError as trouble:
        raise ModelFileError(f"model file {trouble}; make one with `humanpred train`") from trouble
    metadata = _metadata(path, arrays)
    if metadata.get("human_signature") != human.signature:
        raise ModelFileError(
            f"model file {path}: made for another human (signature {str(metadata.get('human_signature'))[:12]}), "
            f"wanted {human.name} ({human.signature[:12]}); use the human it was made for, or train the model again"
        )
    try:
        library = _library(metadata["library"], arrays)
        human.check_dofs(library.dof_names)
        classifiers = {
            name: _classifier(name, settings, arrays, human) for name, settings in metadata["classifiers"].items()
        }
        return TrainedModel(library, human, classifiers, str(metadata["package_version"]))
    except (HumanPredError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as trouble:
        raise ModelFileError(
            f"model file {path}: its parts do not fit ({type(trouble).__name__}: {trouble}); train the model again"
        ) from trouble


def model_of(
    library: MotionLibrary,
    human: HumanModel,
    classifiers: Mapping[str, Settings | None],
    *,
    folder: Path | None = None,
) -> Path:
    """Return the file of the model that `train_model` gives: the one found in the cache, or a new one put there.

    It is found by the library's content, the human, the settings, and the sources that training uses.

    Args:
        library, human, classifiers: as for `train_model`.
        folder: where models are kept; None takes `models` in the user's cache folder.

    Raises:
        HumanPredError: as `train_model` and `save_model`; also if the user has no cache folder and none is given.
    """
    root = cache_root() if folder is None else folder
    if root is None:
        raise ModelFileError("model cache: wanted a folder to keep models in, got none; set XDG_CACHE_HOME")
    path = (root / "models" if folder is None else folder) / f"{_content_key(library, human, classifiers)}.npz"
    with contextlib.suppress(ModelFileError):  # missing, or damaged: trained again
        load_model(path, human)
        os.utime(path)
        os.utime(path.parent)  # folders of the cache that are not used for long are removed
        return path
    save_model(train_model(library, human, classifiers), path)
    with contextlib.suppress(OSError):
        for old in sorted(path.parent.glob("*.npz"), key=lambda file: -file.stat().st_mtime)[_KEPT_MODELS:]:
            old.unlink(missing_ok=True)
    return path


def _content_key(library: MotionLibrary, human: HumanModel, classifiers: Mapping[str, Settings | None]) -> str:
    """Return a digest of all that a model depends on."""
    digest = hashlib.sha256(f"{FORMAT_VERSION} {human.signature} {library.frame_id} {library.name}".encode())
    for motion in library:
        digest.update(f"{motion.name} {motion.q.shape} ".encode())
        digest.update(motion.t_s.tobytes())
        digest.update(motion.q.tobytes())
    sources = set(Path(__file__).parent.glob("*.py"))
    for name, settings in sorted(classifiers.items()):
        found = classifier_type(name)
        digest.update(f"{name} {(settings or found.settings_type()).model_dump_json()}".encode())
        sources.add(Path(sys.modules[found.__module__].__file__ or __file__))
    for source in sorted(sources):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:32]


def _arrays(model: TrainedModel) -> dict[str, NDArray[Any]]:
    """Return the members of a model's file."""
    motions = model.library.motions
    metadata = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "package_version": model.package_version,
        "human_signature": model.human.signature,
        "library": {
            "name": model.library.name,
            "provenance": dict(model.library.provenance),
            "frame_id": model.library.frame_id,
            "dof_names": model.library.dof_names,
            "labels": [motion.label for motion in motions],
            "indices": [motion.index for motion in motions],
        },
        "classifiers": {name: found.settings.model_dump(mode="json") for name, found in model.classifiers.items()},
    }
    arrays = {
        "metadata": np.frombuffer(json.dumps(metadata, indent=1).encode(), dtype=np.uint8),
        "library/t_s": np.concatenate([motion.t_s for motion in motions]),
        "library/q": np.vstack([motion.q for motion in motions]),
        "library/first": np.concatenate([[0], np.cumsum([len(motion) for motion in motions])]),
    }
    for name, classifier in model.classifiers.items():
        for key, value in classifier.state().items():
            array = np.asarray(value)
            if array.dtype.kind not in "biufU":
                raise ModelFileError(
                    f"classifier {name}, {key}: wanted an array of numbers, truth values or texts, got {array.dtype}"
                )
            arrays[f"{name}/{key}"] = array
    return arrays


def _metadata(path: Path, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    try:
        metadata = json_of(arrays.pop("metadata").tobytes().decode())
        if not isinstance(metadata, dict):
            raise ValueError("metadata is no JSON object")
    except (KeyError, ValueError, RecursionError) as trouble:
        raise ModelFileError(
            f"model file {path}: not a model file, or damaged ({trouble}); make one with `humanpred train`"
        ) from trouble
    if metadata.get("format") != FORMAT:
        raise ModelFileError(
            f"model file {path}: wanted a {FORMAT}, got {metadata.get('format')!r}; make one with `humanpred train`"
        )
    if metadata.get("format_version") != FORMAT_VERSION:
        raise ModelFileError(
            f"model file {path}: wanted format version {FORMAT_VERSION}, got {metadata.get('format_version')} written "
            f"by version {metadata.get('package_version')} of this package; train the model again"
        )
    return metadata


def _library(facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> MotionLibrary:
    first, t_s, q = arrays["library/first"], arrays["library/t_s"], arrays["library/q"]
    dof_names, frame_id = tuple(str(name) for name in facts["dof_names"]), str(facts["frame_id"])
    motions = [
        Motion(t_s[a:b], q[a:b], dof_names, None if label is None else str(label), int(index), frame_id)
        for a, b, label, index in zip(first[:-1], first[1:], facts["labels"], facts["indices"], strict=True)
    ]
    provenance = {str(key): str(value) for key, value in facts["provenance"].items()}
    return MotionLibrary(str(facts["name"]), tuple(motions), provenance)


def _classifier(name: str, settings: dict[str, Any], arrays: dict[str, NDArray[Any]], human: HumanModel) -> Classifier:
    found = classifier_type(name)
    state = {key.removeprefix(f"{name}/"): array for key, array in arrays.items() if key.startswith(f"{name}/")}
    return found.from_state(human, found.settings_type(**settings), state)
