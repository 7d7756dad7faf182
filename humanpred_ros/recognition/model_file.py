"""The offline stage hands the online stage one file: written whole or not at all, refused unless it fits.

Format: a NumPy .npz archive without pickled objects, stored uncompressed (every member has a CRC). `metadata` is
JSON in UTF-8 bytes. `library/t_s`, `library/q` and `library/first` hold the motions, one after the other; all other
members are arrays of a classifier, `NAME/ARRAY`, as its `state` gave them. The same model gives the same bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import sys
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanPredError, ModelFileError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, classifier_type
from humanpred_ros.recognition.training import TrainedModel, train_model
from humanpred_ros.resources import cache_root
from humanpred_ros.settings import Settings

__all__ = ["FORMAT_VERSION", "TrainedModel", "load_model", "model_of", "save_model", "train_model"]

FORMAT = "humanpred_ros trained model"
#: Raised whenever a reader of the old version would misread the new.
FORMAT_VERSION = 3
#: No number of a model is larger: metres, radians, seconds, counts and log densities are far below.
_LARGEST = 1e12
#: Models kept in the user's cache folder; the one not used for longest goes first.
_KEPT_MODELS = 20

#: Whatever zipfile and NumPy raise on bytes that are not an archive they wrote.
_UNREADABLE = (
    OSError, EOFError, KeyError, TypeError, ValueError, RuntimeError, NotImplementedError, OverflowError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def save_model(model: TrainedModel, path: str | Path) -> None:
    """Write a model file; a reader sees the old file or the new one, never a part.

    Raises:
        ModelFileError: the file cannot be written, or a classifier gives something that it cannot hold.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # same folder: a rename is atomic only within a disk
    arrays = _arrays(model)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with part.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as trouble:
        raise ModelFileError(f"model file {path}: could not be written ({trouble}); choose another place") from trouble


def load_model(path: str | Path, human: HumanModel) -> TrainedModel:
    """Read a model file for a human.

    Raises:
        ModelFileError: missing, unreadable, damaged, of another format version, or made for another human.
    """
    path = Path(path)
    arrays = _read(path)
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


def _read(path: Path) -> dict[str, NDArray[Any]]:
    """Return all members. No more is allocated than the file is large: headers are not believed."""
    try:
        data = path.read_bytes()
    except OSError as trouble:
        raise ModelFileError(
            f"model file {path}: could not be read ({trouble}); make one with `humanpred train`"
        ) from trouble
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            stored = [info for info in archive.infolist() if info.compress_type == zipfile.ZIP_STORED]
            if len(stored) != len(archive.infolist()) or sum(info.file_size for info in stored) > len(data):
                raise ValueError("wanted members stored uncompressed, no larger than the file")
            return {info.filename.removesuffix(".npy"): _array(info.filename, archive.read(info)) for info in stored}
    except _UNREADABLE as trouble:
        raise ModelFileError(
            f"model file {path}: not a model file, or damaged ({trouble}); make one with `humanpred train`"
        ) from trouble


def _array(name: str, data: bytes) -> NDArray[Any]:
    """Return the array in the bytes of a .npy file. Raises ValueError, with the name, for one that cannot be."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran_order, dtype = read_header(stream)
    if dtype.kind not in "biufU":
        raise ValueError(f"{name}: wanted numbers, truth values or texts, got {dtype}")
    n_bytes = dtype.itemsize
    for length in shape:
        n_bytes *= int(length)
    if n_bytes != len(data) - stream.tell() or min(shape, default=0) < 0:
        raise ValueError(f"{name}: it declares {shape} of {dtype}, which is not what it holds")
    array = np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape, order="F" if fortran_order else "C")
    if dtype.kind in "iuf" and array.size and not np.abs(array.astype(np.float64)).max() <= _LARGEST:
        raise ValueError(f"{name}: wanted finite numbers up to {_LARGEST:g}, got {array[np.argmax(np.abs(array))]}")
    return array


def _metadata(path: Path, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    try:
        metadata = json.loads(arrays.pop("metadata").tobytes().decode())
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
        Motion(t_s[a:b], q[a:b], dof_names, None if label is None else int(label), int(index), frame_id)
        for a, b, label, index in zip(first[:-1], first[1:], facts["labels"], facts["indices"], strict=True)
    ]
    provenance = {str(key): str(value) for key, value in facts["provenance"].items()}
    return MotionLibrary(str(facts["name"]), tuple(motions), provenance)


def _classifier(name: str, settings: dict[str, Any], arrays: dict[str, NDArray[Any]], human: HumanModel) -> Classifier:
    found = classifier_type(name)
    state = {key.removeprefix(f"{name}/"): array for key, array in arrays.items() if key.startswith(f"{name}/")}
    return found.from_state(human, found.settings_type(**settings), state)
