"""Settings of STOMP."""

from __future__ import annotations

from humanpred_ros.errors import SettingsError
from humanpred_ros.settings import Settings, setting

__all__ = ["StompConfig"]


class StompConfig(Settings):
    """Settings of STOMP; defaults are P1's (docs/papers.md, P1 STOMP and P1 costs), but for the obstacle weight.

    P1's obstacle weight of 0.1 goes with its number of spheres and its unit of speed, which are not known; with ours
    the arm would pass through the table rather than bend. 100 frees 28 of 30 straight lines of the side-by-side scene
    within 50 iterations.
    """

    waypoints: int = setting(100, "waypoints of a path, start and goal included", low=5, high=1000)
    iterations: int = setting(50, "STOMP iterations per goal and step", low=0, high=10000)
    rollouts: int = setting(10, "noisy rollouts an iteration averages over", low=1, high=1000)
    reused: int = setting(5, "of these, the cheapest ones of the iteration before; the others are new", low=0, high=999)
    noise_std: float | tuple[float, ...] = setting(
        0.002,
        "noise of the rollouts, one number or one for each joint (0.002: 0.14 rad at the middle of 100 waypoints)",
        unit="R^-1/2",
        low=1e-9,
        high=1.0,
        changeable=True,
    )
    noise_decay: float = setting(1.0, "factor on the noise per iteration", low=0.01, high=1.0)
    # The compiled exponential holds for arguments down to -100.
    sharpness: float = setting(10.0, "h of P1's probabilities exp(-h (S - min) / (max - min))", low=0.01, high=100.0)
    patience: int = setting(
        0, "iterations without becoming cheaper after which an allowed path is done; 0 does all", low=0, high=10000
    )
    tolerance: float = setting(0.01, "share of the cost that counts as cheaper", low=0.0, high=0.99)
    obstacle_weight: float = setting(100.0, "weight of the distance to obstacles", low=0.0)
    human_weight: float = setting(1.0, "weight of the predicted human occupancy", low=0.0)
    smoothness_weight: float = setting(10000.0, "weight of the squared accelerations", low=0.0)

    def check(self) -> None:
        """Refuse more reused rollouts than rollouts."""
        if self.reused >= self.rollouts:
            raise SettingsError(
                f"StompConfig reused: wanted fewer than rollouts ({self.rollouts}), got {self.reused}; lower reused"
            )
