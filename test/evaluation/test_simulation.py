"""Runs that share occupancies are told what a run of its own would have been told."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.evaluation.simulation import PredictedOccupancies, nobody, predicted
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest

GRID = VoxelGrid((0.0, 0.0, 0.0), 0.1, (4, 5, 6))
MOTION = small_library(1, 1, 8).motions[0]


class Noise(Predictor):
    """Predicts what its own past says: a reader out of turn would change it."""

    grid = GRID

    @classmethod
    def from_request(cls, request: PredictorRequest) -> Noise:
        return cls()

    def start(self) -> None:
        self._rng = np.random.default_rng(0)
        self.seen: list[float] = []

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        self.seen.append(t_s)
        p = self._rng.random(GRID.shape, dtype=np.float32)
        return Prediction(Occupancy(GRID, np.where(p > 0.7, p, np.float32(0.0005)), t_s), None)


def test_every_reader_reads_what_the_predictor_said() -> None:
    wanted = list(predicted(Noise(), MOTION, 0.001, 3))
    shared = PredictedOccupancies(Noise(), MOTION, 0.001, 3)
    one, other = shared.since(0), shared.since(4)
    read = [next(one), next(one), next(other), *one]
    assert len(wanted) == len(MOTION) + 3
    for k, which in enumerate([0, 1, 4, *range(2, len(wanted))]):
        assert np.array_equal(read[k].probability, wanted[which].probability)
        assert read[k].t_s == wanted[which].t_s
    assert read[0].probability[read[0].probability > 0.0].min() > 0.001


def test_nothing_is_predicted_before_somebody_reads_it() -> None:
    predictor = Noise()
    shared = PredictedOccupancies(predictor, MOTION, 0.001, 1000)
    shared.after(2)
    list(itertools.islice(shared.since(0), 5))
    assert len(predictor.seen) == 5
    assert np.array_equal(shared.after(2).probability, next(shared.since(2)).probability)


def test_there_is_an_end() -> None:
    shared = PredictedOccupancies(Noise(), MOTION, 0.001, 0)
    with pytest.raises(IndexError, match="8 postures"):
        shared.after(8)


def test_nobody_comes_with_the_same_stamps() -> None:
    empty = list(nobody(GRID, MOTION, 3))
    assert [o.t_s for o in empty] == [o.t_s for o in predicted(Noise(), MOTION, 0.001, 3)]
    assert not any(o.probability.any() for o in empty)
