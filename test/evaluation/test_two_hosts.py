"""Two hosts made of network namespaces: their link delays, loses and is cut, and the graph lives with that."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from link.hosts import PRIVATE, missing
from paths import REPOSITORY

WHY_NOT = missing()
pytestmark = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)

ECHO = """
import socket
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as echo:
    echo.bind(("", 9))
    print("listens", flush=True)
    while True:
        echo.sendto(*echo.recvfrom(65536))
"""
ASK = """
import socket, sys, time
took_s = []
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
    asked.settimeout(0.5)
    for _ in range(int(sys.argv[1])):
        sent_s = time.monotonic()
        asked.sendto(bytes(100), ("10.77.0.2", 9))
        try:
            asked.recv(65536)
            took_s.append(time.monotonic() - sent_s)
        except TimeoutError:
            pass
print(len(took_s), min(took_s, default=0.0))
"""
TRY = f"""
import subprocess, sys
from link.hosts import TwoHosts

with TwoHosts(0.0, 0.02) as hosts:
    def ask(times):
        command = [*hosts.on(0), sys.executable, "-c", {ASK!r}, str(times)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()

    echo = subprocess.Popen([*hosts.on(1), sys.executable, "-c", {ECHO!r}], stdout=subprocess.PIPE)
    echo.stdout.readline()
    print(*ask(20))
    hosts.loss = 0.5
    print(*ask(40), sum(hosts.lost))
    hosts.loss, hosts.up = 0.0, False
    print(*ask(2))
    hosts.up = True
    print(*ask(2))
    echo.kill()
"""


def test_the_link_delays_loses_and_is_cut() -> None:
    done = subprocess.run(
        [*PRIVATE, sys.executable, "-c", TRY], cwd=REPOSITORY / "test", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    whole, lossy, cut, back = [[float(word) for word in line.split()] for line in done.stdout.splitlines()]
    assert whole[0] == 20
    assert whole[1] >= 0.04
    assert 0 < lossy[0] < 30, "each way loses half"
    assert lossy[2] >= 40 - lossy[0]
    assert cut[0] == 0
    assert back[0] == 2


def test_the_planner_holds_while_the_link_is_down_and_works_again(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    figures = tmp_path / "link.json"
    command = [sys.executable, "-m", "humanpred_ros.cli", "bench", "link", "--loss", "0.05", "--recorder", "planner"]
    short = ["--seconds", "8", "--down", "2", "--period", "0.5", "--json", str(figures)]
    done = subprocess.run([*command, *short], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(figures.read_text(encoding="utf-8"))["results"]
    assert found["hold"], "nothing can be known of people without a link"
    assert found["again_s"] is not None
    assert found["answered"] > 0.0
