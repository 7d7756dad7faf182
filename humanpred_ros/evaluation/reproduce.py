"""Does a fresh planner, fed the recorded occupancy, decide as it did in the recorded run?"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humanpred_ros import topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import BagError, HumanPredError
from humanpred_ros.evaluation.processes import NodeGroup, free_domain_id
from humanpred_ros.files import json_of
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.plugins import given_settings, parameters_of
from humanpred_ros.robot.scene_file import recorded_scene

#: Facts of a decision that depend on the machine, not on the input.
_MACHINE_FACTS = {"compute_ms"}


@dataclass(frozen=True)
class Comparison:
    """Decisions and trajectories of two runs, matched by stamp."""

    n_decisions: int  #: how many the first run has
    n_trajectories: int
    differing: tuple[str, ...]  #: what differs, in words, in time order; empty if the second run reproduces the first


def replay_run(folder: Path, out: Path, namespace: str | None = None) -> Comparison:
    """Feed the occupancy of the run in `folder` to a fresh planner, record to the bag `out`, and compare.

    Raises:
        HumanPredError: no complete run in `folder`, `out` exists, or a node failed.
    """
    recorded = BagReader(folder / "bag", namespace)
    info = recorded.metadata.get("run")
    if info is None:
        raise BagError(f"{folder / 'bag'}: wanted a bag made by `humanpred demo`, this one has no record named run")
    planner = planner_parameters(folder, info)
    with NodeGroup(out.parent / f"{out.name}_logs", free_domain_id()) as group:
        group.start(
            "run_recorder",
            {
                "output": str(out),
                "stay": False,
                "run_info": json.dumps(dict(info)),
                "wait_for": f"{topics.OCCUPANCY},{topics.DECISION}",
            },
        )
        group.start(
            "stomp_planner",
            {**planner, "use_sim_time": True, "lossless": True, "listener": "occupancy_replay"},
        )
        source = group.start(
            "occupancy_replay",
            {
                "bag": str(folder / "bag"),
                "bag_namespace": namespace or "",
                "wait_for": "run_recorder,stomp_planner",
            },
        )
        group.wait_for(source)
    return compare_bags(recorded, BagReader(out))


def planner_parameters(folder: Path, info: Mapping[str, str]) -> dict[str, Any]:
    """Return what the planner of a recorded run was told, as the run's facts say; refused before any node starts."""
    terms = tuple(info.get("cost_terms", " ".join(ReplannerConfig().cost_terms)).split())
    try:
        told = json_of(info.get("set", "[]"))
        if not isinstance(told, list) or not all(isinstance(word, str) for word in told):
            raise ValueError("wanted a list of texts in `set`")
        given = parameters_of(given_settings(told), terms)
        config = ReplannerConfig(period_s=float(info["period_s"]), seed=int(info["seed"]), cost_terms=terms)
    except (KeyError, ValueError, OverflowError, HumanPredError) as trouble:
        raise BagError(
            f"{folder / 'bag'}: the run's facts cannot be used ({type(trouble).__name__}: {trouble})"
        ) from None
    scene = recorded_scene(folder, info.get("scene", ""))
    return {
        "scene": scene, "period_s": config.period_s, "seed": config.seed, "cost_terms": list(config.cost_terms), **given
    }  # fmt: skip


def compare_bags(first: BagReader, second: BagReader) -> Comparison:
    """Compare decisions and trajectories bit for bit; what only the machine's speed decides is left out."""
    differing: list[str] = []
    counts = []
    for topic, facts in ((topics.DECISION, _decision_facts), (topics.TRAJECTORY, _trajectory_facts)):
        a, b = ({stamp: facts(m) for stamp, m in _by_stamp(bag, topic)} for bag in (first, second))
        counts.append(len(a))
        for stamp in sorted(a.keys() | b.keys()):
            if a.get(stamp) != b.get(stamp):
                differing.append(f"{topic} at {stamp} ns: {_first_difference(a.get(stamp), b.get(stamp))}")
    return Comparison(counts[0], counts[1], tuple(differing))


def _by_stamp(bag: BagReader, topic: str) -> list[tuple[int, Any]]:
    messages = [message for _, message in bag.decoded(topic)]
    return [(m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec, m) for m in messages]


def _decision_facts(message: Any) -> list[tuple[str, str, dict[str, str]]]:
    return [
        (s.name, s.message, {v.key: v.value for v in s.values if v.key not in _MACHINE_FACTS}) for s in message.status
    ]


def _trajectory_facts(message: Any) -> list[tuple[str, Any]]:
    return [("joints", tuple(message.joint_names))] + [
        (
            f"point {k}",
            (
                point.time_from_start.sec,
                point.time_from_start.nanosec,
                tuple(point.positions),
                tuple(point.velocities),
                tuple(point.accelerations),
            ),
        )
        for k, point in enumerate(message.points)
    ]


def _first_difference(a: list[Any] | None, b: list[Any] | None) -> str:
    if a is None or b is None:
        return "only in the second run" if a is None else "only in the first run"
    for x, y in zip(a, b, strict=False):
        if x != y:
            return f"{x!r:.200} became {y!r:.200}"
    return f"{len(a)} parts became {len(b)}"
