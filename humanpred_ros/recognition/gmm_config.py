"""The settings of P1's classifier, shared by training, the model file and the node."""

from __future__ import annotations

from typing import Any, Literal

from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.recognition.mixture import MixtureConfig
from humanpred_ros.settings import Settings, setting

#: What may change on a trained classifier without training it again.
ONLINE_SETTINGS = ("evidence", "window_frames", "frame_log_density_floor", "prior", "nominal_duration_s")


class GmmSettings(Settings):
    """P1's classifier (P1 III); `ONLINE_SETTINGS` may change on a trained one."""

    n_components: int = setting(40, "Gaussians per class; the published models have 40, P1's text states 20", low=1)
    phase_feature: bool = setting(True, "make the frame number a feature beside the posture, unscaled, as P1 does")
    unwrap_angles: bool = setting(
        False,
        "make every angle of a motion continuous from its first posture on, offline and online; false as the authors, "
        "who used their recordings as they came, with jumps of a whole turn",
    )
    covariance_floor: float = setting(1e-5, "added to the diagonal of every covariance", low=0.0)
    n_phase_frames: int = setting(100, "postures a motion is resampled to; phases run from 0 to one less", low=2)
    seed: int = setting(0, "seed of the k-means seeds; each class draws from its own stream", low=0)
    max_iterations: int = setting(200, "EM stops after so many iterations at the latest", low=1)
    tolerance: float = setting(1e-4, "EM stops when the mean log density of a sample changes by less", low=0.0)
    evidence: Literal["sum", "mean"] = setting(
        "sum",
        "sum adds the log densities of the observed postures (P1 III); mean averages them, as the published code does, "
        "which leaves the decision the same and the posterior much softer",
    )
    window_frames: int | None = setting(
        None, "count only the last so many postures; none counts all; 10 is what the published code did", low=1
    )
    frame_log_density_floor: float | None = setting(
        None, "no posture counts less than this; the published code had -708; none sets no floor"
    )
    prior: Literal["uniform", "frequency"] = setting(
        "uniform", "probability of the classes at first: uniform (P1), or their frequency in the library"
    )
    nominal_duration_s: float | None = setting(
        None, "expected duration of a motion, from which the phase follows; none takes the library's median", unit="s"
    )

    def check(self) -> None:
        if self.nominal_duration_s is not None and not self.nominal_duration_s > 0.0:
            raise SettingsError(
                f"GmmSettings nominal_duration_s: wanted a positive time or none, got {self.nominal_duration_s}"
            )

    @property
    def mixture(self) -> MixtureConfig:
        """The part that concerns fitting one mixture."""
        return MixtureConfig(self.n_components, self.covariance_floor, self.tolerance, self.max_iterations)

    def with_phase(self) -> GmmSettings:
        """Return these settings with the phase as a feature."""
        return self.replaced(phase_feature=True)

    def with_online(self, **changes: Any) -> GmmSettings:
        """Return these settings with some of `ONLINE_SETTINGS` replaced.

        Raises:
            UsageError: a setting that a trained model cannot change any more.
            SettingsError: an impossible value.
        """
        fixed = sorted(set(changes) - set(ONLINE_SETTINGS))
        if fixed:
            raise UsageError(
                f"a trained classifier cannot change {', '.join(fixed)}; it can change {', '.join(ONLINE_SETTINGS)}; "
                "train a new model for anything else"
            )
        return self.replaced(**changes)
