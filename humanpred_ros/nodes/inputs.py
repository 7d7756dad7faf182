"""What a node can tell of what came in: how old, how often, how soon answered; and what it refused, by kind."""

from __future__ import annotations

import math
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable

import numpy as np

from humanpred_ros.errors import one_line

#: Rates and latencies are of the last seconds; a refusal counts as recent for so long.
WINDOW_S = 3.0
RECENT_S = 5.0
#: At a higher rate the window is shorter.
_MOST_KEPT = 2048
#: Of the time in which the least delay is looked for, s; how many messages tell something.
_DELAY_S, _DELAYS = 1.0, 3
#: A clock that is farther ahead is named, s: no message comes before it was sent. One behind may be a slow link.
_AHEAD_S, _BEHIND_S = 0.01, 0.25
_NUMBER = re.compile(r"-?\d[\d.]*(e[-+]?\d+)?")


def kind_of(reason: str) -> str:
    """Return what reasons of one kind have in common: what stands before the first colon, numbers left out."""
    return _NUMBER.sub("#", one_line(reason.split(":", 1)[0]))


class Least:
    """The least values of this and of the last window of time.

    Attributes:
        now, before: infinite where there were none.
        n: number of values in `now`.
    """

    def __init__(self, window_s: float) -> None:
        self._window_s, self._began_s = window_s, -math.inf
        self.now = self.before = math.inf
        self.n = 0

    def add(self, value: float, at_s: float) -> None:
        """Add a value at a time of the steady clock, s."""
        if at_s - self._began_s > self._window_s:
            self._began_s, self.before, self.now, self.n = at_s, self.now, math.inf, 0
        self.now = min(self.now, value)
        self.n += 1


class Input:
    """One subscription of a node. Times are on the steady clock, by arrival: stamps and simulated time play no part.

    Of the sender's clock it is known how long the quickest messages took by both clocks: what the way took and the
    difference of the clocks.

    Attributes:
        topic: as subscribed to.
        max_age_s: after a longer silence the node cannot do its work; infinite where it need not come.
        came_s: when the newest message came; None before the first.
        sent_ns: when the one that is being handled was sent, by the sender's clock.
        publishers: tells how many publishers the subscription is matched with.
    """

    def __init__(self, topic: str, max_age_s: float = math.inf) -> None:
        self.topic, self.max_age_s = topic, max_age_s
        self.publishers: Callable[[], int] = lambda: 0
        self.came_s: float | None = None
        self.sent_ns = 0
        self._newest: deque[tuple[float, float]] = deque(maxlen=_MOST_KEPT)
        self._delay = Least(_DELAY_S)
        self._delay_s = 0.0

    def came(self, came_s: float, sent_ns: int, received_ns: int) -> None:
        """Note when a message was sent, by the sender's clock, and received, by this host's; zero is not known."""
        self.sent_ns = sent_ns
        if sent_ns <= 0:
            return
        self._delay.add((received_ns - sent_ns) * 1e-9, came_s)
        if self._delay.n >= _DELAYS:
            # Both windows must show it: what waited, or came while a clock was set, says nothing of clocks.
            both = self._delay.now, self._delay.before
            self._delay_s = min(both) if min(both) >= 0.0 else min(max(both), 0.0)

    def clock(self) -> str:
        """Return by how much the sender's clock differs from this host's; empty where it does not, or is not known."""
        if not math.isfinite(self._delay_s) or -_AHEAD_S <= self._delay_s <= _BEHIND_S:
            return ""
        whose = f"the clock of the host that publishes {self.topic} is {abs(self._delay_s):.2f} s"
        if self._delay_s < 0.0:
            return f"{whose} ahead of this host's"
        return f"{whose} behind this host's, or its messages take so long to come"

    @property
    def clock_off_s(self) -> float:
        """By how much, s; 0 where `clock` is empty."""
        return abs(self._delay_s) if self.clock() else 0.0

    def handled(self, came_s: float, latency_s: float) -> None:
        """Note that a message that came at `came_s` has been answered so long after it was received."""
        self.came_s = came_s
        self._newest.append((came_s, latency_s))

    def silent(self, now_s: float, share: float = 1.0) -> bool:
        """Return whether messages came, but none for longer than a share of the time that is allowed."""
        return self.came_s is not None and now_s - self.came_s > share * self.max_age_s

    def silence(self, share: float = 1.0) -> str:
        """Return what is waited for, in words that stay the same while the silence lasts; `share` as for `silent`."""
        n_publishers = self.publishers()
        if not n_publishers:
            return f"{self.topic}: nobody publishes it"
        whose = "its publisher is" if n_publishers == 1 else f"its {n_publishers} publishers are"
        return f"{self.topic}: {whose} there, but nothing has arrived for longer than {share * self.max_age_s:g} s"

    def facts(self, now_s: float) -> dict[str, str]:
        """Return age, rate, and median and largest latency."""
        if self.came_s is None:
            return {"age_s": "none came"}
        while self._newest and now_s - self._newest[0][0] > WINDOW_S:
            self._newest.popleft()
        facts = {"age_s": f"{now_s - self.came_s:.3f}", "rate_hz": "0.0"}
        newest = list(self._newest)  # another thread may be adding to them
        if newest:
            latencies_ms = 1e3 * np.array([latency_s for _, latency_s in newest])
            span_s = max(now_s - newest[0][0], 1e-9)
            facts["rate_hz"] = f"{(len(newest) - 1) / span_s:.1f}"
            facts["latency_ms"] = f"{np.median(latencies_ms):.2f}"
            facts["latency_largest_ms"] = f"{latencies_ms.max():.2f}"
        if math.isfinite(self._delay_s) and self._delay.n:
            facts["delay_by_clocks_ms"] = f"{1e3 * self._delay_s:.2f}"
        return facts


class Refusals:
    """Counts what was refused, by kind; from any thread.

    Attributes:
        counts: since the node began.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._last_s: dict[str, float] = {}
        self._told: Counter[str] = Counter()
        self._lock = threading.Lock()

    def add(self, reason: str) -> str:
        """Count a refusal; return what there is to say of it: only of a kind that has not come lately."""
        kind, now_s = kind_of(reason), time.monotonic()
        with self._lock:
            new = now_s - self._last_s.get(kind, -math.inf) > RECENT_S
            before = self.counts[kind] - self._told[kind]
            self.counts[kind] += 1
            self._last_s[kind] = now_s
            if not new:
                return ""
            self._told[kind] = self.counts[kind]
        return f"refused {one_line(reason)}" + (f" (after {before} others of this kind, not logged)" if before else "")

    def recent(self) -> bool:
        """Return whether something was refused in the last seconds."""
        with self._lock:
            return time.monotonic() - max(self._last_s.values(), default=-math.inf) <= RECENT_S


class Change:
    """Tells what is worth a line of a log: a kind that is not the last one's, and not one that flickers."""

    def __init__(self) -> None:
        self.kind: object = None
        self._told_s: dict[object, float] = {}

    def to(self, kind: object, now_s: float) -> bool:
        """Return whether this kind is new at `now_s`, on any clock, and was not told within the last second."""
        if kind == self.kind:
            return False
        self.kind = kind
        if abs(now_s - self._told_s.get(kind, -math.inf)) < 1.0:
            return False
        self._told_s[kind] = now_s
        return True
