"""A workcell in 3D in a browser: robot, people, what they are predicted to occupy, and what the planner says of it.

Drawn with viser, which serves one page to any number of browsers. Who fills it, from a recorded run or from the running
graph, says what there is at one moment.
"""

from __future__ import annotations

import contextlib
import io
import re
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb

from humanpred_ros.errors import UsageError, printable
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.scene import Scene
from humanpred_ros.settings import Settings, setting
from humanpred_ros.viewing.figures import INK, goal_colours
from humanpred_ros.viewing.plots_space import HUMAN, PROBABILITY, ROBOT, WOOD
from humanpred_ros.viewing.recorded import RecordedDecision

if TYPE_CHECKING:
    import viser

_PORTS_TRIED = 20
_GHOST_OPACITY = 0.25
#: Where one looks from, m from the middle of the tasks: away from the person, to their left, and up.
_VIEWS: Mapping[str, tuple[float, float, float]] = {
    "side": (0.3, 2.4, 0.9),
    "above": (-0.01, 0.0, 3.2),
    "robot": (2.4, 0.0, 0.9),
    "person": (-1.6, 0.0, 1.3),
}
_FIRST_VIEW = "side"
#: Classes whose probability is shown, the most probable ones.
_BARS = 4
#: Voxels are drawn so much smaller than they are: one sees what is behind them.
_SHRUNK = 0.4
_FIRST_THRESHOLD = 0.2
_LAYERS = ("robot", "going to", "people", "occupancy", "scene", "tasks")
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
    bodies: Sequence[FloatArray] = ()  #: (D,) postures, tracker's frame
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
    port = _free_port(settings.host, settings.port)
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


def _free_port(host: str, first: int) -> int:
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
        self._drawn: tuple[object, object] = (None, None)
        self._last: SpaceMoment | None = None
        server.scene.set_up_direction("+z")
        self._draw_scene()
        self._state = server.gui.add_markdown("", order=-2.0)
        with server.gui.add_folder("the person reaches for"):
            self._bars = [(server.gui.add_markdown(""), server.gui.add_progress_bar(0.0)) for _ in range(_BARS)]
        with server.gui.add_folder("show"):
            self._shown = {name: server.gui.add_checkbox(name, True) for name in _LAYERS}
            self._threshold = server.gui.add_slider("occupancy from", 0.0, 1.0, 0.01, _FIRST_THRESHOLD)
            views = server.gui.add_button_group("look from", tuple(_VIEWS))
        for box in self._shown.values():
            box.on_update(lambda _: self._again())
        self._threshold.on_update(lambda _: self._again())
        views.on_click(lambda event: self._look(event.client and event.client.camera, str(views.value)))
        self._look(server.initial_camera, _FIRST_VIEW)

    def show(self, moment: SpaceMoment) -> None:
        """Draw what there is at a moment."""
        self._last = moment
        shown = {name: box.value for name, box in self._shown.items()}
        with self.server.atomic():
            self._arm("robot", moment.q_arm if shown["robot"] else None, _rgb(ROBOT), None)
            self._arm("ghost", moment.q_goal if shown["going to"] else None, _rgb(ROBOT), _GHOST_OPACITY)
            self._path(moment.tool_path_m if shown["going to"] else None)
            self._people(moment.bodies if shown["people"] else ())
            self._occupancy(moment, shown["occupancy"])
            for name in ("scene", "tasks"):
                self._moving[name].visible = shown[name]
            self._say(moment)

    def _again(self) -> None:
        if self._last is not None:
            self.show(self._last)

    def _look(self, camera: Any, name: str) -> None:
        if camera is None:
            return
        away, left, up = _VIEWS[name]
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
        for k, (T, surfaces) in enumerate(zip(arm.chain.link_poses(q), arm.moving_surfaces(), strict=True)):
            if not surfaces:
                continue
            key = f"/{name}/{k}"
            if key not in self._moving:
                triangles = np.concatenate([surface.triangles for surface in surfaces])
                self._moving[key] = _mesh(self.server.scene, key, triangles, colour, opacity)
            _place(self._moving[key], T)

    def _path(self, path_m: FloatArray | None) -> None:
        key = "/path"
        if path_m is None or len(path_m) < 2:
            if key in self._moving:
                self._moving[key].visible = False
            return
        lines = np.stack([path_m[:-1], path_m[1:]], axis=1).astype(np.float32)
        self._moving[key] = self.server.scene.add_line_segments(key, lines, _rgb(INK), thickness=0.006)

    def _people(self, bodies: Sequence[FloatArray]) -> None:
        kept = set()
        for n, q in enumerate(bodies):
            for k, (body, T) in enumerate(zip(self._human.bodies, self._human.body_poses(q), strict=True)):
                key = f"/people/{n}/{k}"
                kept.add(key)
                if key not in self._moving:
                    self._moving[key] = _mesh(self.server.scene, key, body.shape.triangles(), _rgb(HUMAN))
                _place(self._moving[key], self._scene.T_world_human @ T)
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
        self._moving["occupancy"] = self.server.scene.add_point_cloud(
            "/occupancy",
            points.astype(np.float32),
            (255 * colours).astype(np.uint8),
            point_size=_SHRUNK * self._scene.grid.resolution_m,
            precision="float32",
        )

    def _say(self, moment: SpaceMoment) -> None:
        head = as_text(moment.state) if moment.t_s is None else f"**{moment.t_s:.2f} s** {as_text(moment.state)}"
        self._state.content = "\n\n".join([head, *_told(moment.decision)])
        likely = sorted(moment.posterior.items(), key=lambda entry: -entry[1])[:_BARS]
        for (label, bar), (name, value) in zip(self._bars, likely + [("", 0.0)] * (_BARS - len(likely)), strict=True):
            label.content = f"{as_text(name)} {value:.0%}" if name else ""
            set_value(bar, 100.0 * value)


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


def _place(handle: Any, T: FloatArray) -> None:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    handle.position, handle.wxyz = tuple(T[:3, 3]), (w, x, y, z)
    handle.visible = True


def set_value(control: Any, value: object) -> None:
    """Let a control of the page show a value."""
    control.value = value


def _rgb(colour: str) -> tuple[int, int, int]:
    r, g, b = (round(255 * part) for part in to_rgb(colour))
    return r, g, b
