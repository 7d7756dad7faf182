"""What a planner knows of people: how old it is, and whether an occupancy may be believed."""

from __future__ import annotations

import time
from collections.abc import Callable

from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.nodes.planner_settings import StompPlannerSettings


class SeenPeople:
    """Ages are measured on a clock that nobody sets; in stepped runs they mean nothing.

    Attributes:
        settings: may be replaced.
        clock: tells by how much the clock of whoever publishes occupancies differs; empty where it does not.
        silence: tells why no occupancy comes; empty while they come.
        true_s: when what is known of people was true, on the steady clock.
        refusal: why the newest occupancy was refused; empty if it was not.
    """

    def __init__(self, settings: StompPlannerSettings) -> None:
        self.settings, self.true_s, self.refusal = settings, time.monotonic(), ""
        self.clock: Callable[[], str] = str
        self.silence: Callable[[], str] = str
        self._somebody = False

    def ahead(self, age_s: float) -> str:
        """Return why an occupancy so old is one from a future that no clock allows; empty if it is not."""
        if self.settings.lossless or -age_s <= self.settings.max_ahead_s:
            return ""
        reason = f"stamp ahead: the human data's stamps are {-age_s:.3g} s ahead of this host's clock, at most"
        return f"{reason} {self.settings.max_ahead_s:g} s are allowed{_and(self.clock())}"

    def stale(self, age_s: float) -> str:
        """Return why an occupancy so old says nothing of now; empty if it does."""
        if self.settings.lossless or age_s <= self.settings.max_human_age_s:
            return ""
        reason = f"stale human data: {age_s:.2f} s old, at most {self.settings.max_human_age_s:g} s allowed"
        return f"{reason}{_and(self.clock())}"

    def vanished(self, occupancy: Occupancy, says_nobody: bool) -> str:
        """Return why an empty occupancy does not mean that nobody is there; empty if it does, or is not empty."""
        if occupancy.probability.any():
            self._somebody = True
        elif says_nobody:
            self._somebody = False
        return (
            "empty occupancy: people were there, and nobody said that they have left"
            if self._somebody and not occupancy.probability.any()
            else ""
        )

    def believe(self, age_s: float) -> None:
        """Take note that an occupancy so old is planned with."""
        self.true_s, self.refusal = time.monotonic() - max(age_s, 0.0), ""

    def overdue(self, now_s: float) -> str:
        """Return why what is known of people is too old on the steady clock; empty if it is not."""
        age_s = now_s - self.true_s
        if age_s <= self.settings.max_human_age_s:
            return ""
        why = f" ({self.refusal})" if self.refusal else _and(self.silence())
        return f"stale human data: what is known of people is {age_s:.2f} s old{why}"


def _and(text: str) -> str:
    return f"; {text}" if text else ""
