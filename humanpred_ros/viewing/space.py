"""A workcell in 3D in a browser: robot, people, what they are predicted to occupy, and what the planner says of it.

Drawn with viser, which serves one page to any number of browsers. Who fills it, from a recorded run or from the running
graph, says what there is at one moment.
"""

from __future__ import annotations

import contextlib
import io
import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb

from humanpred_ros import topics
from humanpred_ros.errors import UsageError, printable
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.clearance import SeparationMeter
from humanpred_ros.robot.scene import Scene
from humanpred_ros.settings import Settings, setting
from humanpred_ros.viewing.figures import INK, goal_colours
from humanpred_ros.viewing.plots_space import HUMAN, PROBABILITY, ROBOT, WOOD
from humanpred_ros.viewing.recorded import RecordedDecision
from humanpred_ros.viewing.strip import Sample, Strip

if TYPE_CHECKING:
    import viser

_PORTS_TRIED = 20
_GHOST_OPACITY, _LIGHT = 0.25, 2.0
#: Where one looks from, m from the middle of the tasks: away from the person, to their left, and up.
VIEWS: Mapping[str, tuple[float, float, float]] = {
    "side": (0.3, 2.4, 0.9),
    "above": (-0.01, 0.0, 3.2),
    "robot": (2.4, 0.0, 0.9),
    "person": (-1.6, 0.0, 1.3),
}
_FIRST_VIEW = "side"
#: What a live view says when the first browser has come.
LOOKED_AT = "somebody looks"
#: Classes whose probability is shown, the most probable ones.
_BARS = 4
#: Voxels are drawn so much smaller than they are: one sees what is behind them.
_SHRUNK = 0.4
_FIRST_THRESHOLD = 0.2
#: What can be shown, and whether it is at first: the last three cost the nodes that draw them time.
CANDIDATES, FUTURES, ROLLOUTS = "candidate paths", "sampled futures", "noisy paths"
#: The topics of these.
DRAWN = {CANDIDATES: topics.CANDIDATES, FUTURES: topics.FUTURES, ROLLOUTS: topics.ROLLOUTS}
_LAYERS = {
    **dict.fromkeys(("robot", "going to", "people", "occupancy", "scene", "tasks", CANDIDATES, FUTURES), True),
    ROLLOUTS: False,
}
_EVERYBODY = "everybody"
_MARKUP = re.compile(r"([\\`*_{}\[\]()<>#+\-.!|~&])")


class ServerSettings(Settings):
    """Where a view is served."""

    host: str = setting("127.0.0.1", "address that browsers may come from; 0.0.0.0 lets everybody in")
    port: int = setting(8080, "first port that is tried", low=1, high=65535)


@dataclass(frozen=True)
class SpaceMoment:
    """What there is at one moment; everything may be missing. World frame."""

    t_s: float | None = None  #: of a recording
    q_arm: FloatArray | None = None  #: (J,) measured
    q_goal: FloatArray | None = None  #: (J,) where it is going
    tool_path_m: FloatArray | None = None  #: (N, 3) on which way
    bodies: Mapping[str, FloatArray] = field(default_factory=dict)  #: (D,) postures by body, tracker's frame
    #: by layer, thin lines: from where to where (N, 2, 3), and their colours (N, 3), 0 to 1
    lines: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    centres_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  #: (N, 3) of voxels
    probability: FloatArray = field(default_factory=lambda: np.zeros(0))  #: (N,) that they will be occupied
    posterior: Mapping[str, float] = field(default_factory=dict)  #: by class
    decision: RecordedDecision | None = None
    state: str = ""  #: in words


def as_text(text: str) -> str:
    """Return markdown that shows a text as it is, whatever markup a stranger put into it."""
    return _MARKUP.sub(r"\\\1", printable(text))


@contextlib.contextmanager
def served(settings: ServerSettings, tell: Callable[[str], None]) -> Iterator[viser.ViserServer]:
    """Serve a page until the block ends; a port in use is passed over, and the address is told.

    Raises:
        UsageError: viser is not installed, no free port, or an address that is not this machine's.
    """
    try:
        import viser
    except ImportError as missing:
        raise UsageError(f"view: wanted viser, got none ({missing}); install the `view` extra") from missing
    port = free_port(settings.host, settings.port)
    if port != settings.port:
        tell(f"port {settings.port} is in use: {port} is taken")
    with contextlib.redirect_stdout(io.StringIO()):  # it says more than anybody asked for
        server = viser.ViserServer(host=settings.host, port=port, label="humanpred", verbose=False)
    try:
        tell(f"open http://{settings.host}:{port} in a browser; Ctrl-C ends it")
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def free_port(host: str, first: int) -> int:
    """Return the first port that is free at a host; raises UsageError as `served`."""
    for port in range(first, min(first + _PORTS_TRIED, 65536)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except socket.gaierror as trouble:
                raise UsageError(f"--host: wanted an address of this machine, got {host} ({trouble})") from trouble
            except OSError as trouble:
                refusal = trouble
                continue
        return port
    raise UsageError(f"--port: wanted a free one from {first} on at {host}, got none ({refusal}); set another")


class SpaceView:
    """Draws a workcell on a server's page, and moment after moment what moves in it.

    Attributes:
        server: of the page; what else is added to it stands between the state in words and the person's classes if
            its order is -1.
    """

    def __init__(self, server: viser.ViserServer, scene: Scene, human: HumanModel) -> None:
        """Draw what stands still."""
        self.server, self._scene, self._human = server, scene, human
        self._colours = goal_colours([goal.name for goal in scene.goals])
        self._moving: dict[str, Any] = {}
        self._links = [
            np.concatenate([surface.triangles for surface in surfaces]) if surfaces else None
            for surfaces in scene.arm.moving_surfaces()
        ]
        self._drawn: tuple[object, object] = (None, None)
        self._last: SpaceMoment | None = None
        server.scene.set_up_direction("+z")
        # Shadows and reflections cost three quarters of a frame where there is no graphics card.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=_LIGHT)
        self._draw_scene()
        gui = server.gui
        self._state = gui.add_markdown("", order=-2.0)
        with gui.add_folder("the person reaches for"):
            self._bars = [(gui.add_markdown(""), gui.add_progress_bar(0.0)) for _ in range(_BARS)]
        self._strip = Strip(gui, gui.add_folder("the last 30 s"), lambda name: self._colours.get(name, ""))
        with gui.add_folder("show"):
            self._shown = {name: gui.add_checkbox(name, on) for name, on in _LAYERS.items()}
            self._body = gui.add_dropdown("people", (_EVERYBODY,))
            self._threshold = gui.add_slider("occupancy from", 0.0, 1.0, 0.01, _FIRST_THRESHOLD)
            views = gui.add_button_group("look from", tuple(VIEWS))
        controls: list[Any] = [*self._shown.values(), self._threshold, self._body]
        for control in controls:
            control.on_update(lambda _: self._again())
        views.on_click(lambda event: self._look(event.client and event.client.camera, str(views.value)))
        self._look(server.initial_camera, _FIRST_VIEW)

    def shows(self, layer: str) -> bool:
        """Return whether a layer is switched on."""
        return bool(self._shown[layer].value)

    def show(self, moment: SpaceMoment) -> None:
        """Draw what there is at a moment."""
        self._last = moment
        if set(moment.bodies) - set(self._body.options):
            self._body.options = (*self._body.options, *sorted(set(moment.bodies) - set(self._body.options)))
        chosen = self._body.value
        bodies = [q for name, q in moment.bodies.items() if chosen in (_EVERYBODY, name)]
        with self.server.atomic():
            self._arm("robot", moment.q_arm if self.shows("robot") else None, _rgb(ROBOT), None)
            self._arm("ghost", moment.q_goal if self.shows("going to") else None, _rgb(ROBOT), _GHOST_OPACITY)
            path = moment.tool_path_m if self.shows("going to") else None
            ends = np.zeros((0, 2, 3)) if path is None else np.stack([path[:-1], path[1:]], axis=1)
            self._lines("path", ends, np.tile(to_rgb(INK), (len(ends), 1)), 0.006)
            for layer in (CANDIDATES, FUTURES, ROLLOUTS):
                ends, colours = moment.lines.get(layer, (np.zeros((0, 2, 3)), np.zeros((0, 3))))
                kept = slice(None) if self.shows(layer) else slice(0)
                self._lines(layer, ends[kept], colours[kept], 0.003)
            self._people(bodies if self.shows("people") else ())
            self._occupancy(moment, self.shows("occupancy"))
            for name in ("scene", "tasks"):
                self._moving[name].visible = self.shows(name)
            self._say(moment)
        self.recall(moment)
        self._strip.draw(_time_of(moment))

    def recall(self, moment: SpaceMoment) -> None:
        """Keep what the charts of the last half minute show of a moment, without drawing it."""
        if not self._strip.due(_time_of(moment)):
            return
        distance_m = np.nan
        if moment.q_arm is not None and moment.bodies and self._human.bodies:
            postures = np.array(list(moment.bodies.values()))
            meter = SeparationMeter(self._scene.arm, self._human, self._scene.T_world_human, postures)
            distance_m = float(meter.measure(np.tile(moment.q_arm, (len(postures), 1))).least_m)
        decision = moment.decision
        costs = {} if decision is None else {goal.name: goal.selection_cost for goal in decision.goals}
        held = decision is not None and decision.action == "hold"
        self._strip.add(Sample(_time_of(moment), moment.posterior, costs, distance_m, held))

    def _again(self) -> None:
        if self._last is not None:
            self.show(self._last)

    def _look(self, camera: Any, name: str) -> None:
        if camera is None:
            return
        away, left, up = VIEWS[name]
        ahead = (self._middle - self._scene.T_world_human[:3, 3]) * [1.0, 1.0, 0.0]
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        aside = np.array([-ahead[1], ahead[0], 0.0])
        camera.position = self._middle + away * ahead + left * aside + [0.0, 0.0, up]
        camera.look_at = self._middle

    def _draw_scene(self) -> None:
        scene = self._scene
        api = self.server.scene
        self._moving["scene"] = api.add_frame("/scene", show_axes=False)
        self._moving["tasks"] = api.add_frame("/tasks", show_axes=False)
        for k, obstacle in enumerate(scene.obstacles):
            T = obstacle.T_world_shape
            _mesh(api, f"/scene/{k}", obstacle.shape.triangles() @ T[:3, :3].T + T[:3, 3], _rgb(WOOD))
        for k, (surface, T) in enumerate(scene.arm.standing_surfaces()):
            _mesh(api, f"/scene/robot/{k}", surface.triangles @ T[:3, :3].T + T[:3, 3], _rgb(ROBOT))
        places = [scene.arm.chain.tool_pose(goal.configurations[0])[:3, 3] for goal in scene.goals]
        for goal, place in zip(scene.goals, places, strict=True):
            colour = _rgb(self._colours[goal.name])
            api.add_icosphere(f"/tasks/{goal.name}", 0.025, color=colour, position=tuple(place))
            api.add_label(f"/tasks/{goal.name}/label", goal.name, position=(0.0, 0.0, 0.07))
        self._middle = np.mean(places or [scene.T_world_human[:3, 3]], axis=0)

    def _arm(self, name: str, q: FloatArray | None, colour: tuple[int, int, int], opacity: float | None) -> None:
        arm = self._scene.arm
        if q is None or not np.isfinite(q).all():
            for key in [key for key in self._moving if key.startswith(f"/{name}/")]:
                self._moving[key].visible = False
            return
        handles = []
        for k, triangles in enumerate(self._links):
            key = f"/{name}/{k}"
            if triangles is not None and key not in self._moving:
                self._moving[key] = _mesh(self.server.scene, key, triangles, colour, opacity)
            handles.append(self._moving.get(key))
        _place(handles, arm.chain.link_poses(q))

    def _lines(self, name: str, ends: FloatArray, colours: FloatArray, thickness: float) -> None:
        """Draw lines between ends (N, 2, 3) in colours (N, 3), none if there are none."""
        key = f"/lines/{name.replace(' ', '_')}"
        if not len(ends) and key not in self._moving:
            return
        points, rgb = ends.astype(np.float32), np.repeat((255 * colours).astype(np.uint8)[:, None], 2, axis=1)
        if key not in self._moving:
            self._moving[key] = self.server.scene.add_line_segments(key, points, rgb, thickness=thickness)
        handle = self._moving[key]
        handle.visible = len(ends) > 0
        if handle.visible:
            handle.points, handle.colors = points, rgb

    def _people(self, bodies: Sequence[FloatArray]) -> None:
        kept = set()
        for n, q in enumerate(bodies):
            keys = [f"/people/{n}/{k}" for k in range(len(self._human.bodies))]
            for key, body in zip(keys, self._human.bodies, strict=True):
                if key not in self._moving:
                    self._moving[key] = _mesh(self.server.scene, key, body.shape.triangles(), _rgb(HUMAN))
            poses = self._scene.T_world_human @ np.asarray(self._human.body_poses(q))
            _place([self._moving[key] for key in keys], poses)
            kept.update(keys)
        for key in [key for key in self._moving if key.startswith("/people/") and key not in kept]:
            self._moving[key].visible = False

    def _occupancy(self, moment: SpaceMoment, shown: bool) -> None:
        how = (self._threshold.value, shown)
        if moment.centres_m is self._drawn[0] and how == self._drawn[1]:
            return  # the voxels are most of what is sent
        self._drawn = moment.centres_m, how
        kept = moment.probability >= max(self._threshold.value, 1e-6)
        points = moment.centres_m[kept] if shown else np.zeros((0, 3))
        colours = PROBABILITY(moment.probability[kept])[:, :3] if shown else np.zeros((0, 3))
        points, colours = points.astype(np.float32), (255 * colours).astype(np.uint8)
        if "occupancy" in self._moving:
            self._moving["occupancy"].points, self._moving["occupancy"].colors = points, colours
            return
        size_m = _SHRUNK * self._scene.grid.resolution_m
        self._moving["occupancy"] = self.server.scene.add_point_cloud(
            "/occupancy", points, colours, point_size=size_m, precision="float32"
        )

    def _say(self, moment: SpaceMoment) -> None:
        head = as_text(moment.state) if moment.t_s is None else f"**{moment.t_s:.2f} s** {as_text(moment.state)}"
        self._state.content = "\n\n".join([head, *_told(moment.decision)])
        likely = sorted(moment.posterior.items(), key=lambda entry: -entry[1])[:_BARS]
        for (label, bar), (name, value) in zip(self._bars, likely + [("", 0.0)] * (_BARS - len(likely)), strict=True):
            label.content = f"{as_text(name)} {value:.0%}" if name else ""
            set_value(bar, 100.0 * value)


def _time_of(moment: SpaceMoment) -> float:
    return time.monotonic() if moment.t_s is None else moment.t_s


def said(moment: SpaceMoment) -> str:
    """Return in one line of text what a moment's decision says."""
    head = "" if moment.t_s is None else f"{moment.t_s:.2f} s"
    if moment.decision is None:
        return head
    parts = (head, moment.decision.action, moment.decision.chosen, moment.decision.reason)
    return printable("  ".join(part for part in parts if part))


def _told(decision: RecordedDecision | None) -> Iterator[str]:
    """Yield what a decision says, in markdown."""
    if decision is None:
        return
    chosen = f" **{as_text(decision.chosen)}**" if decision.chosen else ""
    yield f"{as_text(decision.action)}{chosen}: {as_text(decision.reason)}"
    if decision.goals:
        rows = [
            f"| {as_text(goal.name)} | {goal.selection_cost:.4f} | {as_text(goal.message)} |" for goal in decision.goals
        ]
        yield "\n".join(["| task | cost | |", "|---|---|---|", *rows])


def _mesh(
    api: Any, name: str, triangles: FloatArray, colour: tuple[int, int, int], opacity: float | None = None
) -> Any:
    corners, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return api.add_mesh_simple(
        name,
        corners.astype(np.float32),
        faces.reshape(-1, 3).astype(np.uint32),
        color=colour,
        opacity=opacity,
        flat_shading=True,
        side="double",
    )


def _place(handles: Sequence[Any], poses: Sequence[FloatArray] | FloatArray) -> None:
    """Move what is drawn (None: nothing) to poses (N, 4, 4)."""
    from scipy.spatial.transform import Rotation

    T = np.asarray(poses)
    turns = Rotation.from_matrix(np.array(T[:, :3, :3])).as_quat()[:, [3, 0, 1, 2]]
    for handle, place, turn in zip(handles, T[:, :3, 3], turns, strict=True):
        if handle is not None:
            handle.position, handle.wxyz, handle.visible = place, turn, True


def set_value(control: Any, value: object) -> None:
    """Let a control of the page show a value."""
    control.value = value


def _rgb(colour: str) -> tuple[int, int, int]:
    r, g, b = (round(255 * part) for part in to_rgb(colour))
    return r, g, b
