"""Triangle surfaces cut, covered and sampled, because kernels want points, spheres and boxes instead of meshes.

A surface is a float array (F, 3, 3): F triangles, three corners each, in metres. Every function is
deterministic, so the same URDF always gives the same points and spheres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray

Bounds = tuple[FloatArray, FloatArray]
"""Lower and upper corner (3,) of an axis-aligned box, metres."""

_FLAT_M = 1e-12
"""Corners closer to a cutting plane than this lie on it."""


def split(triangles: FloatArray, axis: int, at_m: float) -> tuple[FloatArray, FloatArray]:
    """Cut a surface by the plane `coordinate[axis] == at_m`.

    Returns:
        The parts below and above, (F1, 3, 3) and (F2, 3, 3); together they are the same surface.
    """
    below, above = [], []
    height = triangles[:, :, axis] - at_m
    crosses = (height.min(axis=1) < -_FLAT_M) & (height.max(axis=1) > _FLAT_M)
    whole_below = ~crosses & (height.max(axis=1) <= _FLAT_M)
    below.append(triangles[whole_below])
    above.append(triangles[~crosses & ~whole_below])
    corners, height = triangles[crosses], height[crosses]
    if len(corners):
        # Bring the corner that is alone on its side to the front: it makes one triangle, the others two.
        up = height > 0.0
        alone = np.where(up.sum(axis=1) == 1, np.argmax(up, axis=1), np.argmin(up, axis=1))
        order = (alone[:, None] + np.arange(3)) % 3
        corners = np.take_along_axis(corners, order[:, :, None], axis=1)
        height = np.take_along_axis(height, order, axis=1)
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab = a + (b - a) * (height[:, 0] / (height[:, 0] - height[:, 1]))[:, None]
        ac = a + (c - a) * (height[:, 0] / (height[:, 0] - height[:, 2]))[:, None]
        tip = np.stack([a, ab, ac], axis=1)
        rest = np.concatenate([np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)])
        tip_up = height[:, 0] > 0.0
        rest_up = np.concatenate([~tip_up, ~tip_up])
        below += [tip[~tip_up], rest[~rest_up]]
        above += [tip[tip_up], rest[rest_up]]
    return np.concatenate(below), np.concatenate(above)


def covering_spheres(triangles: FloatArray, max_radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Cover a surface with spheres no larger than `max_radius_m`.

    A piece whose smallest sphere would be too large is cut in half across its longest side. A sphere is
    convex, so one that holds the corners of a piece holds the whole piece: the cover has no gaps.

    Returns:
        Centres (S, 3) and radii (S,).
    """
    if not max_radius_m > 0:
        raise ArrayError(f"covering spheres: wanted a positive largest radius in metres, got {max_radius_m}")
    lower, upper = bounds(triangles)
    centre, radius = _enclosing_sphere(triangles.reshape(-1, 3))
    if radius <= max_radius_m:
        return centre[None], np.array([radius])
    axis = int(np.argmax(upper - lower))
    halves = split(triangles, axis, float(lower[axis] + upper[axis]) / 2.0)
    parts = [covering_spheres(half, max_radius_m) for half in halves]
    return np.concatenate([centres for centres, _ in parts]), np.concatenate([radii for _, radii in parts])


def _enclosing_sphere(points: FloatArray, steps: int = 128) -> tuple[FloatArray, float]:
    """Return a sphere that holds all points, nearly the smallest (Badoiu and Clarkson's core-set iteration).

    The centre is approximate, to about 1 / `steps` of the radius; the radius is exact for that centre.
    """
    points = np.unique(points, axis=0)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    for step in range(1, steps + 1):
        offset = points - centre
        farthest = int(np.argmax(np.einsum("pi,pi->p", offset, offset)))
        centre = centre + offset[farthest] / (step + 1)
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def covering_boxes(triangles: FloatArray, least_saving_m3: float) -> list[Bounds]:
    """Cover the solid inside a closed surface with axis-aligned boxes.

    Cells are cut across two axes; the third stays uncut. A line along it through a point of the solid leaves
    the solid through the surface within the same cell, so the bounding box of the surface in a cell also
    bounds the solid there; cuts across all three would leave hollows. The best of the three axes is taken.

    Args:
        triangles: (F, 3, 3) closed surface.
        least_saving_m3: a cell is cut only if that saves more than this volume.

    Returns:
        (lower (3,), upper (3,)) corners of each box.
    """
    if not least_saving_m3 > 0:
        raise ArrayError(f"covering boxes: wanted a positive volume to be saved by a cut, got {least_saving_m3}")
    covers = (_cell_boxes(triangles, uncut, least_saving_m3) for uncut in range(3))
    return min(covers, key=lambda boxes: sum(_volume(box) for box in boxes))


def _cell_boxes(triangles: FloatArray, uncut: int, least_saving_m3: float) -> list[Bounds]:
    box = lower, upper = bounds(triangles)
    if _volume(box) <= least_saving_m3:
        return [box]
    best: tuple[float, list[FloatArray]] = (_volume(box) - least_saving_m3, [])
    for axis in (axis for axis in range(3) if axis != uncut):
        for share in (0.25, 0.5, 0.75):
            halves = split(triangles, axis, float(lower[axis] + share * (upper[axis] - lower[axis])))
            volume = sum(_volume(bounds(half)) for half in halves if len(half))
            if volume < best[0]:
                best = (volume, [half for half in halves if len(half)])
    return [part for half in best[1] for part in _cell_boxes(half, uncut, least_saving_m3)] or [box]


def _volume(box: Bounds) -> float:
    return float(np.prod(box[1] - box[0]))


def sample(triangles: FloatArray, spacing_m: float) -> FloatArray:
    """Spread points over a surface, each at least `spacing_m` from the others.

    Farthest-point sampling of a fine lattice on the triangles: it stops when every lattice point lies
    closer than `spacing_m` to a sample, so samples are neither crowded nor missing.

    Returns:
        (P, 3) points on the surface.
    """
    if not spacing_m > 0:
        raise ArrayError(f"surface samples: wanted a positive spacing in metres, got {spacing_m}")
    candidates = _lattice(triangles, spacing_m / 4.0)
    lower, upper = bounds(triangles)
    # Rounding decides ties the same way whatever the order in which a machine adds up squares.
    far = np.round(((candidates - (lower + upper) / 2.0) ** 2).sum(axis=1), 12)
    chosen = [int(np.argmax(far))]
    nearest = np.full(len(candidates), np.inf)
    while True:
        nearest = np.minimum(nearest, np.round(((candidates - candidates[chosen[-1]]) ** 2).sum(axis=1), 12))
        farthest = int(np.argmax(nearest))
        if nearest[farthest] < spacing_m**2:
            break
        chosen.append(farthest)
    points: FloatArray = candidates[chosen]
    return points


def bounds(triangles: FloatArray) -> Bounds:
    """Return the lower and upper corner (3,) of a surface's bounding box."""
    if len(triangles) == 0:
        raise ArrayError("surface: wanted at least one triangle, got none")
    corners = triangles.reshape(-1, 3)
    return corners.min(axis=0), corners.max(axis=0)


def _lattice(triangles: FloatArray, step_m: float) -> FloatArray:
    """Return barycentric lattice points of every triangle, at most `step_m` apart along its edges."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    counts: NDArray[np.int64] = np.maximum(1, np.ceil(longest / step_m)).astype(np.int64)
    points = []
    for n in np.unique(counts):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        weight = np.stack([i[inside], j[inside], n - i[inside] - j[inside]], axis=1) / n
        points.append((weight @ triangles[counts == n]).reshape(-1, 3))
    return np.concatenate(points)
