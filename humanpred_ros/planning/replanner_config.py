"""How the replanner works: its defaults, in one place."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from humanpred_ros.errors import PlanningError
from humanpred_ros.planning.stomp import StompConfig


@dataclass(frozen=True)
class ReplannerConfig:
    """How the replanner works.

    Attributes:
        period_s: length of a replanning step; a plan takes over this long after its occupancy's stamp.
        n_threads: goals planned at the same time; it never changes a decision.
        seed: of every random draw, together with step and goal number.
        selection: goals are compared by "human_and_length" (the authors' code: the human cost integrated over
            the path plus length, facts section 4) or by "total" (all terms, as the paper's text says).
        length_weight: cost of a unit of configuration distance in the former.
        min_improvement: share by which a new path to the same goal must be cheaper to replace the one being
            executed; 0 replaces it whenever it is not dearer.
        reconnect_step: spacing of the landing points tried on an old path, configuration distance.
        velocity_scale: share of the joints' velocity limits used.
        acceleration_limit: rad/s², one number or one per joint. The URDF gives none.
        human_margin_m: the arm is charged for coming this close to predicted human occupancy, not only for
            entering it. The authors' cost points lie on boxes well outside the arm, ours on its very surface;
            this is the clearance they give obstacles (facts section 4).
        sample_period_s: largest time between knots of a trajectory.
        stomp: the planner's own.
    """

    period_s: float = 0.1
    n_threads: int = 2
    seed: int = 0
    selection: str = "human_and_length"
    length_weight: float = 0.002
    min_improvement: float = 0.02
    reconnect_step: float = 0.01
    velocity_scale: float = 0.5
    acceleration_limit: float | tuple[float, ...] = 4.0
    human_margin_m: float = 0.10
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
        if self.n_threads < 1 or not 0.0 <= self.min_improvement < 1.0 or self.length_weight < 0.0:
            raise PlanningError(
                "replanner: wanted n_threads >= 1, min_improvement in [0, 1) and length_weight >= 0, "
                f"got {self.n_threads}, {self.min_improvement} and {self.length_weight}"
            )
