"""From recordings and weights to predictors that plan: P2's, and one that predicts better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.first_guess import ShortShoulder
from humanpred_ros.reaching.planner import ReachPlanner, ReachPlannerConfig, SingleShot, unit_deviation
from humanpred_ros.reaching.posture_bounds import BoundsConfig, PostureBounds
from humanpred_ros.reaching.reach_task import ReachPredictor
from humanpred_ros.reaching.replanning import Replanned
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.reaching.variation import posture_variation

#: Noise that STOMP needs of any DoF to work at all.
_LEAST_NOISE = 1e-6


@dataclass(frozen=True)
class ImprovedConfig:
    """What the better predictor does otherwise than P2; chosen on P2's seven recordings, each left out in turn.

    It begins with a `ShortShoulder` instead of the straight line, and stays nearer to it. Its bounds go with the
    reach: planned again and again, the trunk would drift to where others stood. No number has to be exact: half or
    double of each changes the distance in joint centres by at most 6 %, in task space by at most 10 %.

    Attributes:
        variation_share: noise of a DoF in the middle of a reach, as a share of how much people vary it.
        most_noise: but never more than this, in units of 1/R (P2: 0.001 for every DoF).
        n_iterations, averaged: so many updates for so many plans, of which the mean is taken (P2: 100 for one).
        obstacle_weight: between the two of P2's parameter files, 4 and 80.
    """

    variation_share: float = 1.0
    most_noise: float = 0.0003
    n_iterations: int = 25
    averaged: int = 2
    obstacle_weight: float = 40.0


def planned_predictor(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    weights: ArrayLike,
    *,
    replanned: bool = False,
    scene: Surroundings | None = None,
    config: ReachPlannerConfig | None = None,
    bounds: BoundsConfig | None = None,
) -> ReachPredictor:
    """Return P2's predictor with given weights (24,).

    Args:
        recordings: what bounds of the postures are taken from; leave the tested one out.
        model: the human.
        weights: learned, or of `NAMED_WEIGHTS`.
        replanned: plan again every 0.1 s instead of once.
        scene: table and region; P2's if None.
        config: of the planning.
        bounds: how the recordings bound postures; P2's way if None.

    Raises:
        PlanningError: weights that cannot be.
        MotionError: no recordings.
    """
    planner = ReachPlanner(model, weights, PostureBounds.from_recordings(recordings, model, bounds), scene, config)
    return Replanned(planner) if replanned else SingleShot(planner)


def improved_predictor(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    weights: ArrayLike,
    *,
    replanned: bool = False,
    scene: Surroundings | None = None,
    config: ImprovedConfig | None = None,
) -> ReachPredictor:
    """Return the better predictor; arguments and errors as in `planned_predictor`.

    The recordings also say how much people vary each DoF.
    """
    planner = improved_planner(recordings, model, weights, scene, config)
    return Replanned(planner) if replanned else SingleShot(planner)


def improved_planner(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    weights: ArrayLike,
    scene: Surroundings | None = None,
    config: ImprovedConfig | None = None,
) -> ReachPlanner:
    """Return the planner of the better predictor."""
    improved, plain = config or ImprovedConfig(), ReachPlannerConfig()
    deviation = improved.variation_share * posture_variation(recordings) / unit_deviation(plain.stomp.waypoints)
    noise = np.clip(deviation, _LEAST_NOISE, improved.most_noise)
    settings = replace(
        plain,
        stomp=plain.stomp.replaced(iterations=improved.n_iterations, noise_std=tuple(noise.tolist())),
        obstacle_weight=improved.obstacle_weight,
        averaged=improved.averaged,
    )
    bounds = PostureBounds.from_recordings(recordings, model, BoundsConfig(relative=True))
    return ReachPlanner(model, weights, bounds, scene, settings, ShortShoulder(model))
