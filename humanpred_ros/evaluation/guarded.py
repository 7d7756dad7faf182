"""The arm beside a recorded person and a separation guard, which knows nothing of plans: it slows and stops the arm."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.planning.decision import ARRIVED, Decision
from humanpred_ros.planning.pace import Pace
from humanpred_ros.planning.protective_distance import ProtectiveDistance, SeenBody, SpeedFactor
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.robot.scene import Scene

#: So long the person has been in the first posture when a run begins, s: the guard has made up its mind.
_BEFORE_S = 4.0
_STOP = "separation guard: the person is too close"


def drive_guarded(
    replanner: Replanner, scene: Scene, human: HumanModel, motion: Motion, occupancies: Iterable[Occupancy], n_held: int
) -> tuple[list[Decision], Pace]:
    """Let the arm work as `simulation.drive` does, while a guard with default settings looks at every posture.

    A factor counts from the posture on that it follows from. After a stop the arm is planned for again, from where it
    stands, as soon as it may move.

    Args:
        replanner: told to start anew.
        scene, human, motion: who and where.
        occupancies: one for each posture.
        n_held: how often the last posture is repeated at the end.

    Returns:
        The decisions, stops of the guard's among them, and the pace of the controller's time.
    """
    protective = ProtectiveDistance(human, scene.arm, scene.T_world_human)
    body, speed = SeenBody(), SpeedFactor(protective.settings)

    def wanted(q_person: np.ndarray, t_s: float, q: np.ndarray, v: np.ndarray) -> float:
        body.see(q_person, t_s)
        return speed.follow(protective.separation([body], q, v, speed.factor).factor, t_s)

    postures, rest = motion.timeline(n_held)[1], np.zeros(len(scene.start))
    for t_s in np.arange(-_BEFORE_S, 0.0, motion.period_s):
        wanted(postures[0], float(t_s), scene.start, rest)
    replanner.set_factor(1.0, 0.0)
    replanner.start(scene.start, 0.0)
    decisions: list[Decision] = []
    changes = list(replanner.pace.changes)
    for k, (occupancy, q_person) in enumerate(zip(occupancies, postures, strict=False)):
        t_s = occupancy.t_s
        q, v, _ = replanner.state_at(t_s)
        factor = wanted(q_person, t_s, q, v)
        stop = replanner.set_factor(factor, t_s, "" if factor else _STOP)
        if replanner.pace.changes[-1] != changes[-1]:
            changes.append(replanner.pace.changes[-1])
        if stop is not None:
            decisions.append(stop)
        elif factor and replanner.lost:
            replanner.regain(q, t_s)
        decisions.append(replanner.respond(occupancy))
        if decisions[-1].action == ARRIVED and k + 1 >= len(motion):
            break
    replanner.set_factor(1.0, t_s)  # for whoever has it next
    return decisions, Pace(tuple(changes))
