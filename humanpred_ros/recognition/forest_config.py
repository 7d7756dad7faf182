"""One place for the settings of the reach forest, shared by training, the model file and the node."""

from __future__ import annotations

from dataclasses import dataclass

from humanpred_ros.errors import UsageError


@dataclass(frozen=True)
class ForestConfig:
    """The default classifier: randomised trees over `reach_features`, calibrated, with a probability of no class.

    Attributes:
        n_trees: more are slower and never worse.
        motion_share: share of the motions each tree learns from. The others are its test: without them neither
            calibration nor the probability of no class could be learned from the library alone.
        min_samples_leaf: postures in a leaf, at least.
        n_postures: postures each motion contributes, evenly spaced.
        unknown_prior: how often a reach is of no class, before anything is seen. A judgement, not learned: a library
            does not show what it lacks.
        seed: of motions and splits drawn.
    """

    n_trees: int = 100
    motion_share: float = 0.632
    min_samples_leaf: int = 3
    n_postures: int = 50
    unknown_prior: float = 0.2
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value, least in (
            ("n_trees", self.n_trees, 1),
            ("min_samples_leaf", self.min_samples_leaf, 1),
            ("n_postures", self.n_postures, 2),
            ("seed", self.seed, 0),
        ):
            if value < least:
                raise UsageError(f"reach forest: wanted {name} of at least {least}, got {value}")
        if not 0 < self.motion_share < 1:
            raise UsageError(f"reach forest: wanted motion_share between 0 and 1, got {self.motion_share}")
        if not 0 < self.unknown_prior < 1:
            raise UsageError(f"reach forest: wanted unknown_prior between 0 and 1, got {self.unknown_prior}")
