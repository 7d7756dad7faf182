"""Tells which nodes of this package are running on a ROS domain; `python -m` prints their names."""

from __future__ import annotations

import time

import rclpy
from rclpy.node import Node

from humanpred_ros.nodes.base import name_of
from humanpred_ros.nodes.parameters import parameters_of_nodes

#: Most nodes are heard of at once, some after seconds: discovery repeats itself every 3 s where its words got lost.
_LOOK_AROUND_S, _POLL_S = 10.0, 0.05


def running(node: Node) -> list[str]:
    """Return the names of this package's nodes that a node has heard of, as they are called on /diagnostics."""
    ours = parameters_of_nodes().keys()
    found = node.get_node_names_and_namespaces()
    return sorted(name_of(namespace, name) for name, namespace in found if name in ours)


def print_running() -> None:
    """Look around for some seconds, or until somebody is found."""
    rclpy.init()
    node = rclpy.create_node("humanpred_looks_around")
    until_s = time.monotonic() + _LOOK_AROUND_S
    while not (found := running(node)) and time.monotonic() < until_s:
        time.sleep(_POLL_S)
    print(", ".join(found))
    rclpy.shutdown()


if __name__ == "__main__":
    print_running()
