"""What the arm does when no goal can be worked on: go on, wait where it is, or move out of the person's way.

A good place to wait is close by, free of obstacles, and one the person is not likely to come to. Places around the
present configuration, the start and the goals are compared; straight lines lead there, cheapest first.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.decision import EVADE, HOLD, KEEP, Decision
from humanpred_ros.planning.path import path_integral, straight
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.problem import Problem
from humanpred_ros.planning.step import Step
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.stomp.costs import HumanOccupancyCost, as_batch

#: A new way aside must keep this much more distance than the one the robot is on, m.
_BETTER_GAP_M = 0.02
#: Configurations drawn around the present one, with these standard deviations in turn, rad.
_DRAWN, _SPREADS_RAD = 240, (0.15, 0.3, 0.6, 1.0)
#: Waypoints of a line that is looked at.
_LINE = 16
#: Clearance beyond the separation that makes a place as good as any farther away, m.
_COMFORT_M = 0.05
#: A place that is still too close is worth going to if it is better by this, m.
_WORTH_M = 0.02
#: What a unit of configuration distance counts against human cost: time matters more than on the way to a goal.
_LENGTH_WEIGHT = 0.2


def wait(step: Step, reason: str) -> Decision:
    """Go on with what is being executed if it still can be; else wait, aside if the person comes here."""
    state, person, chosen = step.state, step.person, step.state.chosen
    under_way = state.leads_to is not None and step.executing.end_s > step.t_switch_s and not step.disabled(chosen)
    if under_way and not (step.trouble(step.executing) or person.rest_conflict(step.executing.q[-1])):
        return step.decision(KEEP, reason + "; what is being executed still can", chosen)
    stop = None
    if not state.held and (step.v.any() or step.a.any()):
        stop = step.problem.stopped(step.executing, step.t_switch_s, state.pace.factor)
    comes = person.rest_conflict(step.q if stop is None else stop.q[-1])
    too_close = stop is not None and _gap_m(step, stop) < step.problem.config.min_separation_m
    why = comes or ("stopping alone would come too close to the person" if too_close else "")
    if not (why or step.moving_aside):
        return step.decision(HOLD, reason, chosen, stop)
    trajectory = _way_aside(step, None if comes else stop)
    if trajectory is None or trajectory is stop:
        return step.decision(HOLD, f"{why or 'nowhere to go'}; {reason}", chosen, stop)
    if trajectory is step.executing:
        return step.decision(KEEP, f"on its way aside; {reason}", chosen)
    return step.decision(EVADE, f"{why or 'a better way aside'}; {reason}", chosen, trajectory)


def ways_aside(
    problem: Problem,
    person: Person,
    human: HumanOccupancyCost,
    q: FloatArray,
    known: FloatArray,
    rng: np.random.Generator,
    count: int = 6,
) -> Iterator[FloatArray]:
    """Yield up to `count` paths (N, D) from `q` (D,) to places the person is not likely to come to, best first.

    Args:
        problem: the arm and its surroundings.
        person, human: the person now.
        q: where the way begins.
        known: (K, D) configurations worth trying besides those drawn: start and goals.
        rng: draws the others.
    """
    chain, cfg = problem.chain, problem.config
    spread = np.resize(np.array(_SPREADS_RAD), _DRAWN)[:, None]
    drawn = np.clip(q + spread * rng.standard_normal((_DRAWN, len(q))), chain.lower, chain.upper)
    places = np.concatenate([known, drawn])
    enough = cfg.min_separation_m + _COMFORT_M
    clearance = np.minimum(person.likely_gap_m(places), enough)
    here = float(min(person.likely_gap_m(q[None])[0], enough))
    lines = np.stack([straight(q, place, _LINE) for place in places])
    free = problem.obstacles.costs_and_distances(lines)[1].min(axis=1) >= cfg.padding_m
    free &= clearance >= here + _WORTH_M
    cost = path_integral(human.evaluate(as_batch(lines))[0].astype(np.float64), lines, problem.weights)
    cost += _LENGTH_WEIGHT * np.linalg.norm((places - q) * problem.weights, axis=1)
    # Far enough before nearly far enough; of those, the cheapest way.
    lacking = np.round((enough - clearance) / 0.01)
    order = [k for k in np.lexsort((cost, lacking)) if free[k]]
    for k in order[:count]:
        yield straight(q, places[k], cfg.stomp.waypoints)


def _way_aside(step: Step, stop: TimedTrajectory | None) -> TimedTrajectory | None:
    """Return the way out of the person's way that keeps the largest distance from them, up to the separation.

    If the robot is on such a way already, or could simply `stop`, that is what it does unless another keeps a
    clearly larger one.
    """
    state, problem, executing = step.state, step.problem, step.executing
    known = np.concatenate(list(state.goals.values()))
    rng = np.random.default_rng(np.random.SeedSequence((problem.config.seed, state.step, len(state.goals))))
    best = stop
    if step.moving_aside and not (
        step.person.rest_conflict(executing.q[-1]) or problem.not_free(executing, step.t_switch_s)
    ):
        best = executing
    best_gap = -np.inf if best is None else _gap_m(step, best) + _BETTER_GAP_M
    for path in ways_aside(problem, step.person, step.human, step.q, known, rng):
        if best_gap >= problem.config.min_separation_m:
            break
        trajectory = step.timed(path)
        gap = _gap_m(step, trajectory)
        if gap > best_gap and not problem.not_free(trajectory, step.t_switch_s):
            best, best_gap = trajectory, gap
    return best


def _gap_m(step: Step, trajectory: TimedTrajectory) -> float:
    return step.person.least_gap_m(trajectory, step.t_switch_s)
