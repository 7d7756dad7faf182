"""One run of `humanpred bench link`: tracker and predictor on one host, planner and arm on the other.

A program of its own, in namespaces of its own: `python -m` takes the run as JSON and prints what happened as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation.bench_nodes import replay
from humanpred_ros.evaluation.processes import NodeGroup, ends_with_parent
from link.hosts import TwoHosts

#: Where people are seen, and where the arm is.
SEEING, MOVING = 0, 1
#: The networks are this process's own: any domain is free.
_DOMAIN = 1


@dataclass(frozen=True)
class LinkRun:
    """What is run."""

    folder: str  #: new, for logs and bag
    scene: str
    model: str
    motion: str  #: bag with the one motion
    loss: float
    delay_s: float
    down_after_s: float  #: from the replay's start
    down_s: float
    recorder: int  #: on which host
    planner: dict[str, Any]  #: parameters
    copies: int  #: of each occupancy
    profile: str  #: file of Fast DDS; empty: none


def carried_out(run: LinkRun) -> dict[str, Any]:
    """Return the wall times at which things were done, ns (None where they were not), and what the link carried.

    Raises:
        UsageError: a node that failed, or did not get ready.
    """
    folder = Path(run.folder)
    times: dict[str, int] = {}
    began_s = 0.0
    environment = {"FASTRTPS_DEFAULT_PROFILES_FILE": run.profile} if run.profile else {}
    with TwoHosts(run.loss, run.delay_s, environment) as hosts, NodeGroup(folder / "logs", _DOMAIN) as group:
        seeing, moving = hosts.on(SEEING), hosts.on(MOVING)
        times["started"] = time.time_ns()
        group.start(
            "run_recorder",
            {"output": str(folder / "bag"), "stay": False, "run_info": json.dumps({"bench": "link"})},
            within=hosts.on(run.recorder),
        )
        group.start("simulated_arm", {"scene": run.scene}, within=moving)
        group.start(
            "occupancy_predictor",
            {"scene": run.scene, "model": run.model, "listener": "stomp_planner", "copies": run.copies},
            within=seeing,
        )
        planner = {"scene": run.scene, "controller": "simulated_arm", **run.planner}
        group.start("stomp_planner", planner, within=moving)

        def follow() -> None:
            nonlocal began_s
            if not began_s:
                began_s, times["replay"] = time.monotonic(), time.time_ns()
                before[:] = hosts.passed
            elapsed_s = time.monotonic() - began_s
            if run.down_s and elapsed_s >= run.down_after_s and "down" not in times:
                hosts.up, times["down"] = False, time.time_ns()
            if not hosts.up and elapsed_s >= run.down_after_s + run.down_s:
                hosts.up, times["back"] = True, time.time_ns()

        before = list(hosts.passed)
        usage = replay(group, Path(run.motion), within=seeing, meanwhile=follow)
        elapsed_s = time.monotonic() - began_s
        passed = [(after - first) / elapsed_s for after, first in zip(hosts.passed, before, strict=True)]
    return {"times": times, "bytes_per_s": passed, "usage": [node._asdict() for node in usage]}


def main() -> int:
    """Carry out the run given as the only argument."""
    ends_with_parent()
    try:
        print(json.dumps(carried_out(LinkRun(**json.loads(sys.argv[1])))))
    except HumanPredError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def as_argument(run: LinkRun) -> str:
    """Return the run as the program takes it."""
    return json.dumps(asdict(run))


if __name__ == "__main__":
    sys.exit(main())
