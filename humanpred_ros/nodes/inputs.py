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
_NUMBER = re.compile(r"-?\d[\d.]*(e[-+]?\d+)?")


def kind_of(reason: str) -> str:
    """Return what reasons of one kind have in common: what stands before the first colon, numbers left out."""
    return _NUMBER.sub("#", one_line(reason.split(":", 1)[0]))


class Input:
    """One subscription of a node. Times are on the steady clock, by arrival: stamps and simulated time play no part.

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

    def handled(self, came_s: float, latency_s: float) -> None:
        """Note that a message that came at `came_s` has been answered so long after it was received."""
        self.came_s = came_s
        self._newest.append((came_s, latency_s))

    def silent(self, now_s: float) -> bool:
        """Return whether messages came, but none for longer than is allowed."""
        return self.came_s is not None and now_s - self.came_s > self.max_age_s

    def silence(self) -> str:
        """Return what is waited for, in words that stay the same while the silence lasts."""
        n_publishers = self.publishers()
        if not n_publishers:
            return f"{self.topic}: nobody publishes it"
        whose = "its publisher is" if n_publishers == 1 else f"its {n_publishers} publishers are"
        return f"{self.topic}: {whose} there, but nothing has arrived for longer than {self.max_age_s:g} s"

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
