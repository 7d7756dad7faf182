"""Can the stamp of a posture be believed? Asked of every posture before it is looked at.

A tracker's clock may be ahead or behind, stand still, go back, or not be there. Predictions are stamped as the postures
they follow from, and whoever plans judges their age by that: a stamp that lies makes old data look new.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from humanpred_ros.settings import Settings, setting

#: Nothing usable for so long is told to whoever plans; a single posture that was overtaken on its way is not.
LATE_S = 0.2
#: So many stamps that differ from the clock by the same are a clock that is set otherwise.
_FEW, _MANY, _ALIKE_S = 3, 15, 0.1
#: Postures that come so late, again and again, are worth a warning; whoever plans says from when on they are too old.
_BEHIND_S = 0.25


class StampSettings(Settings):
    """How stamps may differ from each other and from the clock."""

    restart_gap_s: float = setting(1.0, "a longer silence starts a new motion", unit="s", low=0.05, high=60.0)
    max_ahead_s: float = setting(
        0.05, "postures with a stamp farther ahead of the clock are invalid", unit="s", low=0.0, high=10.0
    )


@dataclass(frozen=True)
class StampVerdict:
    """What follows from a posture's stamp."""

    refusal: str = ""  #: why the posture cannot be used, its kind first; empty if it can
    tell: bool = False  #: whether whoever plans must know of the refusal now
    begins: bool = False  #: whether the posture begins a new motion


class StampCheck:
    """Judges the stamps of one stream of postures, one after the other.

    What is refused changes nothing for those that follow. A stream whose stamps go back is taken up again once nothing
    usable has come for `restart_gap_s`; at once where nothing is lost (`lossless`): a replay that is started again does
    not lie.
    """

    def __init__(self, settings: StampSettings | None = None, lossless: bool = False) -> None:
        """Take settings, and whether every posture comes, whatever the clock says (stepped runs)."""
        self.settings, self._lossless = settings or StampSettings(), lossless
        self._last_ns: int | None = None
        self._now_ns = 0
        self._used_s: float | None = None
        self._ahead_s: deque[float] = deque(maxlen=_MANY)

    def judge(self, stamp_ns: int, now_ns: int, arrived_s: float) -> StampVerdict:
        """Return what follows from a stamp.

        Args:
            stamp_ns: of the posture.
            now_ns: the clock's time.
            arrived_s: when the posture came, on a clock that nobody sets.
        """
        back_s, self._now_ns = (self._now_ns - now_ns) * 1e-9, now_ns
        if back_s > 0.0 and not self._lossless:
            self._last_ns = None
            self._ahead_s.clear()
            return StampVerdict(f"clock set back: wanted time that goes on, got {back_s:.3g} s less", tell=True)
        if stamp_ns <= 0:
            return StampVerdict(f"stamp zero: wanted the time of the posture, got {stamp_ns * 1e-9:.9g} s", tell=True)
        ahead_s = (stamp_ns - now_ns) * 1e-9
        self._ahead_s.append(ahead_s)
        if ahead_s > self.settings.max_ahead_s and not self._lossless:
            whose = "the tracker's clock is" if self._constant(_FEW) else "a posture's stamp is"
            return StampVerdict(f"stamp ahead: {whose} {ahead_s:.3g} s ahead of this host's clock", tell=True)
        if self._used_s is None:
            self._used_s = arrived_s
        silent_s, gap_s = arrived_s - self._used_s, self.settings.restart_gap_s
        step_s = None if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        begins = step_s is None or step_s > gap_s
        if step_s is not None and step_s <= 0.0:
            begins = step_s < -gap_s if self._lossless else step_s < 0.0 and silent_s > gap_s
            if not begins:
                what = (
                    "stamp equal: wanted a later one, got that of the posture before"
                    if step_s == 0.0
                    else f"stamp back: wanted a later one, got one {-step_s:.3g} s before that of the posture before"
                )
                return StampVerdict(what, tell=self._lossless or silent_s > LATE_S)
        self._last_ns, self._used_s = stamp_ns, arrived_s
        return StampVerdict(begins=begins)

    def behind(self) -> str:
        """Return that the tracker's clock is behind, and by how much; empty if it is not, or not always the same."""
        late_s = -sum(self._ahead_s) / len(self._ahead_s) if self._ahead_s else 0.0
        if late_s < _BEHIND_S or self._lossless or not self._constant(_MANY):
            return ""
        return f"the tracker's clock is {late_s:.3g} s behind this host's, or its postures take so long to come"

    def _constant(self, n: int) -> bool:
        """Return whether the last n stamps differ from the clock by the same."""
        last = list(self._ahead_s)[-n:]
        return len(last) == n and max(last) - min(last) < _ALIKE_S
