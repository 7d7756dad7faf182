"""Predictor and planner on two hosts, over a link that delays, loses, and is down for a while.

Tracker and predictor are on one host, planner and arm on the other; the hosts are network namespaces of this machine
(`two_hosts`), whose link drops frames of 1500 bytes at random, both ways. Every posture is expected to be answered by a
decision, and a replanning step to be taken every period, but for the time in which the link is down and half a second
after; then a hold and work again are asked for.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from humanpred_ros import topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.bench_nodes import RATE_HZ, skipped_steps, write_motion, write_scene
from humanpred_ros.evaluation.checkout_benches import AGAIN_S, LinkBenchSettings
from humanpred_ros.evaluation.framework import Begin, Column, Report, Table, present
from humanpred_ros.evaluation.timing import MachineLoad, Spread
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.planning.decision import ARRIVED, HOLD
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.training import model_of
from humanpred_ros.resources import locate, share_file
from humanpred_ros.viewing.recorded import decision_of
from humanpred_ros.viewing.run import occupancies, stamped
from link.hosts import PRIVATE, missing
from link.run import MOVING, SEEING, LinkRun, as_argument

_LIBRARY, _MOTION, _GOALS = "synthetic_reaches", "3/2", 2
#: So slow that the arm does not arrive meanwhile; few iterations: it is the link that is measured.
_VELOCITY_SCALE, _ITERATIONS = 0.1, 20
PROFILE = "fastdds_lossy_link.xml"
_RECORDER = {"planner": MOVING, "predictor": SEEING}


def run(settings: LinkBenchSettings, console: Console) -> int:
    """Measure, print and write."""
    return present(settings, console, measure)


def measure(settings: LinkBenchSettings, begin: Begin) -> Report:
    """Run the graph on two hosts with every loss.

    Raises:
        UsageError: no two hosts can be made here, a folder to keep that exists, or a node that failed.
    """
    why = missing()
    if why:
        raise UsageError(f"bench link: {why}")
    if settings.keep is not None and settings.keep.exists():
        raise UsageError(f"--keep: wanted a folder that does not exist yet, {settings.keep} does; choose another")
    load = MachineLoad()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (settings.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        results = _results(settings, folder, begin)
    return Report(
        f"Two hosts, {settings.delay_ms:g} ms apart; {RATE_HZ:.0f} postures a second for {settings.seconds:g} s, "
        f"replanning every {1e3 * settings.period:.0f} ms",
        (_answers(results), _outages(settings, results), _costs(results)),
        {"rate_hz": RATE_HZ, "results": results, "other_cores": load.other_cores()},
        load.notes(),
    )


def _results(settings: LinkBenchSettings, folder: Path, begin: Begin) -> list[dict[str, Any]]:
    library = load_library(locate(_LIBRARY, "bags"))
    model = model_of(library, HumanModel.kinect12(), {DEFAULT_CLASSIFIER: None})
    motion = write_motion(folder / "motion", library, library.find(_MOTION), settings.seconds)
    scene = write_scene(folder / "scene.yaml", _GOALS)
    results: list[dict[str, Any]] = []
    advance = begin("runs", len(settings.loss) * len(settings.recorder))
    for loss in settings.loss:
        for recorder in settings.recorder:
            run = LinkRun(
                str(folder / f"{loss:g}_{recorder}"), str(scene), str(model), str(motion), loss,
                1e-3 * settings.delay_ms, settings.seconds / 3.0, settings.down, _RECORDER[recorder],
                {
                    "period_s": settings.period, "velocity_scale": _VELOCITY_SCALE, "iterations": _ITERATIONS,
                },
                settings.copies,
                str(share_file("config", PROFILE)) if settings.profile else "",
            )  # fmt: skip
            done = subprocess.run(
                [*PRIVATE, sys.executable, "-m", "link.run", as_argument(run)],
                cwd=Path(__file__).resolve().parents[1],
                stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
            )  # fmt: skip
            if done.returncode:
                raise UsageError(f"bench link: {done.stderr.strip() or f'a run ended with {done.returncode}'}")
            carried = json.loads(done.stdout.splitlines()[-1])
            found = answered(Path(run.folder) / "bag", settings.period, carried["times"])
            results.append({"loss": loss, "recorder": recorder, **found, **carried})
            advance(len(results))
    return results


def answered(bag: Path, period_s: float, times: Mapping[str, int]) -> dict[str, Any]:
    """Return the figures of one run.

    Args:
        bag: of the run, in real time on one clock.
        period_s: of a replanning step.
        times: wall times, ns: `down` and `back`, of the link, may be missing.

    Raises:
        BagError: no postures, or a damaged bag.
    """
    reader = BagReader(bag)
    postures = list(stamped(reader, topics.body_topic(reader.names, topics.human_joint_states)))
    first_ns, last_ns = postures[0].stamp_ns, postures[-1].stamp_ns
    down_ns = times.get("down", last_ns + 1)
    again_ns = times.get("back", last_ns) + round(1e9 * AGAIN_S)

    def counts(stamp_ns: int) -> bool:
        # What is on its way when the link goes down is lost, too.
        return first_ns <= stamp_ns <= last_ns and not down_ns - 1e8 < stamp_ns < again_ns

    expected = [
        stamp for k in range(round((last_ns - first_ns) * 1e-9 * RATE_HZ) + 1)
        if counts(stamp := first_ns + round(k * 1e9 / RATE_HZ))
    ]  # fmt: skip
    decided = [
        (entry, decision_of(entry.message, 0.0, 0.0)) for entry in stamped(reader, topics.DECISION)
        if entry.sent_ns >= first_ns
    ]  # fmt: skip
    useful = [(entry, decision) for entry, decision in decided if decision.action != HOLD and counts(entry.stamp_ns)]
    sent = {entry.stamp_ns for entry in occupancies(reader) if counts(entry.stamp_ns)}
    arrived_ns = next((entry.stamp_ns for entry, decision in decided if decision.action == ARRIVED), last_ns)
    steps_s = [e.stamp_ns * 1e-9 for e, decision in useful if decision.is_step and e.stamp_ns <= arrived_ns]
    before = [t_s for t_s in steps_s if t_s < down_ns * 1e-9]
    skipped = sum(skipped_steps(part, period_s) for part in (before, steps_s[len(before) :]))
    result: dict[str, Any] = {
        "postures": len(expected),
        "answered": len({entry.stamp_ns for entry, _ in useful}) / len(expected),
        "occupancies_recorded": len(sent) / len(expected),
        "steps": len(steps_s),
        "steps_answered": len(steps_s) / max(len(steps_s) + skipped, 1),
        "answer_ms": Spread.of([(entry.sent_ns - entry.stamp_ns) * 1e-6 for entry, _ in useful]),
        "holds": sum(decision.action == HOLD and counts(entry.sent_ns) for entry, decision in decided),
        "ready_s": (times["replay"] - times["started"]) * 1e-9 if "replay" in times else math.nan,
        "hold_s": math.nan, "hold": "", "again_s": math.nan,
    }  # fmt: skip
    if "back" in times:
        hold = next((pair for pair in decided if pair[0].sent_ns > down_ns and pair[1].action == HOLD), None)
        if hold is not None:
            result |= {"hold_s": (hold[0].sent_ns - down_ns) * 1e-9, "hold": hold[1].reason}
        works = [e.sent_ns for e, decision in decided if e.sent_ns > times["back"] and decision.action != HOLD]
        result["again_s"] = (works[0] - times["back"]) * 1e-9 if works else math.nan
    return result


def _label(result: Mapping[str, Any]) -> str:
    return f"{100.0 * result['loss']:g} % lost, recorder beside the {result['recorder']}"


def _answers(results: Sequence[dict[str, Any]]) -> Table:
    return Table(
        "Answers of the planner",
        results,
        (
            Column("", _label),
            Column("postures answered", "answered", ".1%"),
            Column("steps taken", "steps"),
            Column("of those due", "steps_answered", ".1%"),
            Column("posture to decision, median", lambda row: row["answer_ms"].median, ".0f", "ms"),
            Column("99 %", lambda row: row["answer_ms"].p99, ".0f", "ms"),
            Column("holds", "holds"),
            Column("ready after", "ready_s", ".1f", "s"),
        ),
    )


def _outages(settings: LinkBenchSettings, results: Sequence[dict[str, Any]]) -> Table:
    return Table(
        f"Link down for {settings.down:g} s",
        [result for result in results if not math.isnan(result["hold_s"])],
        (
            Column("", _label),
            Column("hold after", "hold_s", ".2f", "s"),
            Column("work again after", "again_s", ".2f", "s"),
            Column("reason", "hold"),
        ),
    )


def _costs(results: Sequence[dict[str, Any]]) -> Table:
    return Table(
        "On the link",
        results,
        (
            Column("", _label),
            Column("from the predictor's host", lambda row: row["bytes_per_s"][SEEING] / 1e3, ".0f", "kB/s"),
            Column("from the planner's host", lambda row: row["bytes_per_s"][MOVING] / 1e3, ".0f", "kB/s"),
            Column("occupancies recorded", "occupancies_recorded", ".1%"),
        ),
    )
