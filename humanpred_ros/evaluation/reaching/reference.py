"""What P2 published of its predicted reaches, and what trivial predictions score on the same recordings.

Joint: centres of pelvis, torso, shoulder, elbow and wrist; task: palm and its orientation, as the authors coded it.
The trivial ones were computed once with other code than this package's (facts section 8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

#: P2's seven demonstrations in its order, by the names of their files.
DEMONSTRATIONS = ("0446-0578", "0525-0657", "0444-0585", "0489-0589", "0780-0871", "1537-1608", "2711-2823")
#: The motion of P2's Table III and Fig. 11, as far as can be told.
INTERFERENCE_CASE = "7395-7595"
#: How near a computed reference value has to be, metres summed over frames.
TOLERANCE_M = 0.05


@dataclass(frozen=True)
class PublishedRow:
    """Averages over the demonstrations, of 10 runs each, as printed in P2.

    Attributes:
        predictor: ours that is made the same way.
        what: the method, in P2's words.
        table: where it stands.
        joint_m, task_as_coded_m: distances.
    """

    predictor: str
    what: str
    table: str
    joint_m: float
    task_as_coded_m: float


#: P2 Table I: weights learned from the demonstration itself; (joint, task as coded) by demonstration.
TABLE1: Mapping[str, tuple[float, float]] = MappingProxyType(
    dict(
        zip(
            DEMONSTRATIONS,
            (
                (33.17, 44.44), (37.20, 53.08), (53.37, 76.26), (20.95, 31.39),
                (21.59, 26.50), (10.12, 23.62), (25.56, 45.69),
            ),
            strict=True,
        )
    )
)  # fmt: skip

PUBLISHED = (
    PublishedRow("own", "own weights", "P2 Table I", 28.85, 42.99),
    PublishedRow("learned", "leave-one-out weights", "P2 Table II", 30.98, 42.18),
    PublishedRow("baseline_0", "baseline 0", "P2 Table II", 34.06, 45.81),
    PublishedRow("baseline_1", "baseline 1", "P2 Table II", 64.96, 57.78),
    PublishedRow("learned_replanned", "leave-one-out weights, re-planned", "P2 Table II", 35.34, 43.56),
    PublishedRow("baseline_0_replanned", "baseline 0, re-planned", "P2 Table II", 39.55, 48.04),
    PublishedRow("baseline_1_replanned", "baseline 1, re-planned", "P2 Table II", 81.01, 63.11),
)
PUBLISHED_INTERFERENCE = (
    PublishedRow("learned", "learned weights", "P2 Table III", 52.89, 49.22),
    PublishedRow("learned_replanned", "learned weights, re-planned", "P2 Table III", 44.91, 36.20),
)

#: (joint, task as coded, task) by demonstration, of the trivial predictors by name.
TRIVIAL: Mapping[str, tuple[tuple[float, float, float], ...]] = MappingProxyType(
    {
        "line": (
            (29.91, 48.78, 25.08), (40.44, 55.15, 27.97), (48.88, 84.05, 44.33), (22.23, 32.44, 16.09),
            (22.99, 27.94, 17.46), (9.44, 24.39, 9.77), (21.81, 47.26, 16.10),
        ),
        "minimum_jerk": (
            (22.75, 45.81, 20.05), (34.49, 54.29, 23.90), (40.60, 78.66, 37.01), (20.26, 31.78, 14.09),
            (19.17, 25.50, 15.26), (7.03, 23.90, 8.28), (17.53, 45.48, 13.93),
        ),
        "itself": (
            (0.0, 31.76, 0.0), (0.0, 32.67, 0.0), (0.0, 29.04, 0.0), (0.0, 23.51, 0.0),
            (0.0, 11.83, 0.0), (0.0, 10.81, 0.0), (0.0, 29.36, 0.0),
        ),
    }
)  # fmt: skip
#: Their means over the seven; of some predictors only these are known.
TRIVIAL_MEANS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "hold": (123.4, 70.63, 74.64),
        "line": (27.96, 45.72, 22.40),
        "cubic": (23.85, 44.17, 19.54),
        "minimum_jerk": (23.12, 43.63, 18.93),
        "time_profile": (24.04, 42.08, 19.16),
        "itself": (0.0, 24.14, 0.0),
    }
)
#: The same on the interference case.
TRIVIAL_INTERFERENCE: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {"line": (69.02, 52.52, 56.92), "minimum_jerk": (53.40, 58.03, 52.75)}
)
