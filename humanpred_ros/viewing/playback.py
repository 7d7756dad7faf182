"""A recorded run, played in 3D in a browser."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from rich.console import Console

from humanpred_ros.bags.messages import ns_from_stamp
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.resources import replacing
from humanpred_ros.settings import setting
from humanpred_ros.viewing.recorded import JointTrack, OccupancySnapshot, RecordedDecision, lines_of
from humanpred_ros.viewing.run import Run, read_run
from humanpred_ros.viewing.space import DRAWN, ServerSettings, SpaceMoment, SpaceView, as_text, served, set_value
from humanpred_ros.viewing.strip import LASTS_S, SAMPLE_S
from humanpred_ros.viewing.workcell import Workcell, load_workcell

T = TypeVar("T", OccupancySnapshot, RecordedDecision, "RecordedLines")
_FRAME_S = 1.0 / 20.0
_PATH_STEP_S = 0.1
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")


class ViewSettings(ServerSettings):
    """Settings of `humanpred view`."""

    run: Path = setting(..., "folder of the run", positional=True)
    out: Path | None = setting(None, "HTML file to write instead, which plays by itself, without a server or a network")
    namespace: str | None = setting(None, "of the robot, as /robot1; only needed where the bag holds several")


class RecordedLines(NamedTuple):
    """Lines for people to see: as in `SpaceMoment.lines`."""

    t_s: float
    ends_m: FloatArray
    colours: FloatArray


class Recording:
    """A run as moments."""

    def __init__(self, run: Run, workcell: Workcell, namespace: str | None = None) -> None:
        """Take a run, where it was recorded, and in which namespace.

        Raises:
            UsageError: nobody knows the scene, or nothing was recorded.
        """
        if workcell.scene is None:
            raise UsageError(f"{run.folder}: wanted a run whose scene is known; {'; '.join(workcell.notes)}")
        if run.duration_s <= 0.0:
            raise UsageError(f"{run.folder}: wanted a run with people, decisions or an arm in it; it has none")
        self.run, self.workcell, self.scene, self.namespace = run, workcell, workcell.scene, namespace
        self.human = workcell.human or HumanModel.kinect12()

    @cached_property
    def occupancies(self) -> Sequence[OccupancySnapshot]:
        """Those that were kept, by time."""
        both = {snapshot.t_s: snapshot for snapshot in (*self.run.occupancy.samples, *self.run.occupancy.snapshots)}
        return [both[t_s] for t_s in sorted(both)]

    @cached_property
    def lines(self) -> Mapping[str, Sequence[RecordedLines]]:
        """Of each layer of lines what was recorded, by time; none unless markers were."""
        bag = BagReader(self.run.folder / "bag", self.namespace)
        return {layer: list(self._lines(bag, topic)) for layer, topic in DRAWN.items() if bag.find(topic)}

    def _lines(self, bag: BagReader, topic: str) -> Iterator[RecordedLines]:
        for _, message in bag.decoded(topic):
            stamps = [ns_from_stamp(marker.header.stamp) for marker in message.markers]
            if any(stamps):  # the first of an array that removes others has none
                yield RecordedLines(1e-9 * (max(stamps) - self.run.origin_ns), *lines_of(message))

    @cached_property
    def turns(self) -> list[tuple[float, str]]:
        """When the arm chose another task, or began to hold: times and what happened."""
        found = []
        before: RecordedDecision | None = None
        for decision in self.run.decisions:
            if decision.switched:
                found.append((decision.t_s, f"turns to {decision.chosen}"))
            elif decision.action == "hold" and (before is None or before.action != "hold"):
                found.append((decision.t_s, f"holds: {decision.reason}"))
            before = decision
        return found

    def at(self, t_s: float) -> SpaceMoment:
        """Return what there was at a time of the run."""
        run = self.run
        occupancy = _latest(self.occupancies, t_s)
        decision = _latest(run.decisions, t_s)
        begun = [track for track in run.trajectories if len(track) and track.t_s[0] <= t_s]
        q_goal = path = None
        if begun and begun[-1].t_s[-1] > t_s:
            track = begun[-1]
            q_goal = track.q[-1]
            times = np.arange(t_s, track.t_s[-1] + _PATH_STEP_S, _PATH_STEP_S).clip(max=track.t_s[-1])
            path = self.workcell.tool_path(track.at(times))
        return SpaceMoment(
            t_s,
            q_arm=_row(run.robot, t_s),
            q_goal=q_goal,
            tool_path_m=path,
            bodies={"": q} if (q := _row(run.postures, t_s)) is not None else {},
            lines={
                layer: (drawn.ends_m, drawn.colours)
                for layer, all_ in self.lines.items()
                if (drawn := _latest(all_, t_s))
            },
            posterior=self._posterior(t_s),
            decision=decision,
            centres_m=np.zeros((0, 3)) if occupancy is None else occupancy.centres_m,
            probability=np.zeros(0) if occupancy is None else occupancy.probability,
        )

    def _posterior(self, t_s: float) -> dict[str, float]:
        said = self.run.posterior
        k = int(np.searchsorted(said.t_s, t_s + 1e-9, side="right")) - 1
        if k < 0:
            return {}
        by_class = {str(label): float(p) for label, p in zip(said.labels, said.probability[k], strict=True)}
        return {**by_class, "none of these": float(said.unknown[k])}


def view(settings: ViewSettings, console: Console) -> int:
    """Play a recorded run in 3D in a browser, until Ctrl-C, or write it as one HTML file."""
    with console.status("reading the run"):
        run = read_run(settings.run, settings.namespace)
        recording = Recording(run, load_workcell(run), settings.namespace)
    if settings.out is not None:
        from humanpred_ros.viewing.replay import replay_page

        with replacing(settings.out) as part:
            part.write_text(replay_page(recording), encoding="utf-8")
        console.print(f"replay  {settings.out}")
        return 0
    with served(settings, lambda text: console.print(text, highlight=False)) as server:
        Player(SpaceView(server, recording.scene, recording.human), recording).run(threading.Event())
    return 0


class Player:
    """Controls of a recording's page: time, pace, and where something happened."""

    def __init__(self, view: SpaceView, recording: Recording) -> None:
        self._view, self._recording = view, recording
        end_s = recording.run.duration_s
        gui = view.server.gui
        with gui.add_folder("time", order=-1.0):
            self.slider = gui.add_slider("s", 0.0, round(end_s, 2), 0.01, 0.0)
            self.playing = gui.add_checkbox("play", True)
            self.pace = gui.add_dropdown("times as fast", _SPEEDS, initial_value="1")
            self.happened = gui.add_markdown("")
            turns = gui.add_button_group("switch or hold", ("back", "next"))
            step = gui.add_button_group("one frame", ("back", "next"))
        step.on_click(lambda _: self._go(self.slider.value + _FRAME_S * (1 if step.value == "next" else -1)))
        turns.on_click(lambda _: self._jump(str(turns.value)))

    def run(self, ended: threading.Event) -> None:
        """Show moment after moment until told to end."""
        shown_s = -1.0
        while not ended.wait(_FRAME_S):
            if self.playing.value:
                next_s = self.slider.value + _FRAME_S * float(self.pace.value)
                set_value(self.slider, 0.0 if self.slider.value >= self.slider.max else min(next_s, self.slider.max))
            if self.slider.value != shown_s:
                now_s = float(self.slider.value)
                if not 0.0 <= now_s - shown_s < SAMPLE_S:  # a jump: the charts show what was before
                    for t_s in np.arange(max(0.0, now_s - LASTS_S), now_s, SAMPLE_S):
                        self._view.recall(self._recording.at(float(t_s)))
                shown_s = now_s
                self._view.show(self._recording.at(shown_s))

    def _go(self, t_s: float) -> None:
        set_value(self.playing, False)
        set_value(self.slider, round(min(max(t_s, 0.0), self.slider.max), 2))

    def _jump(self, way: str) -> None:
        now_s = float(self.slider.value)
        later = [turn for turn in self._recording.turns if turn[0] > now_s + 1e-3]
        earlier = [turn for turn in self._recording.turns if turn[0] < now_s - 1e-3]
        turn = (later[:1] if way == "next" else earlier[-1:]) or [(now_s, "nothing more happens there")]
        self._go(turn[0][0])
        self.happened.content = as_text(turn[0][1])


def _latest(entries: Sequence[T], t_s: float) -> T | None:
    k = bisect_right(entries, t_s + 1e-9, key=lambda entry: entry.t_s)
    return entries[k - 1] if k else None


def _row(track: JointTrack, t_s: float) -> FloatArray | None:
    if not len(track):
        return None
    row = track.at(np.array([np.clip(t_s, track.t_s[0], track.t_s[-1])]))[0]
    return row if np.isfinite(row).all() else None
