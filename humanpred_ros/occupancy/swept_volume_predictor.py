"""P1's prediction: where the human will be is where the likely classes of motions sweep (P1 IV)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.swept_volume import BodyVoxeliser, SweptVolumeConfig, swept_volume
from humanpred_ros.recognition.classifier import Classifier
from humanpred_ros.recognition.training import TrainedModel


class SweptVolumePredictor(Predictor):
    """P1: posterior of the classes times the volumes they sweep.

    p(x | xi) = sum_m P(C_m | xi) [x in the volume swept by class m] (P1 IV).

    Attributes:
        grid: the lattice, world frame.
        labels: C class labels.
        swept_voxels: number of voxels each class sweeps, by label.
    """

    needs_model = True
    classifiers = None
    also_trained = ("gmm",)

    def __init__(self, classifier: Classifier, swept: Mapping[int, NDArray[np.bool_]], grid: VoxelGrid) -> None:
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
    def from_model(
        cls,
        model: TrainedModel,
        human: HumanModel,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        *,
        classifier: Classifier | None = None,
        config: SweptVolumeConfig | None = None,
    ) -> SweptVolumePredictor:
        """Return the predictor of a trained model: sweeps its regressed motions once.

        Args:
            model: trained for `human`.
            human: whose body sweeps.
            grid: the lattice, world frame.
            T_world_human: (4, 4) from the model's frame to the world.
            classifier: used instead of the model's own; of the same classes.
            config: how finely to sample.

        Raises:
            UsageError: a model trained for another human.
            ArrayError: a placement that is not rigid, or that puts the human outside the grid.
        """
        if model.human_signature != human.signature:
            raise UsageError(
                f"predictor: the model was trained for another human than {human.name}; train one for this human"
            )
        config = SweptVolumeConfig() if config is None else config
        voxeliser = BodyVoxeliser(human, grid, T_world_human, config.spacing_m)
        swept = {
            label: swept_volume(voxeliser, q, config) for label, q in zip(model.labels, model.regressed_q, strict=True)
        }
        return cls(model.gmm_classifier(human) if classifier is None else classifier, swept, grid)

    @classmethod
    def from_request(cls, request: PredictorRequest) -> SweptVolumePredictor:
        classifier = request.on_stream(request.make_classifier())
        model = request.trained_model()
        return cls.from_model(model, request.human, request.grid, request.T_world_human, classifier=classifier)

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
