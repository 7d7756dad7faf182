"""What a path may use of a joint's limits at each place, while something else moves the joint too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.timing.averaged_profile import SMOOTHING_S
from humanpred_ros.planning.timing.coming_to_rest import ComingToRest

#: Shares of the limits that planned motion uses; the rest is for rounding off and interpolating.
USED_V, USED_A = 0.98, 0.95
#: Share of the acceleration limit used where the path could not be entered as fast as the robot moves otherwise:
#: what brakes already with the usual share needs it, and a little more for rounding.
USED_A_AT_MOST = 0.985


@dataclass(frozen=True)
class State:
    """State at the switch and limits, each (D,)."""

    v: FloatArray
    a: FloatArray
    v_limit: FloatArray
    a_limit: FloatArray


@dataclass
class PathLimits:
    """Limits (NODES, D) that the path may use at each node."""

    v_low: FloatArray
    v_high: FloatArray
    a_low: FloatArray
    a_high: FloatArray

    @classmethod
    def beside(
        cls,
        fading: ComingToRest | None,
        state: State,
        node_t_s: FloatArray,
        slower: FloatArray,
        used_a: float = USED_A,
    ) -> PathLimits:
        """Return what a fading leftover leaves of the limits, if nodes are passed at `node_t_s`."""
        a_limit = used_a * state.a_limit * slower[:, None]
        # A speed that is within the limits may be kept at first.
        lasts = fading.duration_s + SMOOTHING_S if fading else 0.0
        share = np.where(node_t_s <= lasts, 1.0, USED_V)
        v_limit = (share * np.sqrt(slower))[:, None] * state.v_limit
        if fading is None:
            return cls(-v_limit, v_limit, -a_limit, a_limit)
        # What the path does at a node is averaged over the time after it.
        moments = np.stack([node_t_s + part * SMOOTHING_S for part in (0.0, 0.5, 1.0)])
        _, v, a = fading.at(moments.ravel())
        v, a = v.reshape(3, *a_limit.shape), a.reshape(3, *a_limit.shape)
        some_v, some_a = 0.05 * v_limit, 0.03 * state.a_limit
        return cls(
            np.minimum(-v_limit - v.min(axis=0), -some_v),
            np.maximum(v_limit - v.max(axis=0), some_v),
            np.minimum(-a_limit - a.min(axis=0), -some_a),
            np.maximum(a_limit - a.max(axis=0), some_a),
        )
