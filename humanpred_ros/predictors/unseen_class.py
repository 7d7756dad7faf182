"""Who claims to predict reaches never seen before is judged on classes it has learned nothing from at all."""

from __future__ import annotations

from functools import cached_property

from humanpred_ros.predictors.folds import FoldSettings, LeaveOneOut
from humanpred_ros.predictors.reach_sources import ReachKnowledge
from humanpred_ros.reaching.places import GoalPlaces, ReachEnd, reach_ends, reaching_for
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor


class UnseenClass(LeaveOneOut):
    """For the predictor that is told places: learns from no motion of the left-out one's class.

    The class's place stands among the others it is told, as a scene would state it: where the other motions of the
    class end. Places stand where the tested people are (`FoldSettings.T_shift`): they are told, not learned.
    """

    learned_from_class = "no"

    def __init__(self, settings: FoldSettings, predictor: str = "reaching") -> None:
        super().__init__(settings, predictor)
        self._knowledge: dict[str, ReachKnowledge] = {}

    def without(self, name: str) -> ReachingPredictor:
        """Return the predictor as if nobody had ever been seen to reach for that motion's place."""
        s = self.settings
        label = _class_of(name)
        if label not in self._knowledge:
            left_out = {end.label for end in self._ends if _class_of(end.name) == label and end.label is not None}
            strayed = reaching_for(self._ends, left_out)
            others = s.library.select(lambda motion: motion.name not in strayed)
            self._knowledge[label] = ReachKnowledge.of_library(others, s.human)
        # The left-out motion has no part in its own class's place.
        goals = GoalPlaces.of_ends(self._ends, without_motion=name).moved(s.T_shift)
        return self._knowledge[label].predictor(s.grid, s.T_world_human, goals)

    @cached_property
    def _ends(self) -> tuple[ReachEnd, ...]:
        return reach_ends(self.settings.library, self.settings.human)


def _class_of(name: str) -> str:
    """Return the class in a motion's name, `class/index`; a motion that nobody learns from is in no library."""
    return name.rpartition("/")[0]
