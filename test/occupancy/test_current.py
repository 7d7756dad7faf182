"""The baseline: the body where it is, or everywhere it was."""

from __future__ import annotations

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.current import AccumulatedOccupancyPredictor, CurrentOccupancyPredictor
from humanpred_ros.occupancy.swept_volume_predictor import BodyVoxeliser, swept_volume

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
T = np.array([[0.0, -1.0, 0.0, 0.2], [1.0, 0.0, 0.0, 0.1], [0.0, 0.0, 1.0, 0.05], [0.0, 0.0, 0.0, 1.0]])
MOTION = small_library(1, 1, 12).motions[0]


def test_one_exactly_where_the_body_is_and_no_memory() -> None:
    predictor = CurrentOccupancyPredictor(HUMAN, GRID, T)
    for q, t_s in zip(MOTION.q, MOTION.t_s, strict=True):
        prediction = predictor.update(q, t_s)
        body = GRID.mask_of(HUMAN.surface_points(q) @ T[:3, :3].T + T[:3, 3])
        assert (prediction.occupancy.probability != body).sum() <= 2
        assert prediction.occupancy.t_s == t_s
        assert prediction.posterior is None


def test_accumulating_ends_with_the_swept_volume_and_start_clears_it() -> None:
    predictor = AccumulatedOccupancyPredictor(HUMAN, GRID, T)
    before = np.zeros(GRID.shape, dtype=np.float32)
    kept = []
    for q, t_s in zip(MOTION.q, MOTION.t_s, strict=True):
        now = predictor.update(q, t_s).occupancy.probability
        kept.append((now, now.copy()))
        assert (now >= before).all()
        before = now
    np.testing.assert_array_equal(before, swept_volume(BodyVoxeliser(HUMAN, GRID, T), MOTION.q))
    for occupancy, copy in kept:
        np.testing.assert_array_equal(occupancy, copy)
    predictor.start()
    alone = CurrentOccupancyPredictor(HUMAN, GRID, T).update(MOTION.q[0], 0.0)
    np.testing.assert_array_equal(predictor.update(MOTION.q[0], 0.0).occupancy.probability, alone.occupancy.probability)


@pytest.mark.parametrize("q", [np.full(12, np.nan), np.zeros((1, 12)), np.zeros(5)])
def test_a_posture_that_cannot_be_used_is_refused(q: np.ndarray) -> None:
    with pytest.raises(ArrayError):
        CurrentOccupancyPredictor(HUMAN, GRID, T).update(q, 0.0)
