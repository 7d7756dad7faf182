"""The whole chain in one process, without ROS: what a stepped run over DDS must equal bit for bit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from numpy.typing import ArrayLike

from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.motion.motion import Motion
from humanpred_ros.occupancy.predictor import Predictor
from humanpred_ros.planning.decision import ARRIVED, Decision
from humanpred_ros.planning.replanner import MultiGoalReplanner
from humanpred_ros.robot.scene import Scene


def run_direct(
    scene: Scene,
    predictor: Predictor,
    replanner: MultiGoalReplanner,
    motion: Motion,
    threshold: float,
    n_held: int = 0,
) -> list[Decision]:
    """Let the human make `motion` and the arm work; return one decision per posture.

    Args:
        scene: where the arm starts.
        predictor: told to start anew.
        replanner: told to start anew at the scene's start configuration.
        motion: DoFs in the predictor's order.
        threshold: voxels at or below this probability do not reach the planner, as over DDS.
        n_held: how often the last posture is repeated at the end, at the motion's median period; the run
            ends earlier when the arm has arrived.
    """
    return drive(replanner, scene.start, predicted(predictor, motion, threshold, n_held), len(motion))


def predicted(predictor: Predictor, motion: Motion, threshold: float, n_held: int = 0) -> Iterator[Occupancy]:
    """Yield the occupancy that reaches the planner after each posture; arguments as for `run_direct`."""
    offsets_ns, postures = motion.timeline(n_held)
    predictor.start()
    for offset_ns, q in zip(offsets_ns, postures, strict=True):
        yield predictor.update(q, offset_ns * 1e-9).occupancy.sparse(threshold)


def drive(
    replanner: MultiGoalReplanner,
    q_start: ArrayLike,
    occupancies: Iterable[Occupancy],
    n_least: int = 0,
    begin_s: float = 0.0,
) -> list[Decision]:
    """Let the arm work while occupancies come in; return one decision for each.

    Args:
        replanner: told to start anew.
        q_start: (D,) where the arm rests at first.
        occupancies: by ascending stamp.
        n_least: so many are answered even if the arm arrives before; after that, arriving ends the run.
        begin_s: since when the arm rests; the first step is due one period later.
    """
    replanner.start(q_start, begin_s)
    decisions: list[Decision] = []
    for occupancy in occupancies:
        decision = replanner.respond(occupancy)
        decisions.append(decision)
        if decision.action == ARRIVED and len(decisions) >= n_least:
            break
    return decisions
