"""Settings of the replanner."""

from __future__ import annotations

from typing import Any, Literal

from humanpred_ros.errors import SettingsError
from humanpred_ros.settings import LARGEST_SEED, Settings, setting
from humanpred_ros.stomp.config import StompConfig

__all__ = ["ReplannerConfig"]


class ReplannerConfig(Settings):
    """Settings of `Replanner`: how goals are compared, what is kept clear of, how fast the arm moves.

    Goals are compared by the human cost integrated over the path, plus length, rest and task cost ("human_and_length":
    as the authors' code does), or by the total of all cost terms ("total": as the paper's text says).

    A cost is in P1's unit: body points inside of the occupancy times configuration distance (docs/papers.md, 1.12). The
    authors' cost points lie on boxes well outside of the arm, ours on its very surface: that is what `human_margin_m`
    makes up for.
    """

    period_s: float = setting(0.1, "length of a replanning step", unit="s", low=0.02, high=10.0)
    threads: int = setting(2, "goals planned at the same time; never changes a decision", low=1, high=64)
    seed: int = setting(0, "seed of every random draw", low=0, high=LARGEST_SEED)
    selection: Literal["human_and_length", "total"] = setting(
        "human_and_length", "what goals are compared by: human_and_length, or total of all cost terms"
    )
    cost_terms: tuple[str, ...] = setting(
        ("obstacle", "human", "smoothness"), "what trajectories are charged for: names of cost terms, of plug-ins too"
    )
    cost_term_settings: dict[str, dict[str, Any]] = setting({}, "settings of cost terms of plug-ins, by term and name")
    length_weight: float = setting(0.002, "cost of a unit of configuration distance, in the comparison", low=0.0)
    rest_weight: float = setting(
        0.2, "configuration distance for which an arm at its goal counts as if it went on there", low=0.0
    )
    min_improvement: float = setting(
        0.02, "share by which a path must be cheaper to replace the one being executed", low=0.0, high=0.99
    )
    switch_improvement: float = setting(
        0.1, "share by which another goal must be cheaper than the present one", low=0.0, high=0.99
    )
    switch_cost: float = setting(
        0.01, "cost by which it must be cheaper besides; twice, three times that for a goal left before", low=0.0
    )
    prune_after: int = setting(
        10, "STOMP iterations after which far too expensive goals are set aside for the step; 0: never", low=0
    )
    prune_factor: float = setting(10.0, "far too expensive: so many times the cheapest allowed goal ...", low=1.0)
    prune_cost: float = setting(0.5, "... plus this cost", low=0.0)
    reconnect_step: float = setting(
        0.01, "spacing of the landing points tried on an old path, configuration distance", low=1e-4
    )
    velocity_scale: float = setting(0.5, "share of the URDF's velocity limits used", low=0.01, high=1.0)
    acceleration_limit: float | tuple[float, ...] = setting(
        4.0, "acceleration limit of every joint, one number or one for each", unit="rad/s^2", low=0.01, high=100.0
    )
    padding_m: float = setting(0.0, "clearance every motion keeps from obstacles", unit="m", low=0.0, high=0.09)
    human_margin_m: float = setting(
        0.10, "coming this close to predicted occupancy costs as much as entering it", unit="m", low=0.0, high=0.5
    )
    min_separation_m: float = setting(
        0.05, "the arm never moves closer to the person than this; 0 forbids nothing", unit="m", low=0.0, high=1.0
    )
    certain_probability: float = setting(
        1.0, "from here on the person counts as being in a voxel for certain", low=0.001, high=1.0
    )
    likely_probability: float = setting(
        0.3, "from here on the person counts as likely to come to a voxel", low=0.001, high=1.0
    )
    sample_period_s: float = setting(0.02, "longest time between two points of a trajectory", unit="s", low=1e-3)
    stomp: StompConfig = setting(StompConfig(), "STOMP's own settings")

    def check(self) -> None:
        """Refuse a certain probability below the likely one, and no cost terms or one of them twice."""
        if not self.cost_terms or len(set(self.cost_terms)) < len(self.cost_terms):
            raise SettingsError(
                f"ReplannerConfig cost_terms: wanted one or more names, each once, got {self.cost_terms}"
            )
        if self.likely_probability > self.certain_probability:
            raise SettingsError(
                "ReplannerConfig likely_probability: wanted at most certain_probability "
                f"({self.certain_probability}), got {self.likely_probability}"
            )
