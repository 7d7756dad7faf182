"""Makes the pictures of README and docs/ from the code: `python docs/pictures.py [RUN] [--only NAME ...]`.

RUN is the folder of a run of `humanpred demo`; without it one is made. Everything else is computed here, from what the
package ships. Files go to docs/pictures/.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import font_manager
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from PIL import Image, ImageDraw, ImageFont

import humanpred_ros as hp
from humanpred_ros.viewing.figures import INK, MUTED, SERIES, WASH, goal_colours, new_figure, report_style
from humanpred_ros.viewing.playback import Recording
from humanpred_ros.viewing.plots_space import HUMAN, PROBABILITY, ROBOT, WOOD
from humanpred_ros.viewing.run import read_run
from humanpred_ros.viewing.workcell import load_workcell

FOLDER = Path(__file__).parent / "pictures"
#: Drawn so much larger than kept: smooth edges.
OVERSAMPLING = 2
LIGHT = np.array([-0.4, -0.3, 0.85]) / np.linalg.norm([-0.4, -0.3, 0.85])
#: Voxels that are less probable are not drawn in 3D.
LEAST_PROBABILITY = 0.3


class Painter:
    """Draws triangles and voxels in perspective, the farthest first."""

    def __init__(self, eye_m: Any, target_m: Any, size: tuple[int, int], *, field_of_view_rad: float = 0.75) -> None:
        ahead = (np.asarray(target_m) - eye_m) / np.linalg.norm(np.asarray(target_m) - eye_m)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self.eye, self.axes = np.asarray(eye_m), np.stack([right, -np.cross(right, ahead), ahead])
        self.size = OVERSAMPLING * np.asarray(size)
        self.focus = self.size[1] / 2 / np.tan(field_of_view_rad / 2)
        self.faces: list[tuple[float, list[tuple[float, float]], tuple[int, ...]]] = []

    def project(self, points_m: Any) -> tuple[Any, Any]:
        """Return places on the picture (..., 2) and depths (...) of points (..., 3)."""
        seen = (np.asarray(points_m) - self.eye) @ self.axes.T
        depth = np.maximum(seen[..., 2], 0.05)
        return self.size / 2 + self.focus * seen[..., :2] / depth[..., None], depth

    def triangles(self, corners_m: Any, colour: str, opacity: float = 1.0) -> None:
        """Add triangles (N, 3, 3), shaded by how they face the light."""
        normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        shade = 0.62 + 0.38 * np.abs(normal @ LIGHT)
        places, depth = self.project(corners_m)
        rgb = np.clip(255 * shade[:, None] * np.array(to_rgb(colour)), 0, 255).astype(int)
        for place, d, (r, g, b) in zip(places, depth.mean(axis=1), rgb, strict=True):
            self.faces.append((d, [tuple(p) for p in place], (r, g, b, int(255 * opacity))))

    def voxels(self, centres_m: Any, probability: Any, edge_m: float) -> None:
        """Add voxels (N, 3) as squares, coloured by probability."""
        places, depth = self.project(centres_m)
        colours = (255 * PROBABILITY(probability)).astype(int)
        for (x, y), d, colour in zip(places, depth, colours, strict=True):
            r = 0.22 * edge_m * self.focus / d
            self.faces.append((d, [(x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r)], (*colour[:3], 100)))

    def picture(self) -> tuple[Image.Image, ImageDraw.ImageDraw]:
        """Return what was added as a picture, still oversampled, and what one draws on it with."""
        image = Image.new("RGB", tuple(self.size), WASH)
        draw = ImageDraw.Draw(image, "RGBA")
        for _, place, colour in sorted(self.faces, key=lambda face: -face[0]):
            draw.polygon(place, fill=colour)
        return image, draw


@cache
def font(size: int, weight: str = "normal") -> ImageFont.FreeTypeFont:
    path = font_manager.findfont(font_manager.FontProperties(family="DejaVu Sans", weight=weight))
    return ImageFont.truetype(path, OVERSAMPLING * size)


def smaller(image: Image.Image) -> Image.Image:
    return image.resize((image.width // OVERSAMPLING, image.height // OVERSAMPLING), Image.Resampling.LANCZOS)


@cache
def recording(folder: Path) -> Recording:
    run = read_run(folder)
    return Recording(run, load_workcell(run))


def painted(recorded: Recording, t_s: float, size: tuple[int, int], view: tuple[float, float, float]) -> Any:
    """Return a picture of a run at one time, and what one draws on it with."""
    scene, human, moment = recorded.scene, recorded.human, recorded.at(t_s)
    tasks_m = {goal.name: scene.arm.chain.tool_pose(goal.configurations[0])[:3, 3] for goal in scene.goals}
    middle = np.mean(list(tasks_m.values()), axis=0) + np.array([0.0, 0.0, 0.12])
    ahead = (middle - scene.T_world_human[:3, 3]) * [1.0, 1.0, 0.0]
    ahead /= np.linalg.norm(ahead)
    aside = np.array([-ahead[1], ahead[0], 0.0])
    painter = Painter(middle + view[0] * ahead + view[1] * aside + [0.0, 0.0, view[2]], middle, size)
    for obstacle in scene.obstacles:
        T = obstacle.T_world_shape
        painter.triangles(finer(obstacle.shape.triangles() @ T[:3, :3].T + T[:3, 3]), WOOD)
    for surface, T in scene.arm.standing_surfaces():
        painter.triangles(surface.triangles @ T[:3, :3].T + T[:3, 3], ROBOT)
    for q, opacity in ((moment.q_goal, 0.25), (moment.q_arm, 1.0)):
        if q is not None:
            for T, surfaces in zip(scene.arm.chain.link_poses(q), scene.arm.moving_surfaces(), strict=True):
                for surface in surfaces:
                    painter.triangles(surface.triangles @ T[:3, :3].T + T[:3, 3], ROBOT, opacity)
    for q in moment.bodies:
        for body, T in zip(human.bodies, human.body_poses(q), strict=True):
            T = scene.T_world_human @ T
            painter.triangles(body.shape.triangles() @ T[:3, :3].T + T[:3, 3], HUMAN)
    kept = moment.probability >= LEAST_PROBABILITY
    painter.voxels(moment.centres_m[kept], moment.probability[kept], scene.grid.resolution_m)
    image, draw = painter.picture()
    colours = goal_colours([*tasks_m])
    chosen = moment.decision.chosen if moment.decision else ""
    for name, place in tasks_m.items():
        (x, y), r = painter.project(place)[0], 6 * OVERSAMPLING
        ring = 3 * r if name == chosen else r
        draw.ellipse((x - r, y - r, x + r, y + r), fill=colours[name])
        draw.ellipse((x - ring / 1.7, y - ring / 1.7, x + ring / 1.7, y + ring / 1.7), outline=colours[name], width=4)
        draw.text((x + 1.9 * r, y), name, fill=INK, font=font(11), anchor="lm", stroke_width=3, stroke_fill=WASH)
    if moment.tool_path_m is not None and len(moment.tool_path_m) > 1:
        draw.line([tuple(p) for p in painter.project(moment.tool_path_m)[0]], fill=INK, width=2 * OVERSAMPLING)
    return image, draw, moment


def finer(triangles_m: Any, longest_m: float = 0.12) -> Any:
    """Return triangles cut until their sides are short, which sorting by depth needs."""
    sides = np.linalg.norm(triangles_m - np.roll(triangles_m, -1, axis=1), axis=2)
    if sides.max(initial=0.0) <= longest_m:
        return triangles_m
    cut, kept = triangles_m[sides.max(axis=1) > longest_m], triangles_m[sides.max(axis=1) <= longest_m]
    a, b, c = cut[:, 0], cut[:, 1], cut[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([kept, finer(np.concatenate(parts), longest_m)])


def told(draw: ImageDraw.ImageDraw, moment: Any, size: tuple[int, int]) -> None:
    """Write time, classes and decision beside the picture of a moment."""
    s, x, y = OVERSAMPLING, OVERSAMPLING * 14, OVERSAMPLING * 12
    draw.text((x, y), f"{moment.t_s:.1f} s", fill=INK, font=font(20, "bold"))
    y += 32 * s
    draw.text((x, y), "the person reaches for", fill=INK, font=font(11))
    likely = sorted(moment.posterior.items(), key=lambda entry: entry[0])
    for label, p in likely:
        y += 17 * s
        draw.text((x, y), label, fill=INK, font=font(10))
        draw.rectangle((x + 92 * s, y + 2 * s, x + 92 * s + 80 * s, y + 11 * s), fill="#e4e7eb")
        draw.rectangle((x + 92 * s, y + 2 * s, x + 92 * s + int(80 * s * p), y + 11 * s), fill=HUMAN)
    decision = moment.decision
    if decision is not None and decision.chosen:
        verb = {"arrived": "the arm has arrived at"}.get(decision.action, "the arm goes to")
        draw.text((x, s * size[1] - 30 * s), f"{verb} {decision.chosen}", fill=INK, font=font(15, "bold"))


SIDE = (0.35, 2.35, 0.95)


def animation(folder: Path) -> Iterator[tuple[str, Any]]:
    """The demo's run, as README shows it."""
    size, recorded, frames = (760, 430), recording(folder), []
    for t_s in np.arange(0.0, recorded.run.duration_s, 0.1):
        image, draw, moment = painted(recorded, float(t_s), size, SIDE)
        told(draw, moment, size)
        frames.append(smaller(image))
    durations = [100] * (len(frames) - 1) + [1500]
    yield (
        "demo.webp",
        lambda path: frames[0].save(
            path, save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=60, method=6
        ),
    )


def saved(figure: Any) -> Callable[[Path], None]:
    """Return what saves a figure."""

    def save(path: Path) -> None:
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(110)
        figure.set_facecolor(WASH)
        canvas.draw()
        # All colours are kept: with a palette, lines of few pixels would get each other's.
        Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").save(path, optimize=True)

    return save


#: Share of a reach after which it is looked at: the hand is on its way.
EARLY = 0.17
#: A reach of the shipped library that nothing below learns from, and the class whose reaches are compared.
REACH, SHOWN_CLASS = "3/2", "3"


@cache
def library() -> hp.MotionLibrary:
    return hp.load_library("synthetic_reaches")


@cache
def held_out() -> tuple[hp.Motion, ...]:
    """Motions that are not learned from: the first three of each class."""
    return tuple(motion for label in library().labels for motion in library().of_class(label)[:3])


@cache
def model() -> Any:
    left_out = {motion.name for motion in held_out()}
    return hp.train(library().select(lambda motion: motion.name not in left_out), ["forest", "gmm"])


@cache
def scene() -> Any:
    return hp.load_scene("four_places")


def moments(_: Path = Path()) -> Iterator[tuple[str, Any]]:
    """Three moments of the demo's run."""
    recorded, size = recording(_), (460, 400)
    turn_s = recorded.turns[0][0] if recorded.turns else 0.3 * recorded.run.duration_s
    images = []
    for t_s in (0.2, turn_s, 0.75 * recorded.run.duration_s):
        image, draw, moment = painted(recorded, float(t_s), size, SIDE)
        chosen = f", the arm goes to {moment.decision.chosen}" if moment.decision else ""
        draw.text((20, 16), f"{t_s:.1f} s{chosen}", fill=INK, font=font(13, "bold"))
        images.append(smaller(image))
    strip = Image.new("RGB", (sum(image.width for image in images), images[0].height), WASH)
    for k, image in enumerate(images):
        strip.paste(image, (k * image.width, 0))
    yield "moments.webp", lambda path: strip.save(path, quality=72, method=6)


def run_plots(folder: Path) -> Iterator[tuple[str, Any]]:
    """The report's plots of the demo's run."""
    from humanpred_ros.viewing.analysis import analyse
    from humanpred_ros.viewing.report import _PLOTS

    analysis = analyse(read_run(folder))
    for key in ("top-view", "posterior", "goal-costs", "predictions", "clearance", "cost-terms"):
        yield f"{key.replace('-', '_')}.png", saved(_PLOTS[key](analysis))


def recognition(_: Path) -> Iterator[tuple[str, Any]]:
    """Probability of the true class along reaches that were not learned from."""
    figure = new_figure(2.6, 8.0)
    share = np.linspace(0.0, 1.0, 41)
    for axes, (name, title) in zip(
        figure.subplots(1, 2, sharey=True),
        (("forest", "forest, the default"), ("gmm", "gmm, as published")),
        strict=True,
    ):
        curves = []
        for motion in held_out():
            classifier = model().classifier(name)
            classifier.start()
            told = [classifier.update(q, t).of(motion.label) for t, q in zip(motion.t_s, motion.q, strict=True)]
            curves.append(np.interp(share, np.linspace(0.0, 1.0, len(told)), told))
        axes.plot(100 * share, np.transpose(curves), color=MUTED, linewidth=0.6, alpha=0.6)
        axes.plot(100 * share, np.median(curves, axis=0), color=SERIES[0], linewidth=2.6)
        axes.set_title(title)
        axes.set_xlabel("% of the motion")
        axes.set_ylim(0, 1.02)
    figure.axes[0].set_ylabel("probability of the true class")
    yield "recognition.png", saved(figure)


def from_above(axes: Any, grid: Any, probability: Any, title: str) -> None:
    """Draw a lattice of probabilities, each cell as its most probable voxel."""
    x0, y0 = grid.origin_m[0], grid.origin_m[1]
    edge = grid.resolution_m
    top = np.ma.masked_less(probability.max(axis=2).T, 0.02)
    extent = (x0, x0 + edge * grid.shape[0], y0, y0 + edge * grid.shape[1])
    axes.imshow(top, origin="lower", extent=extent, cmap=PROBABILITY, vmin=0, vmax=1)
    axes.grid(False)
    axes.set(title=title, xlim=(-1.0, 0.8), ylim=(-1.9, 0.2), xlabel="x in m")


def occupancy(_: Path) -> Iterator[tuple[str, Any]]:
    """What four predictors say early in a reach, and what was swept."""
    motion = library().find(REACH)
    seen = int(EARLY * len(motion))
    figure = new_figure(2.9, 10.5)
    panels = figure.subplots(1, 5, sharex=True, sharey=True)
    for axes, name in zip(panels, ("current", "constant_velocity", "swept_volume", "forecast"), strict=False):
        options = {"classifier": "gmm"} if name == "swept_volume" else {}
        predictor = hp.make_predictor(name, scene(), model(), **options)
        predictor.start()
        for t_s, q in zip(motion.t_s[:seen], motion.q[:seen], strict=True):
            said = predictor.update(q, t_s).occupancy.probability
        from_above(axes, scene().grid, said, f"{name}{' (P1)' if name == 'swept_volume' else ''}")
    from humanpred_ros.occupancy.voxeliser import BodyVoxeliser

    swept = BodyVoxeliser(model().human, scene().grid, scene().T_world_human).mask(motion.q[seen:])
    from_above(panels[-1], scene().grid, swept.astype(float), "really swept")
    panels[0].set_ylabel("y in m")
    yield "occupancy.png", saved(figure)


def palms(q: Any) -> Any:
    """Return the palm's places of postures (..., D), world frame."""
    T = scene().T_world_human
    shape = np.shape(q)[:-1]
    local = model().human.forward(np.reshape(q, (-1, np.shape(q)[-1])))["right_palm"]
    return (local @ T[:3, :3].T + T[:3, 3]).reshape(*shape, 3)


def learning(_: Path) -> Iterator[tuple[str, Any]]:
    """A reach, and reaches drawn around it."""
    from humanpred_ros.motion.motion import resample_phase
    from humanpred_ros.reaching.demonstrations import SamplingSettings, smooth_noise

    q = resample_phase(library().find(REACH), 100).q
    noise = smooth_noise(np.random.default_rng(0), 60, *q.shape)
    drawn = palms(q + SamplingSettings().deviation * noise)
    figure = new_figure(2.9, 8.0)
    for axes, (i, j, name) in zip(figure.subplots(1, 2), ((0, 1, "y"), (1, 2, "z")), strict=True):
        axes.plot(drawn[:, :, i].T, drawn[:, :, j].T, color=SERIES[4], linewidth=0.7, alpha=0.7)
        axes.plot(palms(q)[:, i], palms(q)[:, j], color=INK, linewidth=2.2)
        axes.set(xlabel=f"{'xyz'[i]} of the palm in m", ylabel=f"{name} in m")
        axes.set_title("from above" if i == 0 else "from the side")
    yield "learning.png", saved(figure)


def futures(_: Path) -> Iterator[tuple[str, Any]]:
    """The futures that the predictor of reaches makes up for each place."""
    predictor = hp.make_predictor("reaching", scene(), model())
    motion = library().find(REACH)
    predictor.start()
    seen = int(EARLY * len(motion))
    for t_s, q in zip(motion.t_s[:seen], motion.q[:seen], strict=True):
        posterior = predictor.update(q, t_s).posterior
    figure = new_figure(3.6, 6.0)
    axes = figure.subplots()
    T = scene().T_world_human
    for k, (label, place) in enumerate(predictor.places.items()):
        colour, p = SERIES[k % len(SERIES)], posterior.of(label)
        x, y, _z = T[:3, :3] @ np.asarray(place) + T[:3, 3]
        axes.plot(x, y, "s", color=colour, markersize=8, markeredgecolor="white", zorder=4)
        axes.annotate(f"{label}: {p:.0%}", (x, y), xytext=(6, 5), textcoords="offset points", fontsize=8, color=colour)
        ways = predictor._futures.towards(predictor._classifier.progress, np.asarray(place))
        for way in palms(ways):
            axes.plot(way[:, 0], way[:, 1], color=colour, linewidth=0.8, alpha=0.12 + 0.8 * p)
    past = palms(motion.q[:seen])
    axes.plot(past[:, 0], past[:, 1], color=INK, linewidth=2.4)
    axes.set(xlabel="x in m", ylabel="y in m", aspect="equal")
    yield "futures.png", saved(figure)


def warping(_: Path) -> Iterator[tuple[str, Any]]:
    """Two reaches, aligned by time warping."""
    from humanpred_ros.motion.motion import resample_phase

    one, other = (palms(resample_phase(motion, 40).q) for motion in library().of_class(SHOWN_CLASS)[:2])
    costs = np.linalg.norm(one[:, None] - other[None], axis=2)
    total = np.full((41, 41), np.inf)
    total[0, 0] = 0.0
    for i in range(40):
        for j in range(40):
            total[i + 1, j + 1] = costs[i, j] + min(total[i, j + 1], total[i + 1, j], total[i, j])
    figure = new_figure(2.6, 8.0)
    axes = figure.subplots()
    i = j = 39
    while i or j:
        axes.plot([i, j], [one[i, 1], other[j, 1]], color=MUTED, linewidth=0.7)
        i, j = min(
            ((i - 1, j - 1), (i - 1, j), (i, j - 1)),
            key=lambda ij: total[ij[0] + 1, ij[1] + 1] if min(ij) >= 0 else np.inf,
        )
    axes.plot(one[:, 1], color=SERIES[0], linewidth=2.2, label="predicted, say")
    axes.plot(other[:, 1], color=SERIES[1], linewidth=2.2, label="recorded")
    axes.set(xlabel="moment", ylabel="y of the palm in m")
    axes.legend()
    yield "warping.png", saved(figure)


def predicted() -> Any:
    """Return the occupancy that is predicted early in the reach."""
    motion = library().find(REACH)
    seen = int(EARLY * len(motion))
    predictor = hp.make_predictor("forecast", scene(), model())
    predictor.start()
    for t_s, q in zip(motion.t_s[:seen], motion.q[:seen], strict=True):
        said = predictor.update(q, t_s).occupancy
    return said


def stomp(_: Path) -> Iterator[tuple[str, Any]]:
    """STOMP's noise, and how a way becomes better."""
    from humanpred_ros.planning.person import widened
    from humanpred_ros.stomp.costs import HumanOccupancyCost, SmoothnessCost
    from humanpred_ros.stomp.planner import StompPlanner

    arm, said = scene().arm, predicted()
    goal = next(goal for goal in scene().goals if goal.name == "place 5")
    line = scene().start + np.linspace(0.0, 1.0, 100)[:, None] * arm.difference(scene().start, goal.configurations[0])
    near = widened(said, hp.ReplannerConfig().human_margin_m)
    terms = [HumanOccupancyCost(arm.chain, arm.body_points(), near), SmoothnessCost()]
    planner = StompPlanner(terms, arm.chain.lower, arm.chain.upper)
    figure = new_figure(3.2, 8.0)
    noise, ways = figure.subplots(1, 2, sharex=True, sharey=True)
    run = planner.begin(line, np.random.default_rng(0))

    def drawn(axes: Any, q: Any, **how: Any) -> None:
        places = arm.chain.tool_pose(np.asarray(q, dtype=np.float64))[:, :3, 3]
        axes.plot(places[:, 0], places[:, 1], **how)

    run.advance(1)
    for seed in range(2):
        other = planner.begin(line, np.random.default_rng(seed))
        other.advance(1)
        for rollout in other.rollouts:
            drawn(noise, rollout, color=SERIES[4], linewidth=0.8)
    drawn(noise, line, color=INK, linewidth=2.2)
    noise.set_title("noisy ways around the first guess")
    from_above(ways, said.grid, said.probability, "0, 5 and 50 iterations")
    for count, colour in ((0, MUTED), (4, SERIES[2]), (45, SERIES[0])):
        run.advance(count)
        drawn(ways, line if colour == MUTED else run.result().waypoints, color=colour, linewidth=2.2)
    ways.set(xlim=(-0.9, 0.7), ylim=(-1.2, 0.1))
    for axes in (noise, ways):
        axes.set(xlabel="x of the tool in m", aspect="equal")
    noise.set_ylabel("y in m")
    yield "stomp.png", saved(figure)


def costs(_: Path) -> Iterator[tuple[str, Any]]:
    """The cost of an obstacle by distance, and of the person in space."""
    from humanpred_ros.planning.person import widened

    figure = new_figure(2.9, 10.0)
    curve, told, charged = figure.subplots(1, 3)
    c, d = 0.10, np.linspace(-0.1, 0.2, 200)
    potential = np.where(d >= c, 0.0, np.where(d >= 0.0, (d - c) ** 2 / (2 * c), c / 2 - d))
    curve.plot(d, potential, color=SERIES[0], linewidth=2.4)
    curve.axvline(0.0, color=MUTED, linewidth=0.8)
    curve.set(xlabel="distance from the obstacle in m", ylabel="cost", title="obstacle")
    said = predicted()
    near = widened(said, hp.ReplannerConfig().human_margin_m)
    for axes, shown, title in ((told, said, "probability, 0.9 m above the floor"), (charged, near, "what is charged")):
        layer = int((0.9 - shown.grid.origin_m[2]) / shown.grid.resolution_m)
        from_above(axes, shown.grid, shown.probability[:, :, layer : layer + 1], title)
    yield "costs.png", saved(figure)


def separation(_: Path) -> Iterator[tuple[str, Any]]:
    """How fast the guard lets the arm be, by distance."""
    from humanpred_ros.planning.protective_distance import ProtectiveDistance, SeenBody

    figure = new_figure(2.8, 8.0)
    axes = figure.subplots()
    posture = library().find(REACH).q[0]
    velocity = np.zeros(len(scene().start))  # it is taken to set out towards the person
    ahead = palms(posture[None])[0] - scene().arm.chain.tool_pose(scene().start[None])[0, :3, 3]
    ahead = np.array([ahead[0], ahead[1], 0.0]) / np.linalg.norm(ahead[:2])
    cases = (("stands still", 0.0), ("comes at 0.8 m/s", 0.8), ("speed not known (1.6 m/s)", None))
    for (name, speed), colour in zip(cases, (SERIES[2], SERIES[0], SERIES[1]), strict=True):
        curve = []
        for shift in np.linspace(-1.3, 0.9, 70):
            T = scene().T_world_human.copy()
            T[:3, 3] += shift * ahead
            guard, body = ProtectiveDistance(model().human, scene().arm, T), SeenBody()
            for k in range(1 if speed is None else 10):
                moved = posture.copy()
                if speed:
                    moved[:3] -= T[:3, :3].T @ ahead * speed * (k - 9) / 30.0
                body.see(moved, 1.0 + k / 30.0)
            found = guard.separation([body], scene().start, velocity, 1.0)
            curve.append((found.least_m, found.factor))
        curve = np.array(sorted(curve))
        axes.plot(curve[:, 0], 100 * curve[:, 1], color=colour, linewidth=2.4, label=name)
    axes.set(xlabel="least distance of arm and body in m", ylabel="speed allowed in %", xlim=(0, 1.2), ylim=(-2, 104))
    axes.legend(title="the person", loc="lower right")
    yield "separation.png", saved(figure)


PICTURES: dict[str, Callable[[Path], Iterator[tuple[str, Any]]]] = {
    function.__name__: function
    for function in (
        animation, moments, run_plots, recognition, occupancy, learning, futures, warping, stomp, costs, separation,
    )
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", nargs="?", type=Path)
    parser.add_argument("--only", nargs="+", choices=PICTURES, default=list(PICTURES))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made, report_style():
        folder = given.run or Path(made) / "run"
        if given.run is None:
            subprocess.run([sys.executable, "-m", "humanpred_ros.cli", "demo", "--out", str(folder)], check=True)
        FOLDER.mkdir(exist_ok=True)
        for name in given.only:
            for file, save in PICTURES[name](folder):
                save(FOLDER / file)
                print(f"{FOLDER / file}: {(FOLDER / file).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
