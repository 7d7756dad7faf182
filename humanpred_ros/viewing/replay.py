"""A run as data for the 3D replay within a page: what stands still once, what moves as poses over time.

`templates/replay.html.j2` draws it in any browser with WebGL 2, without a network or a library, and lets the rest of
the page point to a time. Arrays travel as base64: places in whole millimetres, probabilities in 255ths.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from humanpred_ros import __version__
from humanpred_ros.errors import printable
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import INK, goal_colours
from humanpred_ros.viewing.playback import Recording
from humanpred_ros.viewing.plots_space import HUMAN, ROBOT, WOOD
from humanpred_ros.viewing.space import VIEWS, said

_TEMPLATES = Path(__file__).resolve().parent / "templates"
#: Moments are so far apart, or farther where the run is long; occupancies hold so many voxels together.
_FRAME_S, _MOST_FRAMES, _MOST_VOXELS = 1.0 / 15.0, 400, 350_000
#: Voxels of less probability are left out.
_LEAST_PROBABILITY = 0.05


def environment() -> Environment:
    """Return what fills this package's templates."""
    return Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def replay_page(recording: Recording) -> str:
    """Return a page that holds the replay alone."""
    title = f"{recording.scene.name}: replay"
    return environment().get_template("replay_page.html.j2").render(
        title=title, replay=replay_data(recording), version=__version__
    )  # fmt: skip


def replay_data(recording: Recording) -> Markup:
    """Return the data of a run's replay as JSON that may stand within a page's script element."""
    run, scene, human = recording.run, recording.scene, recording.human
    n = int(min(_MOST_FRAMES, np.ceil(run.duration_s / _FRAME_S) + 1))
    times = np.linspace(0.0, run.duration_s, max(n, 2))
    moments = [recording.at(float(t_s)) for t_s in times]
    still = [
        _mesh(o.shape.triangles() @ o.T_world_shape[:3, :3].T + o.T_world_shape[:3, 3], WOOD) for o in scene.obstacles
    ]
    still += [_mesh(s.triangles @ T[:3, :3].T + T[:3, 3], ROBOT) for s, T in scene.arm.standing_surfaces()]
    links = [_mesh(np.concatenate([s.triangles for s in surfaces]) if surfaces else np.zeros((0, 3, 3)), ROBOT)
             for surfaces in scene.arm.moving_surfaces()]  # fmt: skip
    bodies = [_mesh(body.shape.triangles(), HUMAN) for body in human.bodies]
    colours = goal_colours([goal.name for goal in scene.goals])
    tasks = [
        {
            "name": printable(goal.name),
            "at": scene.arm.chain.tool_pose(goal.configurations[0])[:3, 3].round(4).tolist(),
            "colour": colours[goal.name],
        }
        for goal in scene.goals
    ]
    middle = np.mean([task["at"] for task in tasks] or [scene.T_world_human[:3, 3]], axis=0)
    ahead = (middle - scene.T_world_human[:3, 3])[:2]
    data: Mapping[str, Any] = {
        "t": times.round(4).tolist(),
        "said": [said(moment) for moment in moments],
        "turns": [[round(t_s, 3), printable(text)] for t_s, text in recording.turns],
        "steps": [[row.step, round(row.t_s, 4)] for row in run.steps],
        "still": still,
        "robot": {"meshes": links, "poses": _poses([_arm(recording, m.q_arm) for m in moments], len(links))},
        "ghost": {"meshes": [], "poses": _poses([_arm(recording, m.q_goal) for m in moments], len(links))},
        "people": {
            "meshes": bodies,
            "poses": _poses(
                [next((scene.T_world_human @ human.body_poses(q) for q in m.bodies.values()), None) for m in moments],
                len(bodies),
            ),
        },
        "paths": ["" if m.tool_path_m is None else _packed(_mm(m.tool_path_m)) for m in moments],
        "occupancy": _occupancies(recording),
        "voxel": scene.grid.resolution_m,
        "tasks": tasks,
        "views": {name: list(view) for name, view in VIEWS.items()},
        "middle": middle.round(4).tolist(),
        "ahead": (ahead / max(float(np.linalg.norm(ahead)), 1e-9)).round(4).tolist(),
        "ink": INK,
    }
    return Markup(json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def _arm(recording: Recording, q: FloatArray | None) -> FloatArray | None:
    return None if q is None or not np.isfinite(q).all() else recording.scene.arm.chain.link_poses(q)


def _poses(moments: Sequence[FloatArray | None], n: int) -> str:
    """Return the poses (T, n, 3, 4) of moments; what is not known is NaN."""
    table = np.full((len(moments), n, 3, 4), np.nan, dtype=np.float32)
    for row, poses in zip(table, moments, strict=True):
        if poses is not None:
            row[:] = np.asarray(poses)[:, :3]
    return _packed(table)


def _occupancies(recording: Recording) -> list[dict[str, Any]]:
    """Return the occupancies that were kept, or so many of them that they find room."""
    kept = []
    for snapshot in recording.occupancies:
        likely = snapshot.probability >= _LEAST_PROBABILITY
        kept.append((snapshot.t_s, snapshot.centres_m[likely], snapshot.probability[likely]))
    every = max(1, int(np.ceil(sum(len(p) for _, _, p in kept) / _MOST_VOXELS)))
    return [
        {"t": round(t_s, 4), "at": _packed(_mm(at)), "p": _packed(np.round(255.0 * p).clip(0, 255).astype(np.uint8))}
        for t_s, at, p in kept[::every]
    ]


def _mesh(triangles: FloatArray, colour: str) -> dict[str, str]:
    return {"at": _packed(_mm(triangles)), "colour": colour}


def _mm(points_m: FloatArray) -> NDArray[np.int16]:
    limits = np.iinfo(np.int16)
    return np.round(1e3 * np.asarray(points_m)).clip(limits.min, limits.max).astype(np.int16)


def _packed(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes()).decode("ascii")
