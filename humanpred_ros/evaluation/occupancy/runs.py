"""A predictor is judged on motions it has not learned from; these are the runs, one motion left out each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation.leave_one_out import FoldSettings, LeaveOneOut, leave_one_out
from humanpred_ros.evaluation.occupancy.scores import VoxelScores, voxel_scores
from humanpred_ros.evaluation.recognition_scores import percent_indices
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.placement import placed
from humanpred_ros.occupancy.predictor import Predictor
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.recognition.training import REACHING_LINK

#: Where a test motion ends: with the recording, or when the palm is farthest from where it started.
ENDS = ("end", "apex")


@dataclass(frozen=True, eq=False)
class Picture:
    """One moment seen from above: the highest value in each column of voxels.

    Attributes:
        percent: share of the motion seen.
        swept: (X, Y) 1 where the body is from then on, else 0.
        predicted: (X, Y) probability.
    """

    percent: int
    swept: NDArray[np.float32]
    predicted: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MotionOutcome:
    """What a predictor made of one motion that it had not learned from.

    Attributes:
        name: the motion.
        scores: of the prediction after each percentage of the motion.
        update_ns: (T,) how long each update took.
        refused: postures the predictor refused; its prediction then stays what it was.
        prepare_s: how long it took to train without this motion.
        picture: the moment asked for, if this is the motion asked for.
        untold: the scores of who is told places, shown the motion once more without having been told this one's; None
            for who is told none, or would be left with none.
    """

    name: str
    scores: tuple[VoxelScores, ...]
    update_ns: NDArray[np.int64]
    refused: int
    prepare_s: float
    picture: Picture | None
    untold: tuple[VoxelScores, ...] | None = None


@dataclass(frozen=True, eq=False)
class OccupancySetup:
    """How predictions are made and scored.

    Attributes:
        human: whose body occupies.
        grid: the lattice, world frame.
        T_world_human: (4, 4) from the library's frame to the world.
        region: (V,) flat booleans, the voxels over which scores are means.
        percents: shares of a motion after which its predictions are scored.
        until: one of `ENDS`.
        T_shift: (4, 4) moves the people of the test motions, in the library's frame; training motions stay.
        classifier, gmm: as in `FoldSettings`.
        untaught: names of motions that nothing is ever learned from.
        picture: (motion, percent) of which a picture is wanted.
    """

    human: HumanModel
    grid: VoxelGrid
    T_world_human: FloatArray
    region: NDArray[np.bool_]
    percents: tuple[int, ...]
    until: str
    T_shift: FloatArray
    classifier: str
    gmm: GmmSettings
    untaught: frozenset[str]
    picture: tuple[str, int]


class LeftOutMotions:
    """Carries a library to where motions are run; what is learned from all of it is made there, once.

    Called with the name of a motion it returns one outcome for each predictor.
    """

    def __init__(self, predictors: Sequence[str], library: MotionLibrary, setup: OccupancySetup) -> None:
        self.predictors, self.setup = tuple(predictors), setup
        # A library's provenance cannot be pickled, and nobody learns from it.
        self._name, self._motions = library.name, library.motions

    def __call__(self, name: str) -> tuple[MotionOutcome, ...]:
        """Run one motion. Raises what training raises."""
        setup, motion = self.setup, self._library.find(name)
        postures, t_s = until_end(placed(motion, setup.T_shift), setup.human, setup.until)
        last_touch = self._voxeliser.last_touch(postures).ravel()
        outcomes = []
        for fold in self._folds:
            begun = time.perf_counter()
            predictor = fold.without(name)
            prepare_s = time.perf_counter() - begun
            outcome = _played(predictor, name, postures, t_s, last_touch, prepare_s, setup)
            if _forgets_place(predictor, motion.label):
                again = _played(predictor, name, postures, t_s, last_touch, prepare_s, setup)
                outcome = replace(outcome, untold=again.scores)
            outcomes.append(outcome)
        return tuple(outcomes)

    @cached_property
    def _library(self) -> MotionLibrary:
        return MotionLibrary(self._name, self._motions)

    @cached_property
    def _voxeliser(self) -> BodyVoxeliser:
        return BodyVoxeliser(self.setup.human, self.setup.grid, self.setup.T_world_human)

    @cached_property
    def _folds(self) -> tuple[LeaveOneOut, ...]:
        s = self.setup
        taught = self._library.select(lambda motion: motion.name not in s.untaught)
        settings = FoldSettings(taught, s.human, s.grid, s.T_world_human, s.classifier, s.gmm, s.T_shift)
        return tuple(leave_one_out(predictor, settings) for predictor in self.predictors)


def until_end(motion: Motion, human: HumanModel, until: str) -> tuple[FloatArray, FloatArray]:
    """Return postures (T, D) and stamps (T,) of a motion up to where it is taken to end (`ENDS`)."""
    n = len(motion)
    if until == "apex":
        palm = human.forward(motion.q)[REACHING_LINK]
        n = int(np.argmax(np.linalg.norm(palm - palm[0], axis=1))) + 1
    return motion.q[:n], motion.t_s[:n]


def _forgets_place(predictor: Predictor, label: int | None) -> bool:
    """Take one place away from a predictor that is told places; return whether it had that one and others."""
    if not isinstance(predictor, ReachingPredictor):
        return False
    goals = predictor.goals
    if label is None or label not in goals.labels or len(goals) < 2:
        return False
    predictor.set_goals(goals.without(label))
    return True


def _played(
    predictor: Predictor,
    name: str,
    postures: FloatArray,
    t_s: FloatArray,
    last_touch: NDArray[np.int32],
    prepare_s: float,
    setup: OccupancySetup,
) -> MotionOutcome:
    """Show a motion to a predictor, posture by posture as a sensor would, and score what it said on the way.

    Until the first posture it accepts it has predicted nothing. Nobody tells it how long the motion is.
    """
    seen = percent_indices(len(postures))[np.array(setup.percents) - 1]
    predictor.start()
    predicted = np.zeros(setup.grid.size, dtype=np.float32)
    update_ns = np.zeros(int(seen.max()) + 1, dtype=np.int64)
    refused, picture = 0, None
    scores: dict[int, VoxelScores] = {}
    for k in range(len(update_ns)):
        begun = time.perf_counter_ns()
        try:
            predicted = predictor.update(postures[k], float(t_s[k])).occupancy.probability.ravel()
        except HumanPredError:
            refused += 1
        update_ns[k] = time.perf_counter_ns() - begun
        if k not in seen:
            continue
        # The posture seen last is part of what is still to be swept: the body is there now.
        swept = last_touch >= k
        scores[k] = voxel_scores(predicted, swept, setup.region)
        if setup.picture[0] == name and k == seen[setup.percents.index(setup.picture[1])]:
            shape = setup.grid.shape
            above = [volume.reshape(shape).max(axis=2).astype(np.float32) for volume in (swept, predicted)]
            picture = Picture(setup.picture[1], *above)
    return MotionOutcome(name, tuple(scores[k] for k in seen.tolist()), update_ns, refused, prepare_s, picture)
