"""Several people predicted for at once: each with a predictor of their own, their occupancies joined.

people = PeoplePredictor(predictor)
people.update({"body_0": (q0, t_s), "body_1": (q1, t_s)})
occupancy = people.occupancy(("body_0", "body_1"), t_s)
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.occupancy.future_kernels import NEVER_CERTAIN, Float32Array
from humanpred_ros.occupancy.predictor import Prediction, Predictor

#: So many people are predicted for at once.
MOST_PEOPLE = 4


class PeoplePredictor:
    """Predicts for people told apart by names; what one of them does changes nothing for the others.

    Attributes:
        predictions: the newest one of each person.
    """

    def __init__(self, predictor: Predictor, most: int = MOST_PEOPLE) -> None:
        """Take a predictor that has seen nothing, of which each person gets a copy, and how many there may be."""
        self._pattern, self._most = predictor, most
        self._own: dict[str, Predictor] = {}
        self._threads: ThreadPoolExecutor | None = None
        self.predictions: dict[str, Prediction] = {}

    @property
    def predictors(self) -> list[Predictor]:
        """The one that is copied, and those of the people."""
        return [self._pattern, *self._own.values()]

    def of(self, name: str) -> Predictor:
        """Return a person's predictor.

        Raises:
            UsageError: too many people.
        """
        if name not in self._own:
            if len(self._own) == self._most:
                raise UsageError(f"too many people: predicted for are at most {self._most}, {name} is one more")
            self._own[name] = copy.deepcopy(self._pattern)
        return self._own[name]

    def forget(self, name: str) -> None:
        """Let a person have left; who comes under this name is somebody new."""
        self._own.pop(name, None)
        self.predictions.pop(name, None)

    def start(self, name: str) -> None:
        """Let a person's next posture begin a motion. Raises as `of`."""
        self.of(name).start()

    def update(self, postures: Mapping[str, tuple[FloatArray, float]]) -> dict[str, HumanPredError]:
        """Take a posture (D,) and its stamp in seconds of each of some people; several are predicted for side by side.

        Returns:
            Why there is no prediction, by name, for those for whom there is none.
        """
        troubles: dict[str, HumanPredError] = {}

        def predict(name: str) -> None:
            try:
                self.predictions[name] = self._own[name].update(*postures[name])
            except HumanPredError as error:
                self.predictions.pop(name, None)
                troubles[name] = error

        for name in postures:
            try:
                self.of(name)
            except UsageError as error:
                troubles[name] = error
        names = [name for name in postures if name not in troubles]
        if len(names) > 1:
            self._threads = self._threads or ThreadPoolExecutor(self._most - 1)
            others = [self._threads.submit(predict, name) for name in names[1:]]
            predict(names[0])
            for other in others:
                other.result()
        elif names:
            predict(names[0])
        return troubles

    def occupancy(self, names: Collection[str], t_s: float) -> Occupancy:
        """Return the occupancy of people, as of `t_s`: 1 - (1 - p)(1 - p')... of those who move independently.

        Raises:
            UsageError: nobody, or somebody for whom there is no prediction: what is not known is not empty.
        """
        unknown = [name for name in names if name not in self.predictions]
        if unknown or not names:
            raise UsageError(f"occupancy: wanted people with a prediction, got {', '.join(unknown) or 'nobody'}")
        first, *others = (self.predictions[name].occupancy for name in names)
        return joined(first, *others, t_s=t_s) if others else first


def joined(first: Occupancy, *others: Occupancy, t_s: float) -> Occupancy:
    """Return the occupancy of several independent people on one lattice; certain is only where one of them is."""
    p = first.probability.copy()
    for other in others:
        _join(p.reshape(-1), other.probability.reshape(-1))
    return Occupancy(first.grid, p, t_s)


@exact
def _join(p: Float32Array, other: Float32Array) -> None:
    one = np.float32(1.0)
    for v in range(len(p)):
        a, b = p[v], other[v]
        if b > 0.0:
            p[v] = one if a == one or b == one else (b if a == 0.0 else min(a + b - a * b, NEVER_CERTAIN))
