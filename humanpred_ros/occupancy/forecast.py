"""The default predictor: the body will go on as people of the library went on from moments like this one.

The class says where the hand goes; how the body gets there differs from motion to motion. So the futures of several
recorded motions are followed instead of one mean motion. They are drawn from those whose posture resembles the present
one, and each is followed from there to its end. A voxel's probability is the summed probability of the futures that
touch it.

A future begins in the person's present posture, because most occupied voxels belong to the trunk and the legs, which
are where this person stands and leans now. The difference between the present posture and the recorded one stays in
part and fades in part, since the places reached for do not move with the person. Postures are recorded, not voxels: a
body's surface is thinner than a voxel and would blur if voxels were moved.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, OccupancyInTime, VoxelGrid
from humanpred_ros.occupancy import future_kernels as kernels
from humanpred_ros.occupancy.future_kernels import MOMENTS, Float32Array
from humanpred_ros.occupancy.futures import MOST_FUTURES, FutureVoxels, RecordedFutures, SweepSettings
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.slice_kernels import SliceRoom, collect_slices, follow_in_time
from humanpred_ros.recognition.classifier import Classifier
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.settings import setting


class ForecastSettings(SweepSettings):
    """Settings of the predictor `forecast`: how futures are drawn and attached to the present posture.

    Half or twice any of these makes the leave-one-out Brier score on library_b 4 % worse at most.
    """

    n_futures: int = setting(
        12, "recorded futures followed in each update; twice as many score 1.5 % better", low=1, high=MOST_FUTURES
    )
    least_share: float = setting(
        0.01, "a class less probable than this gets no future, so that the others get more", low=0.0, high=1.0
    )
    kept: float = setting(
        0.6, "share of the difference between the person's posture and the recorded one that lasts", low=0.0, high=1.0
    )
    fade: float = setting(
        0.2,
        "the rest of the difference falls to 1/e while this share of the recorded motion passes",
        low=1e-3,
        high=1e3,
    )
    pace: float = setting(
        0.25,
        "share, in logarithms, of the difference between the person's pace and the recorded one that lasts; 0: futures "
        "take the time they took when they were recorded",
        low=0.0,
        high=1.0,
    )


#: How far back the pace is looked for, and at least, s; and how much quicker or slower than recorded anybody may be.
_PACE_S, _LEAST_PACE_S, _MOST_PACE = 0.4, 0.15, 2.0


class _Present(NamedTuple):
    """What futures begin with."""

    t_s: float
    body: NDArray[np.bool_]  #: (X, Y, Z) where the body is
    now: FloatArray  #: (P, 3, 4) poses of its parts, library frame
    T_grid_library: FloatArray  #: (4, 4) from the library's frame to the grid in units of voxels
    chosen: NDArray[np.int64]  #: (F,) exemplars that are followed
    probability: FloatArray  #: (F,) of each


class ForecastPredictor(Predictor):
    """Follows how the library's people went on from moments like this one.

    p(voxel) = sum over exemplars of P(exemplar is the present moment) [what followed it touches the voxel].

    A reach of no class is also given futures of the learned classes; the posterior says how probable no class is. The
    voxels of the present body have probability 1, all others less. A person who stands elsewhere is moved to where the
    library's people stood (`ForestClassifier.alignment`), and the futures are moved back. Time and memory of an update
    do not depend on the number of postures seen.

    Attributes:
        grid: the lattice, world frame.
        settings: how futures are drawn and followed.
    """

    settings_type = ForecastSettings
    needs_model = True
    classifiers = ("forest",)

    def __init__(
        self,
        forest: ForestClassifier,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        *,
        recogniser: Classifier | None = None,
        settings: ForecastSettings | None = None,
    ) -> None:
        """Prepare the library's motions; a fifth of a second for 200 of them.

        Args:
            forest: a classifier that has learned; its human occupies, its exemplars are the futures.
            grid: the lattice, world frame.
            T_world_human: (4, 4) rigid transform from the tracker's frame to the world.
            recogniser: what runs `forest` and answers instead of it, such as a `StreamClassifier`; None: nothing.
            settings: the default ones if None.

        Raises:
            UsageError: a forest that has not learned.
            ArrayError: a placement that is not a rigid transform.
        """
        if forest.model is None:
            raise UsageError("forecast: wanted a classifier that has learned, got a new one; call fit(library) first")
        self.grid = grid
        self.settings = settings or ForecastSettings()
        self._forest = forest
        self._recogniser = forest if recogniser is None else recogniser
        self._voxels = FutureVoxels(forest.human, grid, T_world_human, self.settings)
        step_m = self.settings.step_voxels * grid.resolution_m
        self._exemplars = forest.model.exemplars
        self._futures = RecordedFutures.of(self._exemplars, forest.human, self._voxels.parts, step_m)
        n_moments = MOMENTS * np.maximum(np.diff(self._exemplars.first) - 1, 1)
        self._moment_s = self._exemplars.duration_s / n_moments
        moments = MOMENTS * (np.arange(len(self._futures.label)) - self._exemplars.first[self._exemplars.motion])
        #: (M,) how long after its motion's begin each exemplar was passed, s
        self._passed_s = moments * self._moment_s[self._exemplars.motion]
        self._progress: deque[tuple[float, float]] = deque()  #: stamps, and how far recorded people were by then, s
        self._room: SliceRoom | None = None
        self._last: _Present | None = None
        # What is compiled or put in order at its first use is used here: the first posture must not wait for it.
        _ = forest.model.forest.leaf_members
        start, drawn = forest.model.exemplars.q[0], self._drawn(np.ones(len(self._futures.label)))
        self._probability(self._present(start, 0.0, np.eye(4), drawn))

    @classmethod
    def from_request(cls, request: PredictorRequest) -> ForecastPredictor:
        forest = request.make_classifier()
        if not isinstance(forest, ForestClassifier):  # a package that calls another classifier forest is refused before
            raise UsageError(f"predictor forecast: wanted the classifier forest, got {type(forest).__name__}")
        settings = request.settings if isinstance(request.settings, ForecastSettings) else None
        recogniser = request.on_stream(forest)
        return cls(forest, request.grid, request.T_world_human, recogniser=recogniser, settings=settings)

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        self._recogniser.start()
        self._last = None
        self._progress.clear()

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s`; raises what the classifier raises, and then changes nothing."""
        posterior = self._recogniser.update(q, t_s)
        T_library_tracker = self._forest.alignment
        self._last = self._present(q, t_s, T_library_tracker, self._drawn(self._forest.exemplar_weights()))
        self._progress.append((t_s, float(self._last.probability @ self._passed_s[self._last.chosen])))
        while self._progress[0][0] < t_s - _PACE_S:
            self._progress.popleft()
        return Prediction(Occupancy(self.grid, self._probability(self._last), t_s), posterior, T_library_tracker)

    def in_time(self, edges_s: FloatArray) -> OccupancyInTime | None:
        """Return when the futures touch which voxels; None where it is not known how long motions took.

        Each takes the time its motion took: how much that differs from person to person is in the library. Somebody who
        was quicker or slower than the recorded people stays so in part (`ForecastSettings.pace`). When a recorded
        motion ends, the body stays.
        """
        if self._last is None or not np.isfinite(self._moment_s).all():
            return None
        present, voxels, parts = self._last, self._voxels, self._voxels.parts
        if self._room is None or self._room.bits.shape[1] != len(edges_s) - 1:
            self._room = SliceRoom.of(self.grid.size, len(edges_s) - 1)
        follow_in_time(
            present.chosen,
            present.now,
            self._futures.ways,
            self._moment_s / self.seen_pace() ** self.settings.pace,
            np.asarray(edges_s, dtype=np.float64),
            self.settings.kept,
            self.settings.fade,
            present.T_grid_library,
            parts.points,
            parts.first,
            voxels.balls,
            self.grid.shape,
            self._room,
        )
        touched, p = collect_slices(present.probability, present.body, self.settings.spread, self._room)
        return OccupancyInTime(self.grid, edges_s, touched, p, present.t_s)

    def seen_pace(self) -> float:
        """Return how many times as quickly as the recorded people this one went lately; 1 before that is known."""
        if not self._progress:
            return 1.0
        (begin_s, from_s), (end_s, to_s) = self._progress[0], self._progress[-1]
        if end_s - begin_s < _LEAST_PACE_S:
            return 1.0
        return float(np.clip((to_s - from_s) / (end_s - begin_s), 1.0 / _MOST_PACE, _MOST_PACE))

    def futures(self, q: FloatArray) -> list[tuple[float, FloatArray]]:
        """Return the ways that the hands of a person in posture (D,), updated with last, may go, for people to see.

        Returns:
            Of each future followed and each hand: probability, and places (N, 3) in m, tracker's frame.
        """
        exemplars, human = self._exemplars, self._forest.human
        T, (chosen, probability) = self._forest.alignment, self._drawn(self._forest.exemplar_weights())
        found = []
        for e, p in zip(chosen, probability, strict=True):
            end = exemplars.first[np.searchsorted(exemplars.first, e, side="right")]
            begin = exemplars.first[np.searchsorted(exemplars.first, e, side="right") - 1]
            left = np.exp(-np.arange(end - e) / (self.settings.fade * max(1, end - begin - 1)))
            left = self.settings.kept + (1.0 - self.settings.kept) * left
            then, now = human.forward(exemplars.q[e:end]), human.forward(q)
            for hand in (name for name in then if name.endswith("_palm")):
                aside = T[:3, :3] @ now[hand] + T[:3, 3] - then[hand][0]
                found.append((float(p), (then[hand] + left[:, None] * aside - T[:3, 3]) @ T[:3, :3]))
        return found

    def _drawn(self, weight: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        futures, c = self._futures, self.settings
        return kernels.draw(weight, futures.label, futures.n_classes, c.n_futures, c.least_share)

    def _present(
        self, q: FloatArray, t_s: float, T_library_tracker: FloatArray, drawn: tuple[NDArray[np.int64], FloatArray]
    ) -> _Present:
        voxels = self._voxels
        now = T_library_tracker @ voxels.human.link_poses(q)[voxels.parts.link]
        T_grid_library = voxels.T_grid_human @ np.linalg.inv(T_library_tracker)
        return _Present(t_s, voxels.body(q), np.ascontiguousarray(now[:, :3]), T_grid_library, *drawn)

    def _probability(self, present: _Present) -> Float32Array:
        """Return the grid of probabilities that follow from the present and the exemplars chosen."""
        voxels, parts = self._voxels, self._voxels.parts
        kernels.follow(
            present.chosen,
            present.now,
            self._futures.ways,
            self.settings.kept,
            self.settings.fade,
            present.T_grid_library,
            parts.points,
            parts.first,
            voxels.balls,
            self.grid.shape,
            voxels.touched,
        )
        voxels.add(present.probability)
        return voxels.collected(present.body)
