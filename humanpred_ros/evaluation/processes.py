"""Runs the nodes as processes, tells what they use, and always ends them, however the parent ends."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from humanpred_ros.errors import UsageError

#: Signals in rising order of force, with the seconds a process is given to follow each.
_ESCALATION = ((signal.SIGINT, 8.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
#: What asks the parent to end.
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
_POLL_S = 0.02
_SETTLE_S = 0.3  # the last messages reach the recorder after their sender has ended
_PR_SET_PDEATHSIG = 1
_TAIL_LINES = 8
#: Executable that is predictor and planner.
ONE_PROCESS = "predict_and_plan"
#: DDS has UDP ports for no more.
_LARGEST_DOMAIN = 232
#: Of a domain that are looked for; the first to come get the first ports.
_PARTICIPANTS = 20
#: Status of a node that has said in one line why it ended.
_NAMED_ERROR = 2

ParameterValue = str | int | float | bool | Sequence[str]


class Usage(NamedTuple):
    """Processor time used so far, s, and the most memory held, MB (resident)."""

    cpu_s: float
    memory_mb: float


@dataclass
class NodeProcess:
    """One node in a process of its own, with its output in a log file."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    @property
    def running(self) -> bool:
        return self.process.poll() is None

    def usage(self) -> Usage | None:
        """Return what the process has used (from /proc); None if it has ended or the system does not tell."""
        folder = Path(f"/proc/{self.process.pid}")
        try:
            # The name in brackets may hold blanks; times are the 12th and 13th column after it.
            columns = (folder / "stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
            status = (folder / "status").read_text(encoding="ascii", errors="replace").splitlines()
            cpu_s = (int(columns[11]) + int(columns[12])) / os.sysconf("SC_CLK_TCK")
            peak_kb = next(int(line.split()[1]) for line in status if line.startswith(("VmHWM:", "VmRSS:")))
        except (OSError, ValueError, IndexError, StopIteration):
            return None
        return Usage(cpu_s, peak_kb / 1024.0)

    def tail(self) -> str:
        """Return the end of the log, for error messages."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        return "\n".join(lines[-_TAIL_LINES:])


@dataclass
class NodeGroup:
    """The processes of one run, on one ROS domain that only this machine sees; use as a context manager.

    The nodes get sessions of their own, so that a Ctrl-C in the terminal reaches the parent alone and the
    parent ends them in order; the kernel ends them should the parent be killed.
    """

    log_directory: Path  #: one `<node>.log` each
    domain_id: int  #: ROS_DOMAIN_ID of the group
    nodes: list[NodeProcess] = field(default_factory=list)

    def start(
        self,
        node: str,
        parameters: Mapping[str, ParameterValue],
        remap: Mapping[str, str] | None = None,
        within: Sequence[str] = (),
    ) -> NodeProcess:
        """Start `python -m humanpred_ros.nodes.<node>` with ROS parameters and other names for its topics.

        A node started again gets a log of its own, `<node>_2.log` and so on. What stands in front of the command
        (`within`, as `TwoHosts.on`) must become it.
        """
        command = [*within, sys.executable, "-m", f"humanpred_ros.nodes.{node}", "--ros-args"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={_yaml(value)}"]
        for name, other in (remap or {}).items():
            command += ["-r", f"{name}:={other}"]
        return self.run(node, command)

    def run(self, node: str, command: Sequence[str]) -> NodeProcess:
        """Start a command as a process of the group."""
        self.log_directory.mkdir(parents=True, exist_ok=True)
        before = sum(entry.name == node for entry in self.nodes)
        log = self.log_directory / (f"{node}_{before + 1}.log" if before else f"{node}.log")
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(self.domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.log_directory / "ros"),
            "PYTHONUNBUFFERED": "1",
        }
        # A Ctrl-C between the start of a process and its entry in the list would leave it behind.
        signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
        try:
            with log.open("wb") as stream:
                process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=stream,
                    stderr=subprocess.STDOUT,
                    env=environment,
                    start_new_session=True,
                    preexec_fn=_prepare_child,
                )
            entry = NodeProcess(node, process, log)
            self.nodes.append(entry)
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
        return entry

    def check(self) -> None:
        """Raise UsageError, with what it said last, if a node has ended with an error."""
        for node in self.nodes:
            status = node.process.poll()
            if status == _NAMED_ERROR and node.tail():  # said in its last line
                raise UsageError(node.tail().splitlines()[-1])
            if status:
                end = f"the end of {node.log}:\n{node.tail()}" if node.tail() else f"{node.log} is empty: disk full?"
                raise UsageError(f"{node.name} ended with status {status}; {end}")

    def wait_for(self, source: NodeProcess, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Wait until the node that feeds the others has ended by itself, and what was sent last has arrived.

        Args:
            source: the node.
            meanwhile: called again and again.

        Raises:
            UsageError: a node failed.
        """
        while source.running:
            self.check()
            meanwhile()
            time.sleep(_POLL_S)
        self.check()
        time.sleep(_SETTLE_S)

    def end(self, awaited: str) -> None:
        """Ask every node to end, and wait for one of them: what it wrote is complete then. The others end meanwhile."""
        number, patience_s = _ESCALATION[0]
        for node in reversed(self.nodes):
            if node.running:
                node.process.send_signal(number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            next(node for node in self.nodes if node.name == awaited).process.wait(patience_s)

    def stop(self, gently: bool = True) -> None:
        """End every node, the last started first, by ever stronger signals, or by the strongest at once."""
        for number, patience_s in _ESCALATION if gently else _ESCALATION[-1:]:
            alive = [node for node in reversed(self.nodes) if node.running]
            if not alive:
                return
            for node in alive:
                node.process.send_signal(number)
            deadline = time.monotonic() + patience_s
            while any(node.running for node in alive) and time.monotonic() < deadline:
                time.sleep(_POLL_S)

    def __enter__(self) -> NodeGroup:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        # A second Ctrl-C while stopping would leave processes behind.
        before = {number: signal.signal(number, signal.SIG_IGN) for number in _INTERRUPTS}
        try:
            self.stop()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def in_one_process(
    planner: Mapping[str, ParameterValue], predictor: Mapping[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return the parameters of `predict_and_plan` that give its two nodes theirs."""
    return {
        f"{node}:{name}": value
        for node, parameters in (("stomp_planner", planner), ("occupancy_predictor", predictor))
        for name, value in parameters.items()
    }


def chosen_domain_id() -> int:
    """Return the ROS domain id of the environment, or a free one where it names none.

    Raises:
        UsageError: an id that is none, or of a domain on which nodes of this package are running already.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if not text:
        return free_domain_id()
    if not (text.isascii() and text.isdecimal() and len(text) <= 3 and int(text) <= _LARGEST_DOMAIN):
        raise UsageError(f"ROS_DOMAIN_ID: wanted a whole number from 0 to {_LARGEST_DOMAIN}, got {text}")
    if not _in_use(int(text), _PARTICIPANTS):
        return int(text)
    looked = subprocess.run(
        [sys.executable, "-m", "humanpred_ros.nodes.running"],
        env={**os.environ, "ROS_DOMAIN_ID": text, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if looked.returncode:
        why = (looked.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise UsageError(f"ROS_DOMAIN_ID {text}: could not look who is on this domain: {why}")
    if looked.stdout.strip():
        raise UsageError(
            f"ROS_DOMAIN_ID {text}: wanted a domain without nodes of this package, {looked.stdout.strip()} running "
            "there; end them, set another id, or set none for one that is free"
        )
    return int(text)


def free_domain_id() -> int:
    """Return a ROS domain id whose discovery ports no process of this machine is using.

    Ids up to 101 stay clear of the ephemeral ports. The choice starts at a place that depends on the process id, so
    that two runs started together differ.
    """
    for step in range(100):
        domain_id = 1 + (os.getpid() + step) % 101
        if not _in_use(domain_id, _PARTICIPANTS):
            return domain_id
    raise UsageError("no free ROS domain id from 1 to 101 on this machine; end other ROS programs first")


def _in_use(domain_id: int, participants: int) -> bool:
    """Return whether one of the first participants of a domain is a process of this machine.

    DDS gives each domain UDP ports from 7400 + 250 * id, and each participant two of them (RTPS 9.6.1.1).
    """
    for port in range(7410 + 250 * domain_id, 7410 + 250 * domain_id + 2 * participants, 2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except (OSError, OverflowError):
                return True
    return False


def _prepare_child() -> None:
    """Let the child take SIGINT, whatever the parent did with it, and on Linux die with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
    ends_with_parent()


def ends_with_parent() -> None:
    """Let the kernel end this process when its parent ends, where there is Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _yaml(value: ParameterValue) -> str:
    """Return a value as the YAML that ROS arguments are."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, int | float):
        return repr(value)
    return "[" + ", ".join(_yaml(item) for item in value) + "]"


def view_command(*arguments: str) -> list[str]:
    """Return the command of a live view of the running graph."""
    return [sys.executable, "-m", "humanpred_ros.cli", "view", "live", *arguments]


def address_of(view: NodeProcess) -> str:
    """Return the address at which a live view is open; empty if it is not yet."""
    found = re.search(r"open (http://\S+)", view.log.read_text(encoding="utf-8", errors="replace"))
    return found[1] if found else ""
