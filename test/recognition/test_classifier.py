"""The posterior that every classifier returns."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import ArrayError
from humanpred_ros.recognition.classifier import ClassPosterior


def posterior(probability: list[float]) -> ClassPosterior:
    return ClassPosterior(("4", "7", "9"), np.array(probability), np.log(probability), 1.5, 3)


def test_best_and_each_class_by_label() -> None:
    result = posterior([0.2, 0.7, 0.1])
    assert result.best == "7"
    assert [result.of(label) for label in ("9", "7", "4")] == [0.1, 0.7, 0.2]


@pytest.mark.parametrize("probability", [[0.5, 0.6, 0.1], [1.2, -0.2, 0.0], [0.5, 0.5], [np.nan, 0.5, 0.5]])
def test_what_is_no_distribution_is_refused(probability: list[float]) -> None:
    with pytest.raises(ArrayError):
        ClassPosterior(("4", "7", "9"), np.array(probability), np.zeros(3), 0.0, 1)


def test_the_probability_of_no_class_is_part_of_the_whole() -> None:
    result = ClassPosterior(("4", "7", "9"), np.array([0.1, 0.3, 0.1]), np.zeros(3), 0.0, 1, unknown=0.5)
    np.testing.assert_allclose(result.given_known, [0.2, 0.6, 0.2])
    with pytest.raises(ArrayError, match="sum"):
        ClassPosterior(("4", "7", "9"), np.array([0.2, 0.7, 0.1]), np.zeros(3), 0.0, 1, unknown=0.5)
    with pytest.raises(ArrayError, match="no class"):
        ClassPosterior(("4", "7", "9"), np.zeros(3), np.zeros(3), 0.0, 1, unknown=1.0)
