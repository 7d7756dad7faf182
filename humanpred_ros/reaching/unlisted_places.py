"""Places that are not listed, spread over where hands may go: what "none of the places" means.

A person beside a robot also reaches for what no scene lists. Such a reach goes somewhere, most likely to where people's
hands go at all as seen from the body, which the library shows. A set of unlisted places stands for all of these. What
speaks for a listed place, that the motion so far is a good way to it, speaks for them in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import EndPostures, standing
from humanpred_ros.recognition.reach_features import POINTS, point_links

#: Number of places of each kind, drawn evenly: where people reach most they are less than 0.1 m apart.
N_PLACES = 512
#: Factor on the variance of the reaches seen: people also reach beyond the places that a library shows.
_WIDER = 2.0
#: Least standard deviation, metres: reaches to one place only, or all at one height, say little about others.
_LEAST_M = 0.05
#: Standard deviation in each direction about the shoulder before anything is learned, metres.
_UNLEARNED_M = 0.5
#: After that, one in this many reaches still goes anywhere: to a shelf above the only table seen, or to a fallen tool.
_ANYWHERE = 8
#: The R3 sequence, a golden ratio in three dimensions: its multiples, less whole numbers, fill the unit cube evenly.
_RATIO = 1.0 / 1.22074408460575947536 ** np.arange(1, 4)


@dataclass(frozen=True, eq=False)
class UnlistedPlaces:
    """Places as seen from a body.

    Attributes:
        human: whose body.
        seen_m: (M, 3) from the pelvis, x where it looks, z up; ordered from one side of the body to the other.
        share: (M,) how probable each is before a reach begins, given that it is one of them; positive, with sum 1.

    Raises:
        ArrayError: arrays of another shape, or shares that are not such.
    """

    human: HumanModel
    seen_m: FloatArray
    share: FloatArray

    def __post_init__(self) -> None:
        seen = checked("unlisted places", self.seen_m, ("M", 3))
        share = checked("shares of unlisted places", self.share, (len(seen),))
        if not (share > 0.0).all() or abs(float(share.sum()) - 1.0) > 1e-9:
            raise ArrayError(f"unlisted places: wanted positive shares with sum 1, got a sum of {share.sum()}")
        object.__setattr__(self, "seen_m", frozen(seen))
        object.__setattr__(self, "share", frozen(share))

    @classmethod
    def around_ends(cls, ends: EndPostures) -> UnlistedPlaces:
        """Return places spread about where reaches were seen to end, and farther."""
        reached = ends.seen[:, :3]
        centre = reached.mean(axis=0)
        away = reached - centre
        variance, axes = np.linalg.eigh(_WIDER * away.T @ away / len(away))
        deviation = np.sqrt(np.maximum(variance, _LEAST_M**2))
        # The symmetric root: the signs of the axes, which are arbitrary, do not matter.
        near = _drawn() @ (axes * deviation) @ axes.T
        anywhere = _UNLEARNED_M * _drawn()
        share = np.repeat([1.0 - 1.0 / _ANYWHERE, 1.0 / _ANYWHERE], N_PLACES) / N_PLACES
        return cls._from_side_to_side(ends.human, centre + np.vstack([near, anywhere]), share)

    @classmethod
    def around_shoulder(cls, human: HumanModel) -> UnlistedPlaces:
        """Return places all around the right shoulder, for when no reach was learned from."""
        q = np.clip(np.zeros(len(human.dof_names)), human.lower, human.upper)
        T = standing(human, q)
        shoulder = human.link_poses(q)[point_links(human)[POINTS.index("right_shoulder")], :3, 3]
        places = (shoulder - T[:3, 3]) @ T[:3, :3] + _UNLEARNED_M * _drawn()
        return cls._from_side_to_side(human, places, np.full(N_PLACES, 1.0 / N_PLACES))

    @classmethod
    def _from_side_to_side(cls, human: HumanModel, seen_m: FloatArray, share: FloatArray) -> UnlistedPlaces:
        order = np.argsort(np.arctan2(seen_m[:, 1], seen_m[:, 0]))
        return cls(human, seen_m[order], share[order])

    def around(self, posture: FloatArray) -> FloatArray:
        """Return them (M, 3) in the tracker's frame for a reach that begins in a posture (D,)."""
        T = standing(self.human, posture)
        places: FloatArray = self.seen_m @ T[:3, :3].T + T[:3, 3]
        return places


def evenly_picked(places_m: FloatArray, log_probability: FloatArray, n: int) -> FloatArray:
    """Return n of places (M, 3), each as often as it is probable, as nearly as n allows.

    Nothing is random (systematic resampling), so predictions do not flicker; neighbours in the array should be
    neighbours in space.

    Args:
        places_m: at least one.
        log_probability: (M,) up to a constant.
        n: how many.
    """
    reached = np.cumsum(np.exp(log_probability - log_probability.max()))
    picked: FloatArray = places_m[np.searchsorted(reached, (np.arange(n) + 0.5) / n * reached[-1])]
    return picked


def _drawn() -> FloatArray:
    """Return (N_PLACES, 3) evenly spread standard normal numbers."""
    even = (0.5 + np.arange(1, N_PLACES + 1)[:, None] * _RATIO) % 1.0
    normal = NormalDist()
    return np.array([[normal.inv_cdf(share) for share in row] for row in even.tolist()])
