"""Does the predictor's node keep up with a sensor? Measured over DDS, with the node held to one core.

A person reaches and draws back without end, 30 postures a second, while the node publishes occupancies. A recorder, a
process of its own, hears both.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros import topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.bench_nodes import (
    RATE_HZ,
    PostureAnswer,
    posture_answers,
    replay,
    write_motion,
    write_scene_for,
)
from humanpred_ros.evaluation.occupancy_scores import P1_RESOLUTION_M, grid_around
from humanpred_ros.evaluation.processes import NodeGroup, ParameterValue, free_domain_id
from humanpred_ros.evaluation.timing import Spread
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel, human_named, name_of_human
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.reaching.places import Places, reach_ends
from humanpred_ros.reaching.reaching_predictor import ReachKnowledge
from humanpred_ros.recognition.training import TrainedModel, save_model, train_model
from humanpred_ros.robot.scene import load_scene

#: The predictor that is told places, and how many.
TOLD, PLACES = "reaching", 8
_NODE = "occupancy_predictor"
#: Places so close to each other that few can be ruled out before the hand arrives: the most there is to do.
_APART_M = 0.02
#: Where a library shows fewer places than are told, it is told the same ones again, so much higher.
_HIGHER_M = 0.05
#: Length of a run, and of its beginning that does not count: caches, and what is compiled at its first use.
_SECONDS, _SETTLING_S = 12.0, 2.0


@dataclass(frozen=True, eq=False)
class People:
    """A library in two parts, and what is learned from the first."""

    human_name: str  #: whose postures these are
    training: MotionLibrary  #: what is learned from
    played: tuple[Motion, ...]  #: what is played

    @classmethod
    def of(cls, library: MotionLibrary, n_played: int) -> People:
        """Play the first motions of the first class; of a library without classes the first ones, at most half.

        Raises:
            HumanModelError: a library of no human there is.
            LibraryFormatError: nothing is left to learn from.
        """
        name = name_of_human(library.dof_names)
        some = library.of_class(library.labels[0]) if library.labels else library.motions[: len(library) // 2]
        played = {motion.name for motion in some[:n_played]}
        training = library.select(lambda motion: motion.name not in played)
        return cls(name, training, some[:n_played])

    @cached_property
    def human(self) -> HumanModel:
        """The human of that name."""
        return human_named(self.human_name)

    @cached_property
    def model(self) -> TrainedModel | None:
        """The trained model; None without classes."""
        return train_model(self.training, self.human) if self.training.labels else None

    @cached_property
    def knowledge(self) -> ReachKnowledge:
        """What `reaching` learned, as the node learns it."""
        if self.model is not None:
            return ReachKnowledge.of_model(self.model, self.human)
        return ReachKnowledge.of_library(self.training, self.human)

    def grid(self, resolution_m: float = P1_RESOLUTION_M) -> VoxelGrid:
        """Return a grid of P1's size around them."""
        return grid_around(self.training, self.human, resolution_m)

    def places(self, count: int) -> Places:
        """Return `count` places in their frame: of the classes, or where each motion ended if there are none."""
        ends = reach_ends(self.training, self.human)
        shown = Places.of_ends(ends).places_m if self.training.labels else np.array([end.place_m for end in ends])
        k = np.arange(count)
        higher = np.outer(k // len(shown), (0.0, 0.0, _HIGHER_M))
        return Places(tuple(k.tolist()), shown[k % len(shown)] + higher)


def measure_node(people: People, predictor: str, folder: Path) -> dict[str, Any]:
    """Play the first played motion to the node, back and forth, and return the figures.

    Args:
        people: who reach.
        predictor: `reaching` is told `PLACES` places.
        folder: new folder for model, bag and logs.

    Raises:
        UsageError: a node that failed, or published next to nothing.
        HumanPredError: a library that the node cannot use.
    """
    folder.mkdir(parents=True)
    scene = write_scene_for(folder / "scene.yaml", people.training).resolve()
    places = {"places": _entries(people, scene)} if predictor == TOLD else {}
    parameters: dict[str, ParameterValue] = {
        "scene": str(scene),
        "predictor": predictor,
        "human": people.human_name,
        "listener": "run_recorder",
        **places,
    }
    if people.model is not None:
        save_model(people.model, folder / "model.npz")
        parameters["model"] = str((folder / "model.npz").resolve())
    else:
        parameters["library"] = str(write_library_bag(people.training, folder / "library").resolve())
    motion = write_motion(folder / "back_and_forth", people.training, people.played[0], _SECONDS)
    wait_for = f"{topics.human_joint_states('<id>')},{topics.OCCUPANCY}"
    info = json.dumps({"bench": "predictor"})
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        group.start(
            "run_recorder", {"output": str(folder / "bag"), "stay": False, "run_info": info, "wait_for": wait_for}
        )
        node = group.start(_NODE, parameters)
        hold_to_one_core(node.process.pid)
        usage = replay(group, motion)
        cores = cores_of(node.process.pid)
    answers = settled(posture_answers(BagReader(folder / "bag")))
    median_hz, slow_hz = rates_hz(answers)
    delay = Spread.of([answer.delay_ms for answer in answers if answer.heard_ns is not None])
    return {
        "human": people.human_name,
        "predictor": predictor,
        "places": PLACES if places else None,
        "sent_hz": RATE_HZ,
        "median_hz": median_hz,
        "slow_hz": slow_hz,
        "delay_ms": delay,
        "postures": len(answers),
        "skipped": len(answers) - delay.n,
        "cpu_percent": next((entry.cpu_percent for entry in usage if entry.node == _NODE), float("nan")),
        "cores": cores,
    }


def settled(answers: Sequence[PostureAnswer]) -> Sequence[PostureAnswer]:
    """Return the answers to all postures but those of the beginning."""
    begin_ns = min(answer.stamp_ns for answer in answers) + round(_SETTLING_S * 1e9)
    return [answer for answer in answers if answer.stamp_ns >= begin_ns]


def rates_hz(answers: Sequence[PostureAnswer]) -> tuple[float, float]:
    """Return occupancies a second, from the time between one and the next: median and 1st percentile.

    Raises:
        UsageError: fewer than two occupancies.
    """
    heard_s = np.sort([answer.heard_ns * 1e-9 for answer in answers if answer.heard_ns is not None])
    if len(heard_s) < 2:
        raise UsageError(
            f"bench predictor: wanted occupancies of {len(answers)} postures, got {len(heard_s)}; is the machine busy?"
        )
    median, slow = 1.0 / np.quantile(np.diff(heard_s), (0.5, 0.99))
    return float(median), float(slow)


def hold_to_one_core(pid: int) -> None:
    """Let a process that has just started, and every thread it is going to start, use the last core of ours only.

    Where the system has no such thing nothing happens; `cores_of` tells.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(pid, {max(os.sched_getaffinity(0))})


def cores_of(pid: int) -> int | None:
    """Return how many cores the threads of a process may use together; None if it has ended or nobody can say."""
    if not hasattr(os, "sched_getaffinity"):
        return None
    try:
        threads = [int(thread.name) for thread in Path(f"/proc/{pid}/task").iterdir()]
        return len(set().union(*(os.sched_getaffinity(thread) for thread in threads)))
    except OSError:
        return None


def _entries(people: People, scene: Path) -> list[str]:
    """Return places around where the played motion goes, as the node's parameter wants them."""
    higher = np.outer(np.arange(PLACES), (0.0, 0.0, _APART_M))
    places_m = people.places(1).moved(load_scene(scene).T_world_human).places_m + higher
    return [f"{label} {x!r} {y!r} {z!r}" for label, (x, y, z) in enumerate(places_m.tolist())]
