"""`humanpred bench fuzz`: damaged files of every kind, and messages to every node, as a stranger's may be.

Every file is read by a process of its own with bounded memory. It may be accepted, or refused by one of this package's
errors; anything else (another exception, a crash, a process that takes too long or too much memory, a file outside the
folder that was named) is a failure, and its file is kept. `--first NUMBER --files 1` with the same seed does one file
again. Messages are shown to the nodes by `messages`. The exit status is 1 if anything failed.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from fuzz.damage import ESCAPE, damaged
from fuzz.samples import KINDS, make_samples, outcome
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.checkout_benches import FuzzSettings
from humanpred_ros.evaluation.framework import Begin, Report, Table, present
from humanpred_ros.evaluation.parallel import usable_cores
from humanpred_ros.evaluation.processes import ends_with_parent

#: Memory that reading a file may take beside what the process has that has read every sample once, and processor time.
_MOST_BYTES, _MOST_S = 1 << 30, 20.0
#: Where this package lies.
_FOLDER = str(Path(__file__).resolve().parents[1])
#: A process that has not answered for so long is ended; other programs may run beside it.
_PATIENCE_S = 300.0


@dataclass(frozen=True)
class Case:
    """What became of one file."""

    number: int
    kind: str
    outcome: str  #: accepted, refused: ERROR, or failed: ...
    seconds: float  #: of processor time
    kept: str = ""  #: where the file is, if it failed


def run(settings: FuzzSettings, console: Console) -> int:
    """Read damaged files and show damaged messages to the nodes; the exit status is 1 if anything failed."""
    failed: list[bool] = []

    def measure(settings: FuzzSettings, begin: Begin) -> Report:
        report = fuzz(settings, begin)
        failed.append(bool(report.figures["failures"]))
        return report

    present(settings, console, measure)
    return 1 if any(failed) else 0


def fuzz(settings: FuzzSettings, begin: Begin) -> Report:
    """Return what became of the files and messages; `failures` in its figures are for repair."""
    cases = fuzz_files(settings, begin) if settings.files else []
    kinds = [_of_kind(kind, [case for case in cases if case.kind == kind]) for kind in settings.kinds if cases]
    failures: list[dict[str, Any]] = [
        {"number": case.number, "what": case.kind, "outcome": case.outcome, "kept": case.kept}
        for case in cases
        if case.outcome.startswith("failed")
    ]
    told = None
    if settings.messages:
        begin("messages", 1)
        told = fuzz_messages(settings.messages, settings.seed)
        failures += told["failures"]
    tables = []
    if kinds:
        heads = ("kind", "files", "accepted", "refused", "failed", ("slowest", ".2f", "s"), "refused by")
        tables.append(Table.of_rows("Damaged files", heads, [list(kind.values()) for kind in kinds]))
    if told is not None:
        rows = [(name, one["messages"]) for name, one in told["targets"].items()]
        tables.append(Table.of_rows("Damaged messages", ("node", "messages"), rows))
    if failures:
        shown = [(f["number"], f["what"], f["outcome"][-200:], f["kept"]) for f in failures[:20]]
        tables.append(Table.of_rows("Failures", ("number", "what", "outcome", "kept in"), shown))
    title = f"{len(cases)} damaged files, {settings.messages} messages, seed {settings.seed}: {len(failures)} failures"
    return Report(title, tables, {"files": kinds, "messages": told, "failures": failures})


def _of_kind(kind: str, cases: list[Case]) -> dict[str, Any]:
    counts = Counter(case.outcome.partition(":")[0] for case in cases)
    by = Counter(case.outcome.partition(": ")[2] for case in cases if case.outcome.startswith("refused"))
    return {
        "kind": kind,
        "files": len(cases),
        "accepted": counts["accepted"],
        "refused": counts["refused"],
        "failed": counts["failed"],
        "slowest_s": max((case.seconds for case in cases), default=0.0),
        "refused_by": ", ".join(f"{name} {count}" for name, count in by.most_common()),
    }


def fuzz_files(settings: FuzzSettings, begin: Begin) -> list[Case]:
    """Return what becomes of each file, by number."""
    n_workers = min(settings.jobs or usable_cores(), settings.files)
    advance = begin("files", settings.files)
    cases: list[Case] = []
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="humanpred_fuzz_") as place:
        make_samples(Path(place) / "samples")
        workers, receivers = [], []
        try:
            for k in range(n_workers):
                receiver, sender = context.Pipe(duplex=False)
                receivers.append(receiver)
                workers.append(context.Process(target=_work, args=(k, n_workers, Path(place), settings, sender)))
                workers[-1].start()
                sender.close()
            while receivers:
                ready = wait(receivers)
                for receiver in [each for each in receivers if each in ready]:
                    try:
                        cases.append(receiver.recv())
                        advance(len(cases))
                    except EOFError:
                        receivers.remove(receiver)
        finally:
            for worker in workers:
                worker.kill()
                worker.join()
    if len(cases) < settings.files:
        raise RuntimeError("a worker ended by itself")
    return sorted(cases, key=lambda case: case.number)


def _work(k: int, n_workers: int, place: Path, settings: FuzzSettings, sender: Connection) -> None:
    """Read every sample once, so that no file pays for what is loaded at first use; then every n-th file."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is for the parent
    ends_with_parent()
    warnings.simplefilter("ignore")
    folder = place / f"worker_{k}" / "work"
    with threadpool_limits(1):  # threads do not survive a fork
        for kind in KINDS:
            _empty(folder)
            shutil.copytree(place / "samples" / kind, folder / "input")
            told = outcome(kind, folder / "input", folder / "out", 0)
            if told != "accepted":
                raise RuntimeError(f"the sample of {kind}: {told}")
        for number in range(settings.first + k, settings.first + settings.files, n_workers):
            sender.send(case_of(number, place, folder, settings))


def case_of(number: int, place: Path, folder: Path, settings: FuzzSettings) -> Case:
    """Damage a file and let a child of this process read it.

    Args:
        number: of the file.
        place: has the samples; nothing but `folder` in it may be written to.
        folder: is emptied; gets the file, `input`.
        settings: how.
    """
    kind = settings.kinds[number % len(settings.kinds)]
    _empty(folder)
    damaged(place / "samples" / kind, folder / "input", np.random.default_rng([settings.seed, number]))
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_read, args=(kind, folder, number, sender))
    child.start()
    sender.close()
    try:
        told, seconds = receiver.recv() if receiver.poll(_PATIENCE_S) else (_too_long(_PATIENCE_S), _PATIENCE_S)
        child.kill()
    except EOFError:
        child.join()
        told, seconds = f"failed: it ended the process with status {child.exitcode}", 0.0
    child.join()
    if any((escaped / ESCAPE).exists() for escaped in (folder.parent, place, Path("/"))):
        told = "failed: it wrote outside the folder that was named"
    kept = ""
    if told.startswith("failed"):
        kept = str(settings.keep / f"{settings.seed}_{number}_{kind}")
        if not Path(kept).exists():
            shutil.copytree(folder / "input", kept)
    return Case(number, kind, told, seconds, kept)


def _read(kind: str, folder: Path, number: int, sender: Connection) -> None:
    """Read a file with no more memory than is bound, and send what it led to and how long it took."""
    ends_with_parent()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + _MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    begun_s = time.process_time()
    try:
        told = outcome(kind, folder / "input", folder / "out", number)
    except BaseException:
        told = f"failed: {traceback.format_exc(limit=-6)}"
    seconds = time.process_time() - begun_s
    sender.send((f"{_too_long(seconds)}, then {told}" if seconds > _MOST_S else told, seconds))


def _too_long(seconds: float) -> str:
    return f"failed: it took {seconds:.0f} s"


def _empty(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)


def fuzz_messages(n: int, seed: int) -> dict[str, Any]:
    """Show the handlers of every node mutated messages, in a process of their own, and return what happened.

    Args:
        n: messages in all, spread evenly over the targets.
        seed: of the mutations; the same messages come again with the same seed, target by target.

    Returns:
        `messages`, how many; `targets`: what each node did, by name (messages, seconds, slowest handler, growth of
        memory, holds, refusals by kind); `failures`: each with the number of the message, what, the target, and the
        outcome with the message. A failure comes again with fewer messages after it.

    Raises:
        UsageError: less than one message for each target, or no ROS 2.
    """
    found: dict[str, dict[str, Any]] = {}
    failures: list[dict[str, Any]] = []
    last = ""
    while True:
        command = [sys.executable, "-m", "fuzz.messages", "--messages", str(n), "--seed", str(seed)]
        ended = subprocess.run(
            [*command, *(("--after", last) if last else ())],
            capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (_FOLDER, os.environ.get("PYTHONPATH"))))},
        )  # fmt: skip
        if "No module named 'rclpy'" in ended.stderr:
            raise UsageError("fuzzing: wanted ROS 2 (rclpy), found none; install the `ros` extra")
        told = [json.loads(line) for line in ended.stdout.splitlines() if line.startswith("{")]
        for line in told:
            if "failures" in line:
                found[line["target"]] = {key: line[key] for key in line if key not in ("target", "failures")}
                failures += [
                    {"number": one["number"], "what": line["target"], "outcome": f"{one['what']}\n{one['message']}"}
                    for one in line["failures"]
                ]
        if ended.returncode == 0:
            break
        tail = "\n".join(ended.stderr.splitlines()[-40:])
        if not told:
            raise UsageError(tail.splitlines()[-1] if tail else f"fuzzing ended with status {ended.returncode}")
        last = told[-1]["target"]  # in the midst of which it ended: go on with the next
        how = f"the process ended with status {ended.returncode}\n{tail}"
        failures.append({"number": -1, "what": last, "outcome": how})
    messages = sum(int(one["messages"]) for one in found.values())
    return {"messages": messages, "targets": found, "failures": [one | {"kept": ""} for one in failures]}
