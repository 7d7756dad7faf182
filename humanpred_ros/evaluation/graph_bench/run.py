"""One run of the real nodes in real time, recorded, with what each of them used."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.graph_bench.usage import NodeUsage, Usage, UsageMeter, usage_of, wait_until_resting
from humanpred_ros.evaluation.processes import NodeGroup, ParameterValue, free_domain_id

_POLL_S = 0.02
_SETTLE_S = 0.3  # the last messages reach the recorder after the tracker has ended
_STARTED = "replay starts"
#: The first start on a machine compiles the kernels.
_READY_LIMIT_S, _REST_LIMIT_S = 180.0, 60.0


@dataclass(frozen=True)
class GraphSetup:
    """What the nodes are started with.

    Attributes:
        scene: YAML file.
        motion: bag with the one motion replayed.
        predictor, planner: further parameters of occupancy_predictor and stomp_planner.
    """

    scene: Path
    motion: Path
    predictor: Mapping[str, ParameterValue]
    planner: Mapping[str, ParameterValue]


@dataclass(frozen=True)
class GraphRun:
    """A finished run.

    Attributes:
        bag: everything recorded.
        planner_started_ns: wall time at which the planner's process was started.
        ready_cpu_s: processor time the planner used until it was ready, if nothing else was starting then, so that
            its time to readiness is its own; None otherwise.
        usage: of each node while postures came.
    """

    bag: Path
    planner_started_ns: int
    ready_cpu_s: float | None
    usage: tuple[NodeUsage, ...]


def run_graph(setup: GraphSetup, folder: Path, *, alone: bool) -> GraphRun:
    """Start the nodes, replay the motion once, end the nodes.

    Args:
        setup: what they are started with.
        folder: new folder for bag and logs.
        alone: start the planner when the others rest, and the tracker when the planner rests; else all at once.

    Raises:
        UsageError: a node that failed, or did not get ready.
    """
    folder.mkdir(parents=True)
    scene = str(setup.scene)
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        group.start("run_recorder", {"output": str(folder / "bag"), "run_info": json.dumps({"bench": "graph"})})
        group.start("simulated_arm", {"scene": scene})
        group.start("occupancy_predictor", {"scene": scene, "listener": "stomp_planner", **setup.predictor})
        if alone:
            wait_until_resting(group.nodes, group.check, _REST_LIMIT_S)
        started_ns = time.time_ns()
        planner = group.start("stomp_planner", {"scene": scene, "controller": "simulated_arm", **setup.planner})
        ready: Usage | None = None
        if alone:
            wait_until_resting(group.nodes, group.check, _REST_LIMIT_S)
            ready = usage_of(planner.process.pid)
        usage = replay(group, setup.motion)
    return GraphRun(folder / "bag", started_ns, ready.cpu_s if ready else None, usage)


def replay(group: NodeGroup, motion: Path) -> tuple[NodeUsage, ...]:
    """Replay the one motion of a bag to the nodes of a group, once they are ready; return what each used meanwhile.

    Raises:
        UsageError: a node that failed, or did not get ready.
    """
    tracker = group.start(
        "skeleton_tracker_replay",
        {
            "library": str(motion.resolve()),
            "trajectory": "0",
            "hold_last_s": 0.0,
            "wait_for": ",".join(node.name for node in group.nodes),
            "listener": "occupancy_predictor",
            "ready_timeout_s": _READY_LIMIT_S,
        },
    )
    meter = UsageMeter(group.nodes)
    begun = False
    while tracker.running:
        group.check()
        begun = begun or _STARTED in tracker.tail()
        if begun:
            meter.note()
        time.sleep(_POLL_S)
    group.check()
    if not begun and _STARTED not in tracker.tail():
        raise UsageError(f"bench: wanted the tracker to start, its log says:\n{tracker.tail()}")
    time.sleep(_SETTLE_S)
    return meter.result()
