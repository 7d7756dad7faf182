"""Places in a parameter or a scene become places in the tracker's frame, or the reason why they cannot."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import UsageError
from humanpred_ros.reaching.reach_goals import goals_from_text, goals_of_scene
from humanpred_ros.robot.scene import Place, load_scene

SCENE = load_scene("four_places")


def test_places_are_brought_into_the_trackers_frame() -> None:
    told = [Place(3, np.array([-0.22, -0.67, 0.8])), Place(12, np.array([0.0, 0.5, 1.0]))]
    by_text = goals_from_text(["3 -0.22 -0.67 0.80", "  12   0 .5 1e0 "], SCENE.T_world_human)
    by_scene = goals_of_scene({goal.label: goal.place_m for goal in told}, SCENE.T_world_human)
    for goals in (by_text, by_scene):
        assert goals is not None
        assert goals.labels == (3, 12)
        in_world = goals.moved(SCENE.T_world_human).places_m
        np.testing.assert_allclose(in_world, [goal.place_m for goal in told], atol=1e-12)


def test_no_places_are_none() -> None:
    assert goals_of_scene({}, SCENE.T_world_human) is None
    for entries in ([], [""], [" ", ""]):
        assert goals_from_text(entries, SCENE.T_world_human) is None


@pytest.mark.parametrize(
    "entry", ["3", "3 0.1 0.2", "3 0.1 0.2 0.3 0.4", "cup 0.1 0.2 0.3", "3.5 0.1 0.2 0.3", "3 a b c", "3 0.1 nan 0.3"]
)
def test_an_entry_that_says_something_else_is_refused_with_what_was_wanted(entry: str) -> None:
    with pytest.raises(UsageError, match=r"wanted 'label x y z'.* as in '3 -0\.22 -0\.67 0\.80', got"):
        goals_from_text(["1 0 0 1", entry], SCENE.T_world_human)


def test_a_label_stands_for_one_place() -> None:
    with pytest.raises(UsageError, match="every label once, got 3"):
        goals_from_text(["3 0 0 1", "3 0 0.5 1"], SCENE.T_world_human)
