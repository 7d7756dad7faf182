"""P1's prediction: the human will be where the likely classes of motions sweep (P1 IV).

A class sweeps the voxels that the body touches in each posture of its expected motion (docs/papers.md, P1 occupancy).
All bodies count: legs and the resting arm are in the way like the reaching one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.voxeliser import DEFAULT_SPACING_M, BodyVoxeliser
from humanpred_ros.recognition.classifier import Classifier
from humanpred_ros.recognition.forest import evenly_spaced
from humanpred_ros.recognition.gmm_classifier import GmmClassifier
from humanpred_ros.settings import Settings, setting


class SweptVolumeSettings(Settings):
    """Settings of the predictor `swept_volume`: how finely bodies and motions are sampled."""

    spacing_m: float = setting(
        DEFAULT_SPACING_M, "distance between points on the surface (P1: 0.02)", unit="m", low=1e-4, high=10.0
    )
    n_postures: int = setting(
        100,
        "postures a motion is thinned to; 100 is P1's normal case, 10, used when P1 was submitted, loses 6 to 10 % of "
        "the voxels",
        low=1,
        high=100_000,
    )


def swept_volume(voxeliser: BodyVoxeliser, q: ArrayLike, n_postures: int = 100) -> NDArray[np.bool_]:
    """Return the boolean grid of voxels the body touches during a motion (P1 IV).

    Args:
        voxeliser: human, grid and placement.
        q: (T, D) postures in order.
        n_postures: how many of them count, evenly spaced from the first to the last.

    Raises:
        HumanModelError: wrong shape or values that are not finite.
    """
    postures = np.atleast_2d(np.asarray(q, dtype=np.float64))
    return voxeliser.mask(postures[evenly_spaced(len(postures), n_postures)])


class SweptVolumePredictor(Predictor):
    """P1: posterior of the classes times the volumes they sweep.

    p(x | xi) = sum_m P(C_m | xi) [x in the volume swept by class m] (P1 IV).

    Attributes:
        grid: the lattice, world frame.
        labels: C class labels.
        swept_voxels: number of voxels each class sweeps, by label.
    """

    settings_type = SweptVolumeSettings
    needs_model = True
    classifiers = None
    also_trained = ("gmm",)

    def __init__(self, classifier: Classifier, swept: Mapping[str, NDArray[np.bool_]], grid: VoxelGrid) -> None:
        """Join a fitted classifier and the volume each of its classes sweeps.

        Args:
            classifier: its labels must be those of `swept`.
            swept: boolean grid of each class.
            grid: the lattice of these grids.

        Raises:
            ArrayError: no classes, a grid of another shape, or a class that sweeps nothing.
        """
        if not swept or any(mask.shape != grid.shape for mask in swept.values()):
            raise ArrayError(
                f"swept volumes: wanted at least one class, each a grid of shape {grid.shape}, "
                f"got {[mask.shape for mask in swept.values()]}"
            )
        empty = [label for label, mask in swept.items() if not mask.any()]
        if empty:  # an occupancy that is always empty would tell the robot that there is nobody
            raise ArrayError(
                f"swept volumes: wanted every class to sweep some voxel, classes {empty} sweep none; "
                "check that T_world_human places the human within the grid"
            )
        self.grid = grid
        self.labels = tuple(swept)
        self.swept_voxels = {label: int(mask.sum()) for label, mask in swept.items()}
        self._classifier = classifier
        # Only voxels that some class sweeps can ever be occupied: a few thousand of some hundred thousand.
        stacked = np.stack([mask.ravel() for mask in swept.values()])
        self._union = np.flatnonzero(stacked.any(axis=0))
        self._sweeps = stacked[:, self._union].astype(np.float32)

    @classmethod
    def from_request(cls, request: PredictorRequest) -> SweptVolumePredictor:
        """Sweep the expected motions of the model's classifier gmm; raises as `Predictor.from_request`.

        Raises:
            UsageError: a model without that classifier.
            ArrayError: a placement that is not rigid, or that puts the human outside the grid.
        """
        gmm = request.trained_model().classifier("gmm")
        if not isinstance(gmm, GmmClassifier) or gmm.classes is None:
            raise UsageError(
                f"predictor swept_volume: wanted the classifier gmm in the model, got {type(gmm).__name__}"
            )
        settings = request.settings if isinstance(request.settings, SweptVolumeSettings) else SweptVolumeSettings()
        voxeliser = BodyVoxeliser(request.human, request.grid, request.T_world_human, settings.spacing_m)
        swept = {
            label: swept_volume(voxeliser, q, settings.n_postures)
            for label, q in zip(gmm.classes.labels, gmm.expected_q, strict=True)
        }
        return cls(request.on_stream(request.make_classifier()), swept, request.grid)

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        self._classifier.start()

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s`; raises what the classifier raises, and then changes nothing."""
        posterior = self._classifier.update(q, t_s)
        if posterior.labels != self.labels:
            raise UsageError(
                f"predictor: wanted a classifier of the classes {self.labels}, it answers {posterior.labels}"
            )
        probability = np.zeros(self.grid.size, dtype=np.float32)
        # einsum, not a threaded product: the sum's order must not depend on the number of cores.
        # Of a reach of no class nothing is known but that it sweeps some space: that must not make the space look free.
        share = np.einsum("m,mv->v", posterior.given_known.astype(np.float32), self._sweeps)
        probability[self._union] = np.minimum(share, np.float32(1.0))  # rounding may exceed a certainty
        return Prediction(Occupancy(self.grid, probability.reshape(self.grid.shape), t_s), posterior)
