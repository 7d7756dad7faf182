"""Predictor and planner in one process, for small computers and lossy networks; as two nodes with the same topics.

The planner is handed the occupancies in memory; everyone else gets them over DDS, while somebody listens. Parameters of
one of the two are given with its name: `-p stomp_planner:period_s:=0.2 -p occupancy_predictor:predictor:=current`.
"""

from __future__ import annotations

import sys

from humanpred_ros.errors import UsageError
from humanpred_ros.nodes.base import GraphNode, run_nodes
from humanpred_ros.nodes.in_process import HANDED_OVER
from humanpred_ros.nodes.occupancy_predictor import OccupancyPredictorNode
from humanpred_ros.nodes.stomp_planner import StompPlannerNode


def make_nodes() -> list[GraphNode]:
    """Return the two nodes, linked; the planner, which protects, is the first to be ended.

    Raises:
        UsageError: remapped so that they do not belong together.
    """
    nodes = [StompPlannerNode(), OccupancyPredictorNode()]
    planner, predictor = nodes
    if planner.get_fully_qualified_name() == predictor.get_fully_qualified_name():
        raise UsageError(
            f"__node: wanted two names, got {planner.get_name()} for both; write -r stomp_planner:__node:=NAME"
        )
    for topic in HANDED_OVER:
        names = [node.resolve_topic_name(topic) for node in nodes]
        if len(set(names)) > 1:
            raise UsageError(f"{topic}: wanted one name of it in planner and predictor, got {' and '.join(names)}")
    planner.links = predictor.links = {}
    return nodes


def main() -> None:
    """Run both until a signal, or until one of them ends."""
    sys.exit(run_nodes(make_nodes))


if __name__ == "__main__":
    main()
