"""Does the predictor's node keep up with a sensor? Measured over DDS, with the node held to one core.

A person reaches and draws back without end, 30 postures a second, while the node publishes occupancies. A recorder, a
process of its own, hears both.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from humanpred_ros import topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.graph_bench.input import RATE_HZ, write_motion, write_scene_for
from humanpred_ros.evaluation.graph_bench.latency import Delays, PostureAnswer, posture_answers
from humanpred_ros.evaluation.graph_bench.run import replay
from humanpred_ros.evaluation.graph_bench.usage import NodeUsage
from humanpred_ros.evaluation.predictor_bench.one_core import cores_of, hold_to_one_core
from humanpred_ros.evaluation.predictor_bench.people import People
from humanpred_ros.evaluation.processes import NodeGroup, ParameterValue, free_domain_id
from humanpred_ros.evaluation.target import Target
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.plugins import DEFAULT_PREDICTOR
from humanpred_ros.recognition.model_file import save_model
from humanpred_ros.robot.scene import load_scene

#: Promised: occupancies a second that `reaching` publishes at least, with so many places, on one core.
TARGET_HZ = 5.0
PLACES = 8
_NODE, _TOLD = "occupancy_predictor", "reaching"
#: Places so close to each other that few can be ruled out before the hand arrives: the most there is to do.
_APART_M = 0.02
#: Length of a run, and of its beginning that does not count: caches, and what is compiled at its first use.
_SECONDS, _SETTLING_S = 12.0, 2.0


@dataclass(frozen=True)
class NodeResult:
    """One run of the node.

    Attributes:
        human, predictor: names.
        places: that the predictor was told; None for one that is told none.
        sent_hz: postures a second.
        median_hz, slow_hz: occupancies a second, from the time between one and the next: median and 1st percentile.
        delay: from a posture's publication to the receipt of its occupancy.
        postures: how many came.
        skipped: of these, had no occupancy: a newer one overtook them.
        cpu_percent: mean processor time of the node, percent of a core; NaN where the system does not tell.
        cores: how many the node's threads could use; None where the system does not tell.
    """

    human: str
    predictor: str
    places: int | None
    sent_hz: float
    median_hz: float
    slow_hz: float
    delay: Delays
    postures: int
    skipped: int
    cpu_percent: float
    cores: int | None

    @property
    def target(self) -> Target | None:
        """Whether the promised rate was held nearly always; None for predictors of which nothing is promised."""
        if self.predictor != _TOLD:
            return None
        where = "one core" if self.cores == 1 else "any number of cores, as this system holds no process to one"
        return Target(
            what=f"occupancies a second over DDS, {self.human}, {self.places} places, on {where} (1st percentile)",
            wanted=f">= {TARGET_HZ:.0f}",
            reached=f"{self.slow_hz:.1f}",
            published="",
            met=self.slow_hz >= TARGET_HZ,
        )


def bench_nodes(everybody: Sequence[People], folder: Path, report: Callable[[str], None]) -> Iterator[NodeResult]:
    """Run the node with `reaching` and, where there are classes, with the default predictor beside it.

    Args:
        everybody: who reaches.
        folder: new folder for models, bags and logs.
        report: told what is measured next.

    Raises:
        HumanPredError: a node that failed, or said nothing.
    """
    for people in everybody:
        for predictor in (DEFAULT_PREDICTOR, _TOLD) if people.training.labels else (_TOLD,):
            report(f"the node over DDS, {people.human_name}, {predictor}")
            yield run_node(people, predictor, folder / f"{people.human_name}_{predictor}")


def run_node(people: People, predictor: str, folder: Path) -> NodeResult:
    """Play the first played motion to the node, back and forth; errors as `bench_nodes`."""
    folder.mkdir(parents=True)
    scene = write_scene_for(folder / "scene.yaml", people.training).resolve()
    told = predictor == _TOLD
    parameters: dict[str, ParameterValue] = {
        "scene": str(scene),
        "predictor": predictor,
        "human": people.human_name,
        "listener": "run_recorder",
        **({"places": _entries(people, scene)} if told else {}),
        **_learned(people, folder),
    }
    motion = write_motion(folder / "back_and_forth", people.training, people.played[0], _SECONDS)
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        group.start(
            "run_recorder",
            {
                "output": str(folder / "bag"),
                "run_info": json.dumps({"bench": "predictor"}),
                "wait_for": f"{topics.human_joint_states('<id>')},{topics.OCCUPANCY}",
            },
        )
        node = group.start(_NODE, parameters)
        hold_to_one_core(node.process.pid)
        usage = replay(group, motion)
        cores = cores_of(node.process.pid)
    return _result(people, predictor, PLACES if told else None, folder / "bag", usage, cores)


def _result(
    people: People, predictor: str, places: int | None, bag: Path, usage: Sequence[NodeUsage], cores: int | None
) -> NodeResult:
    answers = settled(posture_answers(BagReader(bag)))
    median_hz, slow_hz = rates_hz(answers)
    delay = Delays.of([answer.delay_s for answer in answers if answer.heard_ns is not None])
    return NodeResult(
        human=people.human_name,
        predictor=predictor,
        places=places,
        sent_hz=RATE_HZ,
        median_hz=median_hz,
        slow_hz=slow_hz,
        delay=delay,
        postures=len(answers),
        skipped=len(answers) - delay.n,
        cpu_percent=next((entry.cpu_percent for entry in usage if entry.node == _NODE), float("nan")),
        cores=cores,
    )


def settled(answers: Sequence[PostureAnswer]) -> Sequence[PostureAnswer]:
    """Return the answers to all postures but those of the beginning."""
    begin_ns = min(answer.stamp_ns for answer in answers) + round(_SETTLING_S * 1e9)
    return [answer for answer in answers if answer.stamp_ns >= begin_ns]


def rates_hz(answers: Sequence[PostureAnswer]) -> tuple[float, float]:
    """Return occupancies a second: median and 1st percentile.

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


def _learned(people: People, folder: Path) -> dict[str, ParameterValue]:
    """Write what the node learned from, and return the parameter that says where it is."""
    if people.model is not None:
        save_model(people.model, folder / "model.npz")
        return {"model": str((folder / "model.npz").resolve())}
    return {"library": str(write_library_bag(people.training, folder / "library").resolve())}


def _entries(people: People, scene: Path) -> list[str]:
    """Return places around where the played motion goes, as the node's parameter wants them."""
    higher = np.outer(np.arange(PLACES), (0.0, 0.0, _APART_M))
    goals = people.places(1).moved(load_scene(scene).T_world_human).places_m + higher
    return [f"{label} {x!r} {y!r} {z!r}" for label, (x, y, z) in enumerate(goals.tolist())]
