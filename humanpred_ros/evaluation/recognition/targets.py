"""What the project wants of recognition, beside what was reached."""

from __future__ import annotations

from collections.abc import Mapping

from humanpred_ros.evaluation.recognition.classifiers import REACHING
from humanpred_ros.evaluation.recognition.scores import CurveFigures
from humanpred_ros.evaluation.target import Target

#: Share of reaches to a place nobody was seen to reach for whose goal is right after 60 % of the motion.
UNSEEN_GOAL_AT_60 = 0.85


def recognition_targets(figures: Mapping[str, CurveFigures]) -> tuple[Target, ...]:
    """Return the targets that these figures, by name of the classifier, can be judged by."""
    if REACHING not in figures:
        return ()
    reached = figures[REACHING].rate_at_60
    return (
        Target(
            what=f"{REACHING}: right goal at 60 %, no motion of its class seen",
            wanted=f"at least {100 * UNSEEN_GOAL_AT_60:.0f} %",
            reached=f"{100 * reached:.1f} %",
            published="",
            met=reached >= UNSEEN_GOAL_AT_60,
        ),
    )
