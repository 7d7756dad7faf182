"""The whole chain in one process, without ROS: what a stepped run over DDS must equal bit for bit."""

from __future__ import annotations

from humanpred_ros.motion.motion import Motion
from humanpred_ros.occupancy.predictor import OccupancyPredictor
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.replanner import MultiGoalReplanner
from humanpred_ros.robot.scene import Scene


def run_direct(
    scene: Scene,
    predictor: OccupancyPredictor,
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
    offsets_ns, postures = motion.timeline(n_held)
    predictor.start()
    replanner.start(scene.start, 0.0)
    decisions: list[Decision] = []
    for k, (offset_ns, q) in enumerate(zip(offsets_ns, postures, strict=True)):
        prediction = predictor.update(q, offset_ns * 1e-9)
        occupancy = prediction.occupancy.sparse(threshold)
        if replanner.due(occupancy.t_s):
            decision = replanner.plan(occupancy)
            replanner.commit(decision)
        else:
            decision = replanner.keep(occupancy)
        decisions.append(decision)
        if decision.action == "arrived" and k + 1 >= len(motion):
            break
    return decisions
