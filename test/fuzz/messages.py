"""Shows every node's handlers messages as no sensor sends them, and reports what should not have happened.

The nodes live in this process and are not spun: their handlers are called, with a clock that goes 1/30 s further at
every message. Stretches of good messages alternate with stretches of mutated ones, so that every refusal has to end and
the next one has to be found. What a node may do with a bad message is refuse it by name, hold, or answer as usual;
failures are: an exception; more than `HANG_S` of processor time; an ordinary answer to people's data that cannot be
used; no ordinary answer after `RECOVERS_S` of good data; memory that grows.

`python -m fuzz.messages --messages N --seed S [--after TARGET]` shows N messages, spread evenly over the
targets. It prints a line of JSON when it begins with a target, and one with what the target did. The same messages come
again with the same seed, target by target. `humanpred bench fuzz` runs it.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import sys
import tempfile
import time
import traceback
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.time import Time

from fuzz.mutations import Mutator
from fuzz.targets import START_NS, STEP_NS, Bench, Case, Target, targets
from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.nodes.lifecycle import started

HANG_S = 2.0
#: Good data for so long must be answered as usual again.
RECOVERS_S = 2.5
#: Growth of this process while a node is fuzzed, beyond its first fifth, MB.
GROWTH_MB = 150.0
#: Lengths of stretches of good and of spoilt messages.
_GOOD, _BAD = (4, 120), (1, 40)
#: A handler that does not return for so long ends the process, with a trace of where it is.
_DEAD_S = 60.0


def memory_mb() -> float:
    """Return how much memory this process holds."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        return pages * resource.getpagesize() / 1e6
    except OSError:  # not Linux: the most it ever held
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


class Fuzzing:
    """Runs one target."""

    def __init__(self, target: Target, bench: Bench, seed: int) -> None:
        self.target, self.bench = target, bench
        # A target's messages are the same whichever others are fuzzed, and however many follow.
        self.spoil = Mutator(np.random.default_rng([seed, zlib.crc32(target.name.encode())]))
        self.failures: list[dict[str, Any]] = []
        self.done, self.slowest_s = 0, 0.0

    def run(self, node: Any, n: int) -> dict[str, Any]:
        target = self.target
        now_ns, clock = START_NS, node.get_clock()
        node.steady_s = lambda: now_ns * 1e-9
        target.open(node, self.bench)
        spoiled, left, good_s = False, 30, 0.0
        begun_s, before_mb = time.monotonic(), 0.0
        refused = 0
        while self.done < n:
            if not left:
                spoiled = not spoiled
                left, good_s = int(self.spoil.rng.integers(*(_BAD if spoiled else _GOOD))), 0.0
            left -= 1
            now_ns += STEP_NS
            clock.set_ros_time_override(Time(nanoseconds=now_ns))
            if self.done % 50 == 0:
                faulthandler.dump_traceback_later(_DEAD_S, exit=True)
            for case in target.cases(node, self.bench, self.spoil, spoiled, now_ns):
                usual, held = self._show(case)
                if case.unusable and usual:
                    self._fail("an ordinary answer to data that cannot be used", case)
                if case.good:
                    good_s = 0.0 if usual else good_s + STEP_NS * 1e-9
                    if good_s > RECOVERS_S:
                        self._fail(f"no ordinary answer for {RECOVERS_S} s of good data", case)
                        good_s = 0.0
                refused += held
            if not before_mb and self.done >= n / 5:
                before_mb = memory_mb()
        faulthandler.cancel_dump_traceback_later()
        seconds, growth_mb = time.monotonic() - begun_s, memory_mb() - before_mb
        if growth_mb > GROWTH_MB:
            self.failures.append({"number": self.done, "what": f"memory grew by {growth_mb:.0f} MB", "message": ""})
        return {
            "messages": self.done,
            "seconds": round(seconds, 3),
            "slowest_s": round(self.slowest_s, 4),
            "growth_mb": round(growth_mb, 1),
            "holds": refused,
            "refused": dict(node.refused),
            "failures": self.failures,
        }

    def _show(self, case: Case) -> tuple[bool, bool]:
        """Call a handler; return whether the node answered as usual, and whether it held."""
        # Processor time: this machine may be busy with other things. What waits for ever is ended by `_DEAD_S`.
        begun_s = time.thread_time()
        try:
            case.handler(*case.arguments)
            answered = self.target.answered(None)
        except (Exception, SystemExit):
            self._fail(traceback.format_exc(limit=-2), case)
            answered = False, False
        taken_s = time.thread_time() - begun_s
        self.slowest_s = max(self.slowest_s, taken_s)
        if taken_s > HANG_S:
            self._fail(f"took {taken_s:.2f} s", case)
        self.done += 1
        return answered

    def _fail(self, what: str, case: Case) -> None:
        if len(self.failures) < 20:
            self.failures.append({"number": self.done, "what": what, "message": repr(case.arguments)[:2000]})


def fuzz(n: int, seed: int, after: str) -> None:
    """Fuzz the targets with `n` messages together, or those that follow on `after`; print what happened.

    Raises:
        HumanPredError: fewer messages than targets.
    """
    known = targets()
    if n < len(known):
        raise UsageError(f"fuzzing: wanted a message for each of {len(known)} targets, got {n}")
    names = list(known)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        for name in names[names.index(after) + 1 if after else 0 :]:
            print(json.dumps({"target": name}), flush=True)
            target = known[name]
            arguments = ["--ros-args", "--log-level", "fatal", "-p", "use_sim_time:=true"]
            for key, value in target.prepare(bench).items():
                arguments += ["-p", f"{key}:={value}"]
            rclpy.init(args=arguments)
            node: Any = started(target.make)
            try:
                told = Fuzzing(target, bench, seed).run(node, -(-n // len(known)))
            finally:
                node.close()
                node.destroy_node()
                rclpy.try_shutdown()
            print(json.dumps({"target": name, **told}), flush=True)


def command_line() -> None:
    """Read the arguments and fuzz."""
    parser = argparse.ArgumentParser(description="show nodes mutated messages")
    parser.add_argument("--messages", type=int, default=12_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--after", choices=list(targets()), default="", help="leave out all up to this one")
    given = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    faulthandler.enable()
    try:
        fuzz(given.messages, given.seed, given.after)
    except HumanPredError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    command_line()
