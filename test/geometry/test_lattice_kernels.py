"""Look-ups in lattices, in blocks of single precision and one by one, against SciPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from humanpred_ros.geometry.chain_kernels import BLOCK, X, Y, Z
from humanpred_ros.geometry.compiled import fast
from humanpred_ros.geometry.lattice_kernels import (
    FREE_ROWS,
    VALUE,
    Lattice,
    all_above,
    corners,
    interpolate,
    nearest_nodes,
    values_at,
    voxels,
)


@fast
def looked_up(w, voxel, node, cell, lattice, nx, ny, nz, least):  # type: ignore[no-untyped-def]
    voxels(w, voxel, nx, ny, nz)
    nearest_nodes(w, node, nx, ny, nz)
    corners(w, cell, nx, ny, nz)
    interpolate(w, cell, lattice, ny, nz)
    return all_above(node, lattice, least)


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_block_of_places_is_looked_up_as_scipy_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = rng.integers(2, 9, 3)
    values = rng.normal(size=shape).astype(np.float32)
    places = rng.uniform(-2.0, shape + 1.0, (BLOCK, 3)).astype(np.float32)
    w = np.zeros(FREE_ROWS * BLOCK, dtype=np.float32)
    for row, column in zip((X, Y, Z), places.T, strict=True):
        w[row : row + BLOCK] = column
    voxel, node, cell = (np.zeros(BLOCK, dtype=np.uint32) for _ in range(3))
    nx, ny, nz = shape.tolist()
    least = np.float32(rng.normal())
    above = looked_up(w, voxel, node, cell, values.ravel(), nx, ny, nz, least)

    onto = np.clip(places, 0, shape - 1).astype(np.float32)
    np.testing.assert_array_equal(voxel, np.ravel_multi_index(onto.astype(int).T, shape))
    nearest = np.clip(places + np.float32(0.5), 0, shape - 1).astype(int)
    np.testing.assert_array_equal(node, np.ravel_multi_index(nearest.T, shape))
    assert above == bool((values[tuple(nearest.T)] > least).all())
    wanted = RegularGridInterpolator([np.arange(n) for n in shape], values.astype(np.float64))(onto)
    np.testing.assert_allclose(w[VALUE : VALUE + BLOCK], wanted, atol=1e-5)


@given(seed=st.integers(0, 2**32 - 1))
def test_places_are_looked_up_one_by_one_in_double_precision(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape, origin, cells_per_m = rng.integers(2, 9, 3), rng.normal(size=3), rng.uniform(0.5, 40.0)
    values = rng.normal(size=shape).astype(np.float32)
    cells = rng.uniform(-2.0, shape + 1.0, (20, 3))
    found = values_at(origin + cells / cells_per_m, Lattice(values, origin, cells_per_m))
    grid = RegularGridInterpolator([np.arange(n) for n in shape], values.astype(np.float64))
    np.testing.assert_allclose(found, grid(np.clip(cells, 0, shape - 1)), atol=1e-9)
