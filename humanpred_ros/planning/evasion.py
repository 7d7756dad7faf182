"""Getting out of the person's way when no goal can be worked on: where to, and along which path.

A good place to wait is close by, free of obstacles, and one the person is not likely to come to. Places around the
present configuration, the start and the goals are looked at together; straight lines lead there, cheapest first.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.timing.path import path_integral, straight
from humanpred_ros.planning.tools import Tools
from humanpred_ros.stomp.costs import HumanOccupancyCost, as_batch

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


def ways_aside(
    tools: Tools,
    person: Person,
    human: HumanOccupancyCost,
    q: FloatArray,
    known: FloatArray,
    rng: np.random.Generator,
    count: int = 6,
) -> Iterator[FloatArray]:
    """Yield up to `count` paths (N, D) from `q` (D,) to places the person is not likely to come to, best first.

    Args:
        tools: the arm and its surroundings.
        person, human: the person now.
        q: where the way begins.
        known: (K, D) configurations worth trying besides those drawn: start and goals.
        rng: draws the others.
    """
    chain, separation = tools.chain, tools.config.min_separation_m
    spread = np.resize(np.array(_SPREADS_RAD), _DRAWN)[:, None]
    drawn = np.clip(q + spread * rng.standard_normal((_DRAWN, len(q))), chain.lower, chain.upper)
    places = np.concatenate([known, drawn])
    clearance = np.minimum(person.clearance_m(places), separation + _COMFORT_M)
    here = float(min(person.clearance_m(q[None])[0], separation + _COMFORT_M))
    lines = np.stack([straight(q, place, _LINE) for place in places])
    free = _free(tools, lines) & (clearance >= here + _WORTH_M)
    cost = path_integral(human.evaluate(as_batch(lines))[0].astype(np.float64), lines, tools.weights)
    cost += _LENGTH_WEIGHT * np.linalg.norm((places - q) * tools.weights, axis=1)
    # Far enough before nearly far enough; of those, the cheapest way.
    lacking = np.round((separation + _COMFORT_M - clearance) / 0.01)
    for k in np.lexsort((cost, lacking))[: len(places)]:
        if free[k]:
            yield straight(q, places[k], tools.config.stomp.waypoints)
            count -= 1
            if count == 0:
                return


def _free(tools: Tools, lines: FloatArray) -> NDArray[np.bool_]:
    nearest = tools.obstacles.costs_and_distances(lines)[1]
    free: NDArray[np.bool_] = nearest.min(axis=1) >= tools.config.padding_m
    return free
