"""The settings of the default classifier, shared by training, the model file and the node."""

from __future__ import annotations

from humanpred_ros.errors import SettingsError
from humanpred_ros.settings import Settings, setting


class ForestSettings(Settings):
    """The default classifier: randomised trees over `reach_features`, calibrated, with a probability of no class."""

    n_trees: int = setting(100, "number of trees; more are slower and not worse", low=1)
    motion_share: float = setting(
        0.632,
        "share of the motions each tree learns from; the others are its test, from which calibration and the "
        "probability of no class are learned",
        low=0.0,
        high=1.0,
    )
    min_samples_leaf: int = setting(3, "postures in a leaf, at least", low=1)
    n_postures: int = setting(50, "postures each motion contributes, evenly spaced", low=2)
    unknown_prior: float = setting(
        0.2,
        "how often a reach is of no class, before anything is seen; a judgement, because a library does not show what "
        "it lacks",
        low=0.0,
        high=1.0,
    )
    seed: int = setting(0, "seed of the motions and splits drawn", low=0)

    def check(self) -> None:
        for name in ("motion_share", "unknown_prior"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise SettingsError(
                    f"ForestSettings {name}: wanted a number between 0 and 1, got {getattr(self, name)}"
                )
