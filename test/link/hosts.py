"""Two hosts on one machine, with a link between them that delays and loses: network namespaces of Linux.

Each host is a network of its own with one device, `cable`, and a shared memory of its own, so that DDS takes it for
another machine. This process passes the frames (Ethernet, up to 1500 bytes) from one device to the other, as a bad
radio would: each is late by the same time, and some get lost, in both directions. A message of 5 KB is four frames.
Needs no rights but those to make namespaces (`unshare`, `ip`, `nsenter`: util-linux and iproute2).
"""

from __future__ import annotations

import fcntl
import heapq
import os
import random
import select
import shutil
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from types import TracebackType

from humanpred_ros.errors import UsageError

NAMES = ("a", "b")
#: For a command that has its own user, network and mounts, whoever started it.
PRIVATE = ("unshare", "--map-root-user", "--net", "--mount", "--")
_TUNSETIFF, _TAP_WITHOUT_HEADER = 0x400454CA, 0x1002
_LONGEST_FRAME = 65536
_SETUP = """
set -e
mount -t tmpfs tmpfs /dev/shm
ip link set lo up
ip link set dev "$1" name cable
ip address add "10.77.0.$2/24" dev cable
ip link set dev cable up
ip route add default dev cable
"""


def missing() -> str:
    """Return why there can be no two hosts on this machine; empty if there can."""
    if sys.platform != "linux":
        return "two hosts on one machine need Linux's network namespaces"
    absent = [name for name in ("unshare", "nsenter", "ip", "mount") if shutil.which(name) is None]
    if absent:
        return f"two hosts on one machine need the programs {', '.join(absent)} (packages util-linux and iproute2)"
    tried = subprocess.run(
        [*PRIVATE, "ip", "tuntap", "add", "dev", "tried", "mode", "tap"],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if tried.returncode:
        why = (tried.stderr.strip().splitlines() or ["no reason given"])[-1]
        return f"two hosts on one machine need network namespaces and /dev/net/tun, which are not allowed here: {why}"
    return ""


class TwoHosts:
    """The hosts and the link; use as a context manager, in a process started with `PRIVATE`.

    Attributes:
        loss: share of frames that get lost, each way.
        delay_s: how much later each frame comes.
        up: whether anything passes.
        passed, lost: bytes and frames so far, by the index of the host they come from.
    """

    def __init__(self, loss: float, delay_s: float, environment: Mapping[str, str] | None = None) -> None:
        """Take the share of frames that get lost, their delay, and variables that commands on a host are given."""
        self._environment = [f"{name}={value}" for name, value in (environment or {}).items()]
        self.loss, self.delay_s, self.up = loss, delay_s, True
        self.passed, self.lost = [0, 0], [0, 0]
        self._random, self._ends = random.Random(0), threading.Event()

    def on(self, host: int) -> tuple[str, ...]:
        """Return the words in front of a command that runs it on a host, 0 or 1."""
        place = f"/proc/{self._keepers[host].pid}/ns"
        return (
            "nsenter", f"--net={place}/net", f"--mount={place}/mnt",
            "env", "ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET", *self._environment,
        )  # fmt: skip

    def __enter__(self) -> TwoHosts:
        # A host is there as long as a process is in it; these end when their input does, so with this process.
        self._keepers = [
            subprocess.Popen(["unshare", "--net", "--mount", "--", "sh", "-c", "echo; exec cat"],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            for _ in NAMES
        ]  # fmt: skip
        self._devices = []
        try:
            for host, keeper in enumerate(self._keepers):
                assert keeper.stdout is not None
                keeper.stdout.readline()
                self._devices.append(self._new_device(host, keeper.pid))
        except BaseException:
            self._end()
            raise
        self._thread = threading.Thread(target=self._forward, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends.set()
        self._thread.join()
        self._end()

    def _end(self) -> None:
        for device in self._devices:
            os.close(device)
        for keeper in self._keepers:
            keeper.communicate()

    def _new_device(self, host: int, pid: int) -> int:
        device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        name = f"tap{host}"
        try:
            fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _TAP_WITHOUT_HEADER))
            _run("ip", "link", "set", name, "netns", str(pid))
            _run(*self.on(host), "sh", "-c", _SETUP, "setup", name, str(host + 1))
        except BaseException:
            os.close(device)
            raise
        return device

    def _forward(self) -> None:
        """Pass frames on, each when it is due."""
        under_way: list[tuple[float, int, int, bytes]] = []
        number = 0
        while not self._ends.is_set():
            wait_s = min(max(under_way[0][0] - time.monotonic(), 0.0), 0.1) if under_way else 0.1
            for device in select.select(self._devices, [], [], wait_s)[0]:
                host = self._devices.index(device)
                frame = os.read(device, _LONGEST_FRAME)
                self.passed[host] += len(frame)
                if not self.up or self._random.random() < self.loss:
                    self.lost[host] += 1
                    continue
                number += 1
                heapq.heappush(under_way, (time.monotonic() + self.delay_s, number, 1 - host, frame))
            while under_way and under_way[0][0] <= time.monotonic():
                _, _, host, frame = heapq.heappop(under_way)
                os.write(self._devices[host], frame)


def _run(*command: str) -> None:
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UsageError(f"two hosts: {' '.join(command[:3])} ...: {done.stderr.strip() or 'no reason given'}")
