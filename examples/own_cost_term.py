"""Your own cost term: the arm prefers a raised elbow, made without editing the package.

To choose it by name in nodes, demo and evaluations, offer it as an entry point in your package's pyproject.toml:

    [project.entry-points."humanpred_ros.cost_terms"]
    raised_elbow = "own_cost_term:RaisedElbow"

It is not compiled, so it is planned with term by term: correctly, and slower.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import humanpred_ros as hp


class RaisedElbowSettings(hp.Settings):
    """Settings of `RaisedElbow`: `--set raised_elbow.highest_rad=0.3`."""

    highest_rad: float = hp.setting(0.2, "the second joint costs nothing up to here", unit="rad")
    weight: float = hp.setting(1.0, "factor of the term", low=0.0)


class RaisedElbow(hp.CostTerm):
    """Costs 1 for each rad that the second joint is lowered beyond an angle."""

    settings_type = RaisedElbowSettings

    def __init__(self, settings: RaisedElbowSettings | None = None) -> None:
        self.settings = settings or RaisedElbowSettings()
        super().__init__("raised_elbow", self.settings.weight)

    @classmethod
    def build(cls, request: Any) -> RaisedElbow:
        return cls(request.settings)

    def evaluate(self, q: Any) -> tuple[Any, None]:
        return np.maximum(q[..., 1] - self.settings.highest_rad, 0.0).astype(np.float32), None


if __name__ == "__main__":
    from humanpred_ros.stomp.costs import SmoothnessCost
    from humanpred_ros.stomp.planner import StompPlanner

    scene = hp.load_scene("four_places")
    chain, goal = scene.arm.chain, scene.goals[0].configuration
    line = scene.start + np.linspace(0.0, 1.0, 100)[:, None] * scene.arm.difference(scene.start, goal)
    own = RaisedElbow()
    for terms in ([SmoothnessCost()], [SmoothnessCost(), own]):
        planner = StompPlanner(terms, chain.lower, chain.upper)
        plan = planner.plan(line, np.random.default_rng(0))
        lowered = float(own.costs(plan.waypoints[None]).mean())
        print(f"{', '.join(term.name for term in terms)}: the joint is {lowered:.3f} rad too low on average")
