"""The functions of the public face: the short ways through the package that a program needs.

Everything here is found in `humanpred_ros` itself (`import humanpred_ros as hp`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion import library_io
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.predictor import Predictor, PredictorRequest
from humanpred_ros.occupancy.predictor import make_predictor as _make_predictor
from humanpred_ros.recognition import training
from humanpred_ros.recognition.training import TrainedModel
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import Scene


def load_library(name_or_path: str | Path) -> MotionLibrary:
    """Return a motion library: a bag, a folder of CSV files, or the name of one that is shipped.

    Raises:
        UsageError: there is none such; the message has the names of those shipped.
        LibraryFormatError, BagError: it cannot be read.
    """
    return library_io.load_library(locate(str(name_or_path), "bags"))


def write_library(library: MotionLibrary, path: str | Path) -> Path:
    """Write a motion library as an MCAP bag, a folder that must not exist yet; return the folder."""
    return write_library_bag(library, path)


def human_of(library: MotionLibrary) -> HumanModel:
    """Return the human model that a library's degrees of freedom belong to. Raises HumanModelError if none has them."""
    return human_with(library.dof_names)


def train(library: MotionLibrary, classifiers: Sequence[str] | None = None) -> TrainedModel:
    """Return what is learned from a library: one fitted classifier for each name, with its default settings.

    Args:
        library: labelled motions of one human model.
        classifiers: names; all built-in ones if None.

    Raises:
        LibraryFormatError: a library that does not suffice.
        UsageError: an unknown name.
    """
    chosen = None if classifiers is None else dict.fromkeys(classifiers)
    return training.train_model(library, human_of(library), chosen)


def save_model(model: TrainedModel, path: str | Path) -> None:
    """Write a trained model to a file (.npz); a file of that name is replaced when the new one is complete."""
    training.save_model(model, path)


def load_model(path: str | Path, human: HumanModel | None = None) -> TrainedModel:
    """Return the model in a file.

    Args:
        path: of the file.
        human: that it must be for; P1's human with 12 degrees of freedom if None.

    Raises:
        ModelFileError: a file that is no model, is damaged, or was made for another human.
    """
    return training.load_model(path, human or HumanModel.kinect12())


def make_predictor(name: str, scene: Scene, model: TrainedModel | None = None, **options: Any) -> Predictor:
    """Return a predictor by name for the lattice of a scene and the place where its tracker stands.

    Args:
        name: `forecast`, `swept_volume`, `reaching`, a baseline, or one that another package offers.
        scene: where the person is.
        model: what was learned; the baselines need none.
        options: fields of `PredictorRequest`, for instance `classifier="gmm"`, `onsets=True` or `places={...}`.

    Raises:
        UsageError: an unknown name, or something that the predictor needs is missing.
    """
    human = model.human if model is not None else options.pop("human", None) or HumanModel.kinect12()
    request = PredictorRequest(human, scene.grid, scene.T_world_human, model, **options)
    return _make_predictor(name, request)
