"""Topics are found by the same relative names the nodes use: a body's among others, a robot's in a bag."""

from __future__ import annotations

import pytest

from humanpred_ros import topics
from humanpred_ros.errors import BagError

OURS = [topics.OCCUPANCY, topics.VOXEL_GRID, topics.JOINT_STATES, topics.DECISION]
POSTURES = topics.human_joint_states("body_7")


def test_the_topic_of_the_first_body_is_found() -> None:
    names = [topics.JOINT_STATES, topics.human_joint_states("body_7"), topics.human_joint_states("body_2")]
    assert topics.body_topic(names, topics.human_joint_states) == "humans/bodies/body_2/joint_states"
    assert topics.body_topic(names, topics.human_urdf) is None


@pytest.mark.parametrize("namespace", ["", "/robot1", "/cell/robot1"])
def test_names_in_a_bag_are_found_by_their_endings(namespace: str) -> None:
    bag = [f"{namespace}/{name}" for name in (*OURS, POSTURES)] + [topics.CLOCK, topics.DIAGNOSTICS]
    names = topics.names_in_bag(bag, {})
    assert {name: names[name] for name in (*OURS, POSTURES)} == dict(zip((*OURS, POSTURES), bag, strict=False))
    assert topics.names_in_bag(bag, {}, namespace) == names


def test_of_several_robots_one_must_be_named() -> None:
    bag = [f"/{robot}/{name}" for robot in ("a", "b") for name in OURS] + [f"/people/{POSTURES}"]
    with pytest.raises(BagError, match=r"the bag has /a, /b; name one"):
        topics.names_in_bag(bag, {})
    with pytest.raises(BagError, match=r"wanted one of those in the bag, /a, /b, got /c"):
        topics.names_in_bag(bag, {}, "/c")
    names = topics.names_in_bag(bag, {}, "/b")
    assert names[topics.JOINT_STATES] == "/b/joint_states"
    assert names[POSTURES] == f"/people/{POSTURES}"  # which both share


def test_joint_states_of_people_are_not_the_arms() -> None:
    assert topics.JOINT_STATES not in topics.names_in_bag([f"/{POSTURES}", "/human_occupancy"], {})
    # Two grippers, and no arm: neither is it.
    assert topics.JOINT_STATES not in topics.names_in_bag(["/left/joint_states", "/right/joint_states"], {})


def test_what_the_recorder_wrote_counts_for_more_than_endings() -> None:
    bag = ["/ur5/joint_trajectory", "/cell/joint_states", "/other/joint_states"]
    told = {topics.TRAJECTORY: "/ur5/joint_trajectory", topics.JOINT_STATES: "/other/joint_states", "x": "/absent"}
    assert topics.names_in_bag(bag, told) == {k: told[k] for k in (topics.TRAJECTORY, topics.JOINT_STATES)}
