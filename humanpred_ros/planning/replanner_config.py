"""How the replanner works: its defaults, in one place."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from humanpred_ros.errors import PlanningError
from humanpred_ros.stomp.planner import StompConfig


@dataclass(frozen=True)
class ReplannerConfig:
    """How the replanner works.

    Attributes:
        period_s: length of a replanning step; a plan takes over this long after its occupancy's stamp.
        n_threads: goals planned at the same time; it never changes a decision.
        seed: of every random draw, together with step and goal number.
        selection: goals are compared by "human_and_length" (the authors' code: the human cost integrated over
            the path plus length, facts section 4, plus what follows) or by "total" (all terms, as the paper's text
            says). A goal's task cost is added to either.
        length_weight: cost of a unit of configuration distance in the former.
        rest_weight: cost of resting at the goal in the former, in configuration distance: an arm that has arrived
            stays, so it disturbs there as if it went on for so long.
        min_improvement: share by which a new path to the same goal must be cheaper to replace the one being
            executed; 0 replaces it whenever it is not dearer.
        switch_improvement, switch_cost: another goal is worked on only if it is cheaper than the present one by this
            share and by this cost besides; the latter doubles, triples, ... for a goal that has been left before.
        prune_after: STOMP updates after which goals are compared a first time; hopeless ones get no more in this
            step. 0 never prunes.
        prune_factor, prune_cost: a goal is hopeless if it costs more than this many times the cheapest allowed one,
            plus this.
        reconnect_step: spacing of the landing points tried on an old path, configuration distance.
        velocity_scale: share of the joints' velocity limits used.
        acceleration_limit: rad/s², one number or one per joint. The URDF gives none.
        padding_m: clearance every movement keeps from obstacles, between its waypoints too.
        human_margin_m: the arm is charged for coming this close to predicted human occupancy, not only for
            entering it. The authors' cost points lie on boxes well outside the arm, ours on its very surface;
            this is the clearance they give obstacles (facts section 4).
        min_separation_m: the arm never moves closer than this to where the person is for certain, and does not rest
            closer to where they are likely to come; 0 forbids nothing.
        certain_probability, likely_probability: from where on a voxel counts as either. The default predictor
            gives probability 1 to where the body is now, and to nothing else.
        sample_period_s: largest time between knots of a trajectory.
        stomp: the planner's own.
    """

    period_s: float = 0.1
    n_threads: int = 2
    seed: int = 0
    selection: str = "human_and_length"
    length_weight: float = 0.002
    rest_weight: float = 0.2
    min_improvement: float = 0.02
    switch_improvement: float = 0.1
    switch_cost: float = 0.01
    prune_after: int = 10
    prune_factor: float = 10.0
    prune_cost: float = 0.5
    reconnect_step: float = 0.01
    velocity_scale: float = 0.5
    acceleration_limit: float | tuple[float, ...] = 4.0
    padding_m: float = 0.0
    human_margin_m: float = 0.10
    min_separation_m: float = 0.05
    certain_probability: float = 1.0
    likely_probability: float = 0.3
    sample_period_s: float = 0.02
    stomp: StompConfig = field(default_factory=StompConfig)

    def __post_init__(self) -> None:
        if self.selection not in ("human_and_length", "total"):
            raise PlanningError(
                f"replanner selection: wanted human_and_length or total, got {self.selection!r}; choose one"
            )
        for name in ("period_s", "velocity_scale", "sample_period_s", "reconnect_step"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise PlanningError(f"replanner {name}: wanted a number > 0, got {getattr(self, name)}")
        for name in ("length_weight", "rest_weight", "switch_cost", "prune_cost", "padding_m", "min_separation_m"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise PlanningError(f"replanner {name}: wanted a number >= 0, got {getattr(self, name)}")
        for name in ("min_improvement", "switch_improvement"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise PlanningError(f"replanner {name}: wanted a share in [0, 1), got {getattr(self, name)}")
        if not 0.0 < self.likely_probability <= self.certain_probability <= 1.0:
            raise PlanningError(
                "replanner: wanted 0 < likely_probability <= certain_probability <= 1, "
                f"got {self.likely_probability} and {self.certain_probability}"
            )
        if self.n_threads < 1 or self.prune_after < 0 or not self.prune_factor >= 1.0:
            raise PlanningError(
                "replanner: wanted n_threads >= 1, prune_after >= 0 and prune_factor >= 1, "
                f"got {self.n_threads}, {self.prune_after} and {self.prune_factor}"
            )
