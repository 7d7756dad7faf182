"""Prints what a latched topic of texts holds, such as a running robot's description, and ends.

It is a process of its own for whatever reads a robot's file, a program without ROS or a node that cannot wait for a
message of its own. The exit status is 2, and what is printed the reason, if nothing comes.
"""

from __future__ import annotations

import os
import sys
import time

import rclpy
from std_msgs.msg import String

from humanpred_ros.nodes import qos

#: As long as a robot's driver takes to start.
PATIENCE_S = 20.0
#: The variable of the environment that says another patience, s.
PATIENCE = "HUMANPRED_DESCRIPTION_PATIENCE_S"
_TYPE = "std_msgs/msg/String"


def main() -> int:
    """Print the text of the topic that is the first argument."""
    topic, patience_s = sys.argv[1], float(os.environ.get(PATIENCE, PATIENCE_S))
    rclpy.init(args=[])
    node = rclpy.create_node("humanpred_description", use_global_arguments=False)
    texts: list[str] = []

    def received(message: String) -> None:
        texts.append(message.data)

    node.create_subscription(String, topic, received, qos.LATCHED)
    print(f"waiting for {topic} ({_TYPE}, latched)", file=sys.stderr, flush=True)
    end_s = time.monotonic() + patience_s
    while not texts and time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.2)
    others = sorted(name for name, types in node.get_topic_names_and_types() if _TYPE in types and name != topic)
    rclpy.shutdown()
    if texts:
        print(texts[0])
        return 0
    there = f"topics of texts that are published: {', '.join(others)}" if others else "no topic of texts is published"
    print(
        f"wanted a text on {topic} ({_TYPE}, latched), got none in {patience_s:.0f} s; {there}; start "
        "robot_state_publisher, check ROS_DOMAIN_ID, or name a file"
    )
    return 2


if __name__ == "__main__":
    sys.exit(main())
