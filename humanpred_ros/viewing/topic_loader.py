"""Reads topics of a run's bag, tolerating what a run can lack, and notes what it had to leave out."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros.bags.reader import BagReader
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.viewing import run_topics as topics


class Entry(NamedTuple):
    """A decoded message with its data time (header stamp) and the time it was sent."""

    stamp_ns: int
    sent_ns: int
    message: Any


@dataclass(frozen=True)
class RunClock:
    """Turns stamps into seconds after the run's origin."""

    origin_ns: int

    def seconds(self, stamp_ns: int) -> float:
        """Return the run time of a stamp."""
        return (stamp_ns - self.origin_ns) * 1e-9

    def times(self, entries: Iterable[Entry]) -> FloatArray:
        """Return the run times (N,) of entries."""
        return np.array([self.seconds(entry.stamp_ns) for entry in entries], dtype=np.float64)


class EvenSample:
    """Picks, of messages that come with rising stamps, those that lie evenly in time: the first one at every due time.

    Clouds are large, so which are kept must be known before they are read.
    """

    def __init__(self, due_ns: Iterable[int]) -> None:
        self._due_ns = sorted(due_ns)
        self._n_past = 0

    def takes(self, stamp_ns: int) -> bool:
        """Return whether the message with this stamp is one of them; ask for each once, in order."""
        n_past = bisect_right(self._due_ns, stamp_ns)
        taken, self._n_past = n_past > self._n_past, n_past
        return taken


class TopicLoader:
    """Decodes topics of one bag and notes what it had to leave out."""

    def __init__(self, reader: BagReader) -> None:
        self.reader = reader
        self.notes: list[str] = []

    def stamped(
        self,
        topic: str | None,
        msgtype: str,
        *,
        monotone: bool = True,
        reduce: Callable[[int, Any], Any] | None = None,
    ) -> list[Entry]:
        """Return the topic's messages in the order they were logged; none if the bag lacks it.

        Args:
            topic: name.
            msgtype: the type it must have (BagError otherwise).
            monotone: keep only messages whose stamps exceed all earlier ones.
            reduce: what to keep of a message, given its stamp; the message itself if None.
        """
        if topic is None or topic not in self.reader.topics:
            return []
        self.reader.require_topic(topic, msgtype)
        entries: list[Entry] = []
        backwards, last_ns = 0, -1
        for record in self.reader.messages([topic]):
            message = self.reader.decode(record)
            stamp = topics.stamp_ns(message)
            if monotone and stamp <= last_ns:
                backwards += stamp < last_ns  # equal stamps say the same thing twice: nothing to report
                continue
            last_ns = stamp
            entries.append(Entry(stamp, record.publish_time_ns, reduce(stamp, message) if reduce else message))
        if backwards:
            self.notes.append(f"{topic}: {backwards} messages with stamps older than earlier ones were left out")
        return entries

    def text(self, topic: str | None) -> str:
        """Return the first text of a String topic, empty if there is none."""
        texts = self.reader.decoded(topic) if topic is not None else iter(())
        return next((str(message.data) for _, message in texts), "")

    def grid(self) -> VoxelGrid | None:
        """Return the recorded voxel lattice."""
        text = self.text(topics.VOXEL_GRID if topics.VOXEL_GRID in self.reader.topics else None)
        return topics.grid_of(text) if text else None
