"""What the live view shows in a second, and what it costs the nodes while nobody, and while somebody, looks.

Frames: everything moves and every voxel is new in every moment. Moments are counted where a browser gets them; where
there is Chromium, what it draws is counted, too, without a graphics card. Cost: the whole graph runs in real time, and
stretches without a view, with one at which nobody looks, and with one at which somebody looks follow each other in
turn, so that what else the machine does is in all of them.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.bench_nodes import replay, write_motion, write_scene
from humanpred_ros.evaluation.checkout_benches import ViewBenchSettings
from humanpred_ros.evaluation.framework import Begin, Report, Table, present
from humanpred_ros.evaluation.processes import NodeGroup, NodeProcess, address_of, free_domain_id, view_command
from humanpred_ros.evaluation.timing import MachineLoad
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.viewing.space import ServerSettings, SpaceMoment, SpaceView, served

_LIBRARY, _TRAJECTORY, _SCENE, _GOALS = "synthetic_reaches", "3/2", "face_to_face", 4
_FED_HZ = 30.0
_MOMENTS = 20
#: Before anything is counted, a browser has read the page, and the nodes have noticed who listens, s.
_SETTLE_S, _START_S = 1.0, 30.0
_STATES = ("no view", "a view, nobody looks", "a view, somebody looks")
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_BROWSER_FLAGS = (
    "--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--window-size=1300,800",
    "--remote-debugging-port=0",
)  # fmt: skip
#: Counts the frames drawn, and the different moments seen in them, for some milliseconds.
_COUNT = """new Promise(done => {
  const seen = new Set(), begin = performance.now(); let drawn = 0;
  const look = now => {
    for (const e of document.querySelectorAll("strong")) if (/^[0-9.]+ s$/.test(e.textContent)) seen.add(e.textContent);
    drawn++;
    if (now - begin < MS) requestAnimationFrame(look); else done([drawn, seen.size].map(n => 1e3 * n / (now - begin)));
  };
  requestAnimationFrame(look);
})"""


def run(settings: ViewBenchSettings, console: Console) -> int:
    """Measure, print and write."""
    return present(settings, console, measure)


def measure(settings: ViewBenchSettings, begin: Begin) -> Report:
    """Count frames, then look at the running graph.

    Raises:
        UsageError: no viser, no ROS, a browser that does not start, or a node that failed.
    """
    load = MachineLoad()
    browser = settings.browser or next(filter(None, map(shutil.which, _BROWSERS)), "")
    begin("counting frames", 1)
    frames = _frames(settings, browser)
    tables = [Table.of_rows("Frames", ("", ("a second", ".1f")), list(frames.items()))]
    nodes: dict[str, list[float]] = {}
    if settings.stretches:
        nodes = _cost(settings, begin)
        mean = {name: float(np.mean(shares)) for name, shares in nodes.items()}
        tables.append(
            Table.of_rows(
                "All nodes together, % of a core",
                ("", ("mean", ".1f"), ("more than without a view", ".1f")),
                [(name, mean[name], mean[name] - mean[_STATES[0]]) for name in _STATES],
            )
        )
    return Report(
        f"live view: {settings.voxels} voxels, stretches of {settings.seconds:g} s",
        tables,
        {"frames_per_second": frames, "nodes_percent_of_a_core": nodes, "browser": browser},
        (*(() if browser else ("No browser was found: what one draws was not counted.",)), *load.notes()),
    )


def _frames(settings: ViewBenchSettings, browser: str) -> dict[str, float]:
    """Return how many moments a second are made, arrive, and are drawn."""
    scene, human = load_scene(_SCENE), HumanModel.kinect12()
    rng = np.random.default_rng(0)
    moments = [
        SpaceMoment(
            q_arm=scene.start + 0.01 * k,
            q_goal=scene.start + 0.2,
            tool_path_m=rng.uniform(0.0, 1.0, (30, 3)),
            bodies={"": 0.5 * (human.lower + human.upper) + 0.001 * k},
            centres_m=np.array([0.5, 0.0, 1.0]) + rng.uniform(-1.0, 1.0, (settings.voxels, 3)),
            probability=rng.uniform(0.2, 1.0, settings.voxels),
            posterior={"1": 0.3, "2": 0.7},
        )
        for k in range(_MOMENTS)
    ]
    ended = threading.Event()
    with served(ServerSettings(), lambda text: None) as server:
        view = SpaceView(server, scene, human)

        def feed() -> None:
            k = 0
            while not ended.wait(1.0 / _FED_HZ):
                view.show(replace(moments[k % _MOMENTS], t_s=0.01 * k))
                k += 1

        began_s = time.thread_time()
        for moment in moments:
            view.show(moment)
        found = {"one core can make": _MOMENTS / (time.thread_time() - began_s)}
        feeding = threading.Thread(target=feed)
        feeding.start()
        try:
            address = f"http://{server.get_host()}:{server.get_port()}"
            with _looking(address) as arrived:
                before = len(arrived)
                time.sleep(settings.seconds)
                found[f"arrive, of {_FED_HZ:.0f}"] = (len(arrived) - before) / settings.seconds
            if browser:
                drawn, seen = _drawn(browser, address, settings.seconds)
                found |= {"drawn by the browser": drawn, "moments seen in them": seen}
        finally:
            ended.set()
            feeding.join()
    return found


@contextlib.contextmanager
def _looking(address: str) -> Iterator[list[int]]:
    """Look at a page as a browser does, without drawing; yield the list that sizes of whatever comes are added to."""
    import msgspec
    import viser
    from viser._messages import ViewerCameraMessage
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    spoken = Subprotocol(f"viser-v{viser.__version__}")
    camera = ViewerCameraMessage(
        (1.0, 0.0, 0.0, 0.0), (2.0, 0.0, 1.0), 1.0, 0.01, 100.0, 800, 1300, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    )
    came: list[int] = []
    with connect(address.replace("http", "ws", 1), subprotocols=[spoken], max_size=None) as socket:
        socket.send(msgspec.msgpack.encode(camera.as_serializable_dict()))
        reader = threading.Thread(target=lambda: came.extend(map(len, _until_closed(socket))), daemon=True)
        reader.start()
        time.sleep(_SETTLE_S)
        yield came
    reader.join()


def _until_closed(socket: Any) -> Iterator[bytes]:
    with contextlib.suppress(Exception):  # the other side may close at any time
        yield from socket


def _drawn(browser: str, address: str, seconds: float) -> tuple[float, float]:
    """Return the frames a second that a browser draws of a page, and the different moments seen in them."""
    from websockets.sync.client import connect

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [browser, *_BROWSER_FLAGS, f"--user-data-dir={folder}", address]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            until_s, told = time.monotonic() + _START_S, Path(folder) / "DevToolsActivePort"
            while not (told.is_file() and told.read_text().strip()):
                if process.poll() is not None or time.monotonic() > until_s:
                    raise UsageError(
                        f"--browser: wanted one that starts with {' '.join(_BROWSER_FLAGS)}, {browser} did not"
                    )
                time.sleep(0.1)
            with urllib.request.urlopen(
                f"http://127.0.0.1:{told.read_text().split()[0]}/json", timeout=_START_S
            ) as answer:
                page = next(entry for entry in json.load(answer) if entry["type"] == "page")
            time.sleep(5.0 * _SETTLE_S)
            with connect(page["webSocketDebuggerUrl"], max_size=None) as socket:
                expression = _COUNT.replace("MS", str(1e3 * seconds))
                asked = {"expression": expression, "awaitPromise": True, "returnByValue": True}
                socket.send(json.dumps({"id": 1, "method": "Runtime.evaluate", "params": asked}))
                reply = json.loads(socket.recv(timeout=seconds + _START_S))
            drawn, seen = reply["result"]["result"]["value"]
            return float(drawn), float(seen)
        finally:
            process.terminate()
            process.wait()


def _cost(settings: ViewBenchSettings, begin: Begin) -> dict[str, list[float]]:
    """Return the processor time that all nodes together used, by stretch, % of a core."""
    shares: dict[str, list[float]] = {name: [] for name in _STATES}
    library = load_library(locate(_LIBRARY, "bags"))
    lasts_s = settings.stretches * len(_STATES) * (settings.seconds + 4.0 * _SETTLE_S) + 2.0 * _START_S
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        motion = write_motion(folder / "motion", library, library.find(_TRAJECTORY), lasts_s)
        scene = str(write_scene(folder / "scene.yaml", _GOALS))
        with NodeGroup(folder / "logs", free_domain_id()) as group:
            group.start("simulated_arm", {"scene": scene})
            group.start("separation_guard", {"scene": scene})
            group.start("occupancy_predictor", {"scene": scene, "listener": "stomp_planner"})
            group.start("stomp_planner", {"scene": scene, "controller": "simulated_arm", "velocity_scale": 0.1})
            turns = _turns(settings, group, scene, shares, begin("stretches", settings.stretches * len(_STATES)))
            with contextlib.suppress(StopIteration):
                replay(group, motion, meanwhile=lambda: next(turns))
    return shares


def _turns(
    settings: ViewBenchSettings, group: NodeGroup, scene: str, shares: Mapping[str, list[float]], advance: Any
) -> Iterator[None]:
    """Take turns, and add to the shares of each what the nodes used."""
    nodes = list(group.nodes)
    done = 0
    for _ in range(settings.stretches):
        for state in _STATES:
            with contextlib.ExitStack() as stack:
                if state != _STATES[0]:
                    address = stack.enter_context(_view(group, scene))
                if state == _STATES[2]:
                    stack.enter_context(_looking(address))
                time.sleep(_SETTLE_S)
                before_s, began_s = _used_s(nodes), time.monotonic()
                time.sleep(settings.seconds)
                shares[state].append(100.0 * (_used_s(nodes) - before_s) / (time.monotonic() - began_s))
            done += 1
            advance(done)
            yield


@contextlib.contextmanager
def _view(group: NodeGroup, scene: str) -> Iterator[str]:
    """Open a live view of the running graph; yield its address."""
    view = group.run("view", view_command("--scene", scene))
    while not (address := address_of(view)):
        group.check()
        time.sleep(0.1)
    try:
        yield address
    finally:
        view.process.terminate()
        view.process.wait()
        group.nodes.remove(view)


def _used_s(nodes: list[NodeProcess]) -> float:
    used = [node.usage() for node in nodes]
    return sum(one.cpu_s for one in used if one is not None)
