"""`humanpred bench fuzz`: damaged files of every kind, and messages to every node, as a stranger's may be.

Every file is read by a process with bounded memory. It may be accepted, or refused by one of this package's errors;
anything else (another exception, a crash, a process that takes too long or too much memory, a file outside the folder
that was named) is a failure, and its file is kept. `--first NUMBER --files 1` with the same seed does one file again.
The exit status is 1 if anything failed.
"""

from __future__ import annotations

import multiprocessing
import resource
import shutil
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from humanpred_ros.evaluation.framework import Begin, OutputSettings, Report, Table, present
from humanpred_ros.evaluation.fuzz_messages import fuzz_messages
from humanpred_ros.evaluation.hostile_files import ESCAPE, KINDS, damaged, make_samples, outcome
from humanpred_ros.evaluation.parallel import usable_cores
from humanpred_ros.settings import setting

#: Memory that a worker may take beside what it has when it has read every sample once, and processor time for a file.
_MOST_BYTES, _MOST_S = 1 << 30, 20.0
#: A worker that has not answered for so long is ended; other programs may run beside it.
_PATIENCE_S = 300.0
_REPLY = tuple[str, float]


class FuzzSettings(OutputSettings):
    """Settings of `humanpred bench fuzz`."""

    files: int = setting(1000, "damaged files", low=0)
    messages: int = setting(0, "mutated messages, spread over the nodes; 0 leaves them out", low=0)
    seed: int = setting(0, "of all damage", low=0)
    first: int = setting(0, "number of the first file", low=0)
    kinds: tuple[str, ...] = setting(tuple(KINDS), "kinds of files")
    jobs: int | None = setting(None, "processes to work with; one for each core by default", low=1)
    keep: Path = setting(Path("fuzz_failures"), "folder that files which failed are kept in; made if there are any")

    def check(self) -> None:
        """Refuse unknown kinds."""
        from humanpred_ros.evaluation.framework import chosen_names

        chosen_names(self.kinds, KINDS, "kinds")


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
    cases = list(fuzz_files(settings, begin)) if settings.files else []
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
        failures += [
            {"number": one["number"], "what": one["target"], "outcome": one["what"], "kept": ""}
            for one in told["failures"]
        ]
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


def fuzz_files(settings: FuzzSettings, begin: Begin) -> Iterator[Case]:
    """Yield what becomes of each file, by number."""
    numbers = range(settings.first, settings.first + settings.files)
    n_workers = min(settings.jobs or usable_cores(), len(numbers))
    advance = begin("files", len(numbers))
    cases: dict[int, Case] = {}
    with tempfile.TemporaryDirectory(prefix="humanpred_fuzz_") as place:
        make_samples(Path(place) / "samples")
        todo = iter(numbers)
        lock = threading.Lock()
        troubles: list[BaseException] = []

        def work(number_of_worker: int) -> None:
            worker = _Worker(Path(place), f"worker_{number_of_worker}")
            try:
                while not troubles:
                    with lock:
                        number = next(todo, None)
                    if number is None:
                        return
                    case = worker.case(number, settings)
                    with lock:
                        cases[number] = case
                        advance(len(cases))
            except BaseException as trouble:
                troubles.append(trouble)
            finally:
                worker.end()

        threads = [threading.Thread(target=work, args=(k,)) for k in range(n_workers)]
        for thread in threads:
            thread.start()
        try:
            for thread in threads:
                thread.join()
        except BaseException as trouble:  # Ctrl-C
            troubles.append(trouble)
            raise
        finally:
            for thread in threads:
                thread.join()
        if troubles:
            raise troubles[0]
    yield from (cases[number] for number in numbers)


class _Worker:
    """A process that reads files, started again where one ends it."""

    def __init__(self, place: Path, name: str) -> None:
        self.place, self.folder = place, place / name / "work"
        self._process: Any = None
        self._connection: Connection

    def case(self, number: int, settings: FuzzSettings) -> Case:
        kind = settings.kinds[number % len(settings.kinds)]
        if self._process is None:
            self._start()
        told, seconds = self._ask(number, kind, settings.seed)
        if (self.folder.parent / ESCAPE).exists() or (self.place / ESCAPE).exists() or Path("/", ESCAPE).exists():
            told = "failed: it wrote outside the folder that was named"
        kept = ""
        if told.startswith("failed"):
            kept = str(settings.keep / f"{settings.seed}_{number}_{kind}")
            if not Path(kept).exists() and (self.folder / "input").exists():
                shutil.copytree(self.folder / "input", kept)
            self.end()  # what failed may have left it in any state
        return Case(number, kind, told, seconds, kept)

    def end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._connection.close()
            self._process = None

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self.place / "samples", self.folder))
        self._process.start()
        theirs.close()
        ready = self._connection.recv() if self._connection.poll(_PATIENCE_S) else "no answer"
        if ready != "ready":
            raise RuntimeError(f"a worker could not read the samples: {ready}")

    def _ask(self, number: int, kind: str, seed: int) -> _REPLY:
        try:
            self._connection.send((number, kind, seed))
            if not self._connection.poll(_PATIENCE_S):
                return f"failed: no end after {_PATIENCE_S:.0f} s", _PATIENCE_S
            reply: _REPLY = self._connection.recv()
            return reply
        except (EOFError, BrokenPipeError):
            self._process.join()
            return f"failed: it ended the process with status {self._process.exitcode}", 0.0


def _serve(connection: Connection, samples: Path, folder: Path) -> None:
    """Read every sample once, then files as they are asked for, with no more memory than is bound."""
    warnings.simplefilter("ignore")
    try:
        for kind in KINDS:
            _empty(folder)
            shutil.copytree(samples / kind, folder / "input")
            told = outcome(kind, folder / "input", folder / "out", 0)
            if told != "accepted":
                raise RuntimeError(f"the sample of {kind}: {told}")
    except Exception:
        connection.send(traceback.format_exc())
        return
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + _MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    connection.send("ready")
    while True:
        try:
            number, kind, seed = connection.recv()
        except EOFError:
            return
        _empty(folder)
        damaged(samples / kind, folder / "input", np.random.default_rng([seed, number]))
        begun_s = time.process_time()
        try:
            told = outcome(kind, folder / "input", folder / "out", number)
        except BaseException:
            told = f"failed: {traceback.format_exc(limit=-6)}"
        seconds = time.process_time() - begun_s
        if seconds > _MOST_S:
            told = f"failed: it took {seconds:.0f} s of processor time, then {told}"
        connection.send((told, seconds))


def _empty(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
