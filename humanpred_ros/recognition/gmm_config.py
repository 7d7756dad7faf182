"""One place for the settings of P1's classifier, shared by training, the model file and the node."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from humanpred_ros.errors import UsageError
from humanpred_ros.recognition.mixture import MixtureConfig

#: What may change on a trained classifier without training it again.
ONLINE_SETTINGS = ("evidence", "window_frames", "frame_log_density_floor", "prior", "nominal_duration_s")


@dataclass(frozen=True)
class GmmConfig:
    """P1's classifier (P1 III; facts 3).

    Fixed by training:

    Attributes:
        n_components: Gaussians per class; 40 as in the published models, P1's text states 20.
        phase_feature: let the frame number be a feature beside the posture, unscaled, as P1 does.
        unwrap_angles: make every angle of a motion continuous from its first posture on, offline and online. Off, as
            the authors used their recordings as they came, jumps of a whole turn included (facts 1, 3).
        covariance_floor: added to the diagonal of every covariance.
        n_phase_frames: postures a motion is resampled to; phases run from 0 to n_phase_frames - 1.
        seed: of the k-means seeds; each class draws from its own stream.
        max_iterations, tolerance: when EM stops.

    Free to change on a trained model:

        evidence: "sum" adds the log densities of the observed postures (P1 III); "mean" averages them, which
            leaves the decision the same and the posterior much softer (the published code).
        window_frames: count only the last so many postures; None counts all. 10 is what the published code did.
        frame_log_density_floor: no posture counts less than this; None sets no floor. The published code
            had the logarithm of the smallest normal double, about -708.
        prior: "uniform" (P1), or "frequency" of each class's motions in the library.
        nominal_duration_s: expected duration of a motion, from which the phase follows; None takes the
            library's median.
    """

    n_components: int = MixtureConfig.n_components
    phase_feature: bool = True
    unwrap_angles: bool = False
    covariance_floor: float = MixtureConfig.covariance_floor
    n_phase_frames: int = 100
    seed: int = 0
    max_iterations: int = MixtureConfig.max_iterations
    tolerance: float = MixtureConfig.tolerance
    evidence: Literal["sum", "mean"] = "sum"
    window_frames: int | None = None
    frame_log_density_floor: float | None = None
    prior: Literal["uniform", "frequency"] = "uniform"
    nominal_duration_s: float | None = None

    def __post_init__(self) -> None:
        if self.evidence not in ("sum", "mean"):
            raise UsageError(f"evidence: wanted 'sum' or 'mean', got {self.evidence!r}")
        if self.prior not in ("uniform", "frequency"):
            raise UsageError(f"prior: wanted 'uniform' or 'frequency', got {self.prior!r}")
        if self.window_frames is not None and self.window_frames < 1:
            raise UsageError(f"window_frames: wanted at least 1 or None for all, got {self.window_frames}")
        if self.nominal_duration_s is not None and not 0 < self.nominal_duration_s < float("inf"):
            raise UsageError(f"nominal_duration_s: wanted a positive time or None, got {self.nominal_duration_s}")
        if self.frame_log_density_floor is not None and not self.frame_log_density_floor < float("inf"):
            raise UsageError(f"frame_log_density_floor: wanted a number or None, got {self.frame_log_density_floor}")
        if self.n_phase_frames < 2:
            raise UsageError(f"n_phase_frames: wanted at least 2, got {self.n_phase_frames}")
        if self.seed < 0:
            raise UsageError(f"seed: wanted a number of at least 0, got {self.seed}")
        _ = self.mixture  # refuses impossible mixture settings

    @property
    def mixture(self) -> MixtureConfig:
        """The part that concerns fitting one mixture."""
        return MixtureConfig(self.n_components, self.covariance_floor, self.tolerance, self.max_iterations)

    def with_phase(self) -> GmmConfig:
        """Return these settings with the phase as a feature."""
        return replace(self, phase_feature=True)

    def with_online(self, **changes: Any) -> GmmConfig:
        """Return these settings with some of `ONLINE_SETTINGS` replaced.

        Raises:
            UsageError: a setting that a trained model cannot change any more, or an impossible value.
        """
        fixed = sorted(set(changes) - set(ONLINE_SETTINGS))
        if fixed:
            raise UsageError(
                f"a trained classifier cannot change {', '.join(fixed)}; it can change {', '.join(ONLINE_SETTINGS)}; "
                "train a new model for anything else"
            )
        return replace(self, **changes)
