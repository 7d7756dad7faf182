"""Fuzzing of the nodes with mutated messages, in processes of their own, so that even a crash is only a finding."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

from humanpred_ros.errors import UsageError

_WORKER = "humanpred_ros.nodes.fuzzing"
#: Every predictor, the planner in both modes, the arm, the recorder and both sources of replays.
TARGETS = (
    "occupancy_predictor/forecast",
    "occupancy_predictor/swept_volume",
    "occupancy_predictor/reaching",
    "occupancy_predictor/current",
    "occupancy_predictor/current_accumulated",
    "occupancy_predictor/constant_velocity",
    "stomp_planner/real_time",
    "stomp_planner/lossless",
    "simulated_arm",
    "run_recorder",
    "skeleton_tracker_replay",
    "occupancy_replay",
)


def fuzz_messages(n: int, seed: int, targets: Sequence[str] = TARGETS) -> dict[str, Any]:
    """Show the handlers of every node mutated messages, and return what happened.

    Args:
        n: messages in all, spread evenly over the targets.
        seed: of the mutations; the same messages come again with the same seed, target by target.
        targets: which nodes, with which predictor or mode.

    Returns:
        `messages`, `seconds`, `per_second`, `seed`; `targets`: what each node did, by name (messages, seconds, slowest
        handler, growth of memory, holds, refusals by kind); `failures`: each with target, number of the message, what
        happened and the message. A failure comes again with
        `python -m humanpred_ros.nodes.fuzzing --target TARGET --seed SEED --messages NUMBER`, NUMBER being a little
        larger than the failure's.

    Raises:
        UsageError: an unknown target, less than one message for each, or no ROS 2.
    """
    unknown = sorted(set(targets) - set(TARGETS))
    if unknown or n < len(targets):
        raise UsageError(
            f"fuzzing: wanted some of {', '.join(TARGETS)} and a message for each, got {', '.join(unknown) or n}"
        )
    begun_s = time.monotonic()
    told: dict[str, dict[str, Any]] = {}
    failures: list[dict[str, Any]] = []
    left = list(targets)
    while left:
        for line in _worker(left, -(-n // len(targets)), seed):
            if "failures" in line:
                name = line.pop("target")
                failures += [{"target": name, **failure} for failure in line.pop("failures")]
                told[name] = line
                left.remove(name)
            elif "ended" in line and left:  # in the midst of the first one left: go on with the next
                failures.append({"target": left.pop(0), "number": -1, "what": line["ended"], "message": ""})
    messages = sum(int(one["messages"]) for one in told.values())
    seconds = time.monotonic() - begun_s
    handled_s = sum(float(one["seconds"]) for one in told.values())
    return {
        "messages": messages,
        "seconds": round(seconds, 1),
        "per_second": round(messages / handled_s, 1) if handled_s else 0.0,
        "seed": seed,
        "targets": told,
        "failures": failures,
    }


def _worker(targets: Sequence[str], n: int, seed: int) -> list[dict[str, Any]]:
    """Return what a worker printed, and how it ended where it did not end well."""
    command = [sys.executable, "-m", _WORKER, "--messages", str(n), "--seed", str(seed)]
    for name in targets:
        command += ["--target", name]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    if "No module named 'rclpy'" in ended.stderr:
        raise UsageError("fuzzing: wanted ROS 2 (rclpy), found none; install the `ros` extra")
    lines = []
    for text in ended.stdout.splitlines():
        if text.startswith("{"):
            lines.append(json.loads(text))
    if ended.returncode:
        last = "\n".join(ended.stderr.splitlines()[-40:])
        lines.append({"ended": f"the process ended with status {ended.returncode}\n{last}"})
    return lines
