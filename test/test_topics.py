"""A tracked body's topics are found among others by the same names the nodes use."""

from __future__ import annotations

from humanpred_ros import topics


def test_the_topic_of_the_first_body_is_found() -> None:
    names = [topics.JOINT_STATES, topics.human_joint_states("body_7"), topics.human_joint_states("body_2")]
    assert topics.body_topic(names, topics.human_joint_states) == "/humans/bodies/body_2/joint_states"
    assert topics.body_topic(names, topics.human_urdf) is None
