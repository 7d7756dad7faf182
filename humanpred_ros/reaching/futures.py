"""Samples how a reach under way goes on, if it goes to a given place, and how it comes back.

The end posture, given the place and what was seen so far, is Gaussian (`EndPostures`, `ReachShape.given`). The most
probable way there is planned by STOMP, as P2 plans for the human, with the learned cost of reaching and the obstacles.
Samples differ from it by their end posture and by what people vary in between, and all of them begin in the present
posture. The same draws serve every update and every place, so that predictions do not flicker.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.occupancy.futures import MOST_FUTURES
from humanpred_ros.reaching.between_ends import PostureBounds
from humanpred_ros.reaching.end_postures import EndPosture, standing
from humanpred_ros.reaching.planner import LEAST_NOISE, ReachPlanner, ReachPlannerSettings, unit_deviation
from humanpred_ros.reaching.reach_model import ReachModel, ReachProgress, ReachShape
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.settings import LARGEST_SEED, Settings, setting
from humanpred_ros.stomp.config import StompConfig

#: The noise of a DoF in STOMP is at most this.
_MOST_NOISE = 0.003
_LEAST_DURATION_S = 0.1
_MOST_ENDS = 256
#: Postures of a future, at most: no hand has farther to go than some 4 m, whatever a posture says.
_MOST_POSTURES = 64


class ReachFuturesSettings(Settings):
    """How the rest of a reach is sampled."""

    n_samples: int = setting(
        16, "Futures for each place; even, as every draw has its mirror image", low=2, high=MOST_FUTURES
    )
    step_m: float = setting(
        0.06, "A future has one posture for this much of the straight way of the hand", unit="m", low=1e-6
    )
    planned: bool = setting(True, "Plan the most probable way by STOMP; else it is the straight line and its bow")
    # A short way, from a good guess, needs few waypoints and updates.
    stomp: StompConfig = setting(
        StompConfig(waypoints=30, iterations=15, rollouts=10, reused=5),
        "Settings of STOMP; the noise is not taken from here, but from what people vary",
    )
    obstacle_weight: float = setting(40.0, "Weight of the obstacles, as in `improved_planner`", low=0.0)
    seed: int = setting(0, "Seed of the draws", low=0, high=LARGEST_SEED)

    def check(self) -> None:
        if self.n_samples % 2:
            raise SettingsError(f"ReachFuturesSettings n_samples: wanted an even number, got {self.n_samples}")


class ReachFutures:
    """Samples how a reach goes on; holds no state between calls.

    Args:
        model: what was learned about reaches.
        weights: (24,) of the features of P2's cost.
        surroundings: obstacles in the tracker's frame; none if None.
        settings: how futures are sampled.

    Raises:
        PlanningError: negative weights, or an array of another shape.
    """

    def __init__(
        self,
        model: ReachModel,
        weights: ArrayLike,
        surroundings: Surroundings | None = None,
        settings: ReachFuturesSettings | None = None,
    ) -> None:
        self.model = model
        self.settings = s = settings or ReachFuturesSettings()
        human = model.human
        deviation = np.sqrt(np.diag(model.shape.variation)) / unit_deviation(s.stomp.waypoints)
        noise = tuple(np.clip(deviation, LEAST_NOISE, _MOST_NOISE).tolist())
        planning = ReachPlannerSettings(stomp=s.stomp.replaced(noise_std=noise), obstacle_weight=s.obstacle_weight)
        bounds = PostureBounds(human.lower, human.upper, np.zeros(len(human.dof_names), dtype=np.bool_))
        self._planner = ReachPlanner(human, weights, bounds, surroundings or Surroundings.empty(), planning)
        self._nobody = self._planner.nobody()
        half = np.random.default_rng(s.seed).standard_normal((s.n_samples // 2, 3, len(human.dof_names)))
        #: (S, 3, D) draws of end posture, way and posture after the return.
        self._draws = np.concatenate([half, -half])
        # Start and place stay the same while a reach lasts.
        self._end = lru_cache(maxsize=_MOST_ENDS)(self._end_from)
        self._shape = lru_cache(maxsize=_MOST_ENDS)(self._shape_from)
        # Those that return are spread over the draws.
        order = np.random.default_rng(s.seed).permutation(s.n_samples)
        returning = round(model.returning * s.n_samples)
        self._returns, self._stays = order[:returning], order[returning:]

    def towards(self, progress: ReachProgress, place_m: FloatArray) -> FloatArray:
        """Return futures (S, N, D) of a reach under way, if it goes to the place (3,): all equally probable.

        For a hand that has turned back these are ways back; the place is then not used.
        """
        start, now = progress.start_posture, progress.posture
        way_m = float(np.linalg.norm(place_m - progress.start_hand_m))
        if progress.turned:
            return self._back(progress, np.repeat(progress.apex[None], self.settings.n_samples, axis=0))
        done = progress.way_to(place_m)
        end = self._given(progress, place_m, done, way_m)
        ends = end.mean + self._draws[:, 0] @ _root(end.covariance).T
        n = self._n_postures(float(np.linalg.norm(place_m - progress.hand_m)))
        share = np.linspace(done, 1.0, n)
        out = self._from_now(now, start, ends, share, way_m)
        if self.settings.planned and done < 1.0:
            out += self._planned(start, now, end, share, way_m)
        return self._with_return(progress, out, ends, way_m)

    def towards_each(self, progress: ReachProgress, places_m: FloatArray) -> FloatArray:
        """Return futures (K, N, D) of a reach that has not turned back, one to each of up to S places (K, 3).

        For places that stand for a region. STOMP does not plan these: none of the ways is likely to be the one.
        """
        start, now = progress.start_posture, progress.posture
        way_m = np.linalg.norm(places_m - progress.start_hand_m, axis=1)
        done = np.array([progress.way_to(place) for place in places_m])
        ends = np.empty((len(places_m), len(now)))
        for k, place in enumerate(places_m):
            end = self._given(progress, place, float(done[k]), float(way_m[k]))
            ends[k] = end.mean + _root(end.covariance) @ self._draws[k, 0]
        left_m = np.linalg.norm(places_m - progress.hand_m, axis=1)
        share = done[:, None] + (1.0 - done[:, None]) * np.linspace(0.0, 1.0, self._n_postures(float(left_m.max())))
        return self._with_return(progress, self._from_now(now, start, ends, share, way_m), ends, way_m)

    def _given(self, progress: ReachProgress, place_m: FloatArray, done: float, way_m: float) -> EndPosture:
        """Return the end posture at a place, given what was seen of the reach."""
        start = progress.start_posture
        end = self._end(start.tobytes(), place_m.tobytes())
        return self._shape(start.tobytes())[0].given(end, start, progress.posture, done, way_m)

    def _from_now(
        self, now: FloatArray, start: FloatArray, ends: FloatArray, share: FloatArray, way_m: float | FloatArray
    ) -> FloatArray:
        """Return ways (S, N, D) to end postures, as `_between_ends`, all from the present posture on."""
        out = self._between_ends(start, start, ends, share, way_m)
        left = np.linspace(1.0, 0.0, out.shape[1])[:, None]
        out += left * (now - out[:, :1])
        return out

    def _with_return(
        self, progress: ReachProgress, out: FloatArray, ends: FloatArray, way_m: float | FloatArray
    ) -> FloatArray:
        """Return the futures, followed by the ways back of the share that comes back."""
        if not len(self._returns):
            return out
        back = self._back(progress, ends, way_m)
        # Those that stay repeat their last posture.
        stays = self._stays[self._stays < len(ends)]
        back[stays] = ends[stays, None]
        return np.concatenate([out, back], axis=1)

    def _end_from(self, start: bytes, place_m: bytes) -> EndPosture:
        return self.model.ends.at(np.frombuffer(start), np.frombuffer(place_m))

    def _shape_from(self, start: bytes) -> tuple[ReachShape, FloatArray, FloatArray]:
        """Return the shape of reaches from a posture, and roots of the variances on the way and at rest."""
        R = standing(self.model.human, np.frombuffer(start))[:3, :3]
        shape = self.model.shape.turned(R)
        turn = np.eye(len(shape.variation))
        turn[:3, :3] = R
        return shape, turn @ _root(self.model.shape.variation), turn * self.model.rest_deviation

    def _back(self, progress: ReachProgress, ends: FloatArray, way_m: float | FloatArray | None = None) -> FloatArray:
        """Return the ways back (S, N, D) from end postures (S, D), from the present one if the hand has turned."""
        start = progress.start_posture
        under_way = way_m is None
        if way_m is None:
            way_m = progress.reached_m
        share = np.linspace(1.0 - progress.way_back if under_way else 1.0, 0.0, self._n_postures(float(np.max(way_m))))
        rests = start + self._draws[: len(ends), 2] @ self._shape(start.tobytes())[2].T
        back = self._between_ends(start, rests, ends, share, way_m)
        if under_way:
            left = np.linspace(1.0, 0.0, len(share))[:, None]
            back += left * (progress.posture - back[:, :1])
        return back

    def _between_ends(
        self, start: FloatArray, near: FloatArray, far: FloatArray, share: FloatArray, way_m: float | FloatArray
    ) -> FloatArray:
        """Return postures (S, N, D) at shares of ways from near (S, D) or (D,) to far (S, D).

        Shares (N,) and the hand's way are the same for all, or (S, N) and (S,).
        """
        shape, root, _ = self._shape(start.tobytes())
        first = np.broadcast_to(near, far.shape)[:, None]
        line = first + share[..., None] * (far[:, None] - first)
        varied = self._draws[: len(far), 1] @ root.T
        bow = np.reshape(way_m, (-1, 1, 1)) * shape.bow_at(share, 1.0)
        postures: FloatArray = line + bow + np.sqrt(4.0 * share * (1.0 - share))[..., None] * varied[:, None]
        return postures

    def _planned(
        self, start: FloatArray, now: FloatArray, end: EndPosture, share: FloatArray, way_m: float
    ) -> FloatArray:
        """Return the difference (N, D) of the planned way from the first guess, at shares (N,)."""
        n = self.settings.stomp.waypoints
        evenly = np.linspace(share[0], 1.0, n)
        guess = self._shape(start.tobytes())[0].bow_at(evenly, way_m)
        first = guess[0].copy()
        left = (1.0 - evenly) / (1.0 - evenly[0])
        guess = guess + left[:, None] * (now - first) + (1.0 - left)[:, None] * end.mean
        duration_s = max((1.0 - share[0]) * way_m * self.model.pace_s_m, _LEAST_DURATION_S)
        rng = np.random.default_rng(self.settings.seed)
        reach = self._planner.plan(now, end.mean, duration_s, self._nobody, rng, initial=guess)
        difference = reach.q - guess
        return np.stack([np.interp(share, evenly, column) for column in difference.T], axis=1)

    def _n_postures(self, way_m: float) -> int:
        return 2 + int(np.ceil(min(way_m / self.settings.step_m, _MOST_POSTURES - 2.0)))


def _root(covariance: FloatArray) -> FloatArray:
    """Return A (D, D) with A A' = covariance; it may be singular."""
    variance, axes = np.linalg.eigh(covariance)
    root: FloatArray = axes * np.sqrt(np.maximum(variance, 0.0))
    return root
