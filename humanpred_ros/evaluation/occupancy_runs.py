"""The runs of an evaluation of occupancy: one motion left out each; and the lattice and region that scores are over."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.evaluation.leave_one_out import FoldSettings, LeaveOneOut, leave_one_out
from humanpred_ros.evaluation.occupancy_scores import MotionOutcome, Picture, VoxelScores, voxel_scores
from humanpred_ros.evaluation.recognition_scores import percent_indices
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, pelvis_columns, placed
from humanpred_ros.occupancy.predictor import Predictor
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.recognition.training import REACHING_LINK

#: P1's environment box along x, y, z (P1 occupancy); in voxels of 0.05 m it is 80 x 80 x 48.
BOX_M = (4.0, 4.0, 2.4)
P1_RESOLUTION_M = 0.05
#: Shares of the library's places outside of which a place may be a tracker's mistake.
_OUTER_PERCENT = (1.0, 99.0)
#: Where a test motion ends: with the recording, or when the palm is farthest from where it started.
ENDS = ("end", "apex")


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
        not_learned_from: names of motions that nothing is ever learned from.
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
    not_learned_from: frozenset[str]
    picture: tuple[str, int]


class LeftOutMotions:
    """Carries a library to where motions are run; what is learned from all of it is made there, once.

    Called with the name of a motion it returns one outcome for each predictor.
    """

    def __init__(self, predictors: Sequence[str], library: MotionLibrary, setup: OccupancySetup) -> None:
        self.predictors, self.library, self.setup = tuple(predictors), library, setup

    def __call__(self, name: str) -> tuple[MotionOutcome, ...]:
        """Run one motion. Raises what training raises."""
        setup, motion = self.setup, self.library.find(name)
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
                outcome = replace(outcome, unlisted=again.scores)
            outcomes.append(outcome)
        return tuple(outcomes)

    @cached_property
    def _voxeliser(self) -> BodyVoxeliser:
        return BodyVoxeliser(self.setup.human, self.setup.grid, self.setup.T_world_human)

    @cached_property
    def _folds(self) -> tuple[LeaveOneOut, ...]:
        s = self.setup
        taught = self.library.select(lambda motion: motion.name not in s.not_learned_from)
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
    """Take one place away from a predictor that is given places; return whether it had that one and others."""
    if not isinstance(predictor, ReachingPredictor):
        return False
    places = predictor.places
    if label is None or label not in places or len(places) < 2:
        return False
    predictor.set_places({other: place for other, place in places.items() if other != label})
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


def grid_around(library: MotionLibrary, human: HumanModel, resolution_m: float = P1_RESOLUTION_M) -> VoxelGrid:
    """Return a lattice of P1's size in the library's own frame, centred where its people stand and reach.

    Horizontally the centre is the middle of all start pelvises and palms (but for the outermost hundredths), vertically
    the middle of the body at the median start. The corner lies on a multiple of the resolution.

    Raises:
        UsageError: people or palms that do not fit into the box, or a resolution that is not a length within it.
        MotionError, HumanModelError: a library whose bodies cannot stand anywhere, or of another human.
    """
    if not 0.0 < resolution_m <= min(BOX_M):
        raise UsageError(f"grid: wanted voxels of a positive size up to {min(BOX_M)} m, got {resolution_m}")
    human.check_dofs(library.dof_names)
    columns = pelvis_columns(library.dof_names)
    starts = np.array([motion.q[0] for motion in library])
    palms = human.forward(np.concatenate([motion.q for motion in library]))[REACHING_LINK]
    boxes = [np.percentile(places, _OUTER_PERCENT, axis=0) for places in (starts[:, columns[:3]], palms)]
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    body_z = human.surface_points(np.median(starts, axis=0))[:, 2]
    low[2], high[2] = min(low[2], body_z.min()), max(high[2], body_z.max())
    middle = (low + high) / 2
    middle[2] = (body_z.min() + body_z.max()) / 2
    box = np.array(BOX_M)
    if (low < middle - box / 2).any() or (high > middle + box / 2).any():
        raise UsageError(
            f"grid: wanted a library whose people fit into {BOX_M} m, {library.name} extends over "
            f"{np.round(high - low, 2).tolist()} m; name a scene with a larger grid"
        )
    # Rounded again, so that -0.6 is -0.6 in a file, too.
    origin = np.round(np.round((middle - box / 2) / resolution_m) * resolution_m, 9)
    x, y, z = (round(length / resolution_m) for length in BOX_M)
    return VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), resolution_m, (x, y, z))


def swept_region(library: MotionLibrary, voxeliser: BodyVoxeliser, margin_voxels: int) -> NDArray[np.bool_]:
    """Return the boolean grid of voxels that some motion sweeps, widened by a margin: where scores are taken.

    Raises:
        UsageError: no motion touches the grid.
    """
    region = np.zeros(voxeliser.grid.shape, dtype=np.bool_)
    for motion in library:
        region |= voxeliser.mask(motion.q)
    if not region.any():
        raise UsageError(
            f"grid: wanted people within it, those of {library.name} are all outside; "
            "check the scene's human placement and the shift"
        )
    if margin_voxels:
        region = binary_dilation(region, iterations=margin_voxels)
    return region
