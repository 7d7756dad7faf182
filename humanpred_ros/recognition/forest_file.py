"""The reach forest as arrays with names, for the model file; what can be computed again is not stored."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.recognition.calibration import Calibration
from humanpred_ros.recognition.forest import Tree
from humanpred_ros.recognition.forest_config import ForestSettings
from humanpred_ros.recognition.forest_model import Exemplars, ForestModel, joined
from humanpred_ros.recognition.novelty import COLUMNS, Novelty
from humanpred_ros.recognition.reach_features import N_FEATURES
from humanpred_ros.recognition.standing_place import StandingPlace

_EXEMPLARS = ("label", "first", "q", "features", "start_pose")
_TREE = ("feature", "threshold", "left", "right")


def forest_arrays(model: ForestModel) -> dict[str, NDArray[Any]]:
    """Return the arrays of a model by the names they have in a file."""
    return {
        "forest_n_nodes": np.array([len(tree.feature) for tree in model.trees]),
        **{f"forest_{name}": np.concatenate([getattr(tree, name) for tree in model.trees]) for name in _TREE},
        **{f"forest_exemplar_{name}": getattr(model.exemplars, name) for name in _EXEMPLARS},
        "forest_calibration": model.calibration.parameters,
        "forest_novelty": model.novelty.weights,
        "forest_place_pose": model.place.pose,
        "forest_place_spread": model.place.spread,
    }


def forest_metadata(model: ForestModel) -> dict[str, Any]:
    """Return the rest of a model, for JSON."""
    return {"config": model.config.model_dump(), "labels": model.labels, "motions": model.exemplars.names}


def read_forest(metadata: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> ForestModel:
    """Return the model of `forest_metadata` and `forest_arrays`.

    Raises:
        ArrayError, KeyError, TypeError, ValueError: parts that do not fit each other.
    """
    config, labels = ForestSettings(**metadata["config"]), tuple(int(label) for label in metadata["labels"])
    exemplars = Exemplars(
        tuple(str(name) for name in metadata["motions"]), *(arrays[f"forest_exemplar_{name}"] for name in _EXEMPLARS)
    )
    ends = np.cumsum(arrays["forest_n_nodes"])[:-1]
    parts = [np.split(arrays[f"forest_{name}"], ends) for name in _TREE]
    trees = tuple(Tree(*tree) for tree in zip(*parts, strict=True))
    for tree in trees:
        _check_nodes(tree)
    points = np.ascontiguousarray(exemplars.features[:, COLUMNS])
    return ForestModel(
        config,
        labels,
        exemplars,
        trees,
        joined(labels, exemplars, trees, config),
        Calibration(arrays["forest_calibration"]),
        Novelty(points, exemplars.first, arrays["forest_novelty"]),
        StandingPlace(arrays["forest_place_pose"], arrays["forest_place_spread"]),
    )


def _check_nodes(tree: Tree) -> None:
    """A compiled loop follows these numbers unchecked, for ever if one leads back; below a node they must increase."""
    n = len(tree.feature)
    inner, number = tree.feature >= 0, np.arange(n)
    sizes = {len(part) for part in (tree.feature, tree.threshold, tree.left, tree.right)}
    if sizes != {n} or n == 0 or (tree.feature >= N_FEATURES).any():
        raise ArrayError("reach forest: wanted trees whose arrays agree on the number of nodes and features")
    for below in (tree.left, tree.right):
        if (below[inner] <= number[inner]).any() or (below[inner] >= n).any():
            raise ArrayError("reach forest: wanted trees whose nodes lead to later nodes of the same tree")
