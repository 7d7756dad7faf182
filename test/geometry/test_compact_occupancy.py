"""The compact form of an occupancy: what it keeps, and that nothing damaged is believed."""

from __future__ import annotations

import re
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.compact_occupancy import NOBODY, UNKNOWN, lattice_text, packed, unpacked
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid, codes_of, probability_of_code

GRID = VoxelGrid((-1.0, 0.1, 0.3), 0.05, (7, 9, 5))
PROBABILITIES = st.floats(0.0, 1.0, width=32, exclude_min=True)


def occupancy(n: int, seed: int = 0) -> Occupancy:
    rng = np.random.default_rng(seed)
    p = np.zeros(GRID.size, dtype=np.float32)
    p[rng.choice(GRID.size, n, replace=False)] = rng.choice(np.float32([1e-9, 0.002, 0.3, 0.5, 0.99999, 1.0]), n)
    return Occupancy(GRID, p.reshape(GRID.shape), 2.0)


@given(PROBABILITIES, st.floats(0.0078125 + 2**-10, 1.0, width=32))
def test_a_probability_keeps_what_a_planner_asks_of_it(p: float, threshold: float) -> None:
    kept = float(probability_of_code()[codes_of(np.array([p], dtype=np.float32))][0])
    assert abs(kept - p) <= 1.0 / 255.0 + 1e-7
    assert kept > 0.0
    assert (kept == 1.0) == (p == 1.0)
    assert kept >= threshold or p < threshold
    assert probability_of_code()[codes_of(np.array([kept], dtype=np.float32))][0] == np.float32(kept)


@pytest.mark.parametrize("n", [0, 1, 2, 40, GRID.size])
@pytest.mark.parametrize("threshold", [0.0, 0.001])
def test_what_is_unpacked_is_what_survives_publication(n: int, threshold: float) -> None:
    given = occupancy(n)
    text, image = packed(given, threshold)
    back = unpacked(text, image, GRID, 2.0)
    assert np.array_equal(back.probability, given.sparse(threshold).probability)
    assert unpacked(text, image).grid == GRID


def test_who_says_nobody_or_unknown() -> None:
    assert not unpacked(f"{NOBODY}{lattice_text(GRID)}", b"", GRID).probability.any()
    with pytest.raises(ArrayError, match="where people are is not known: jump"):
        unpacked(f"{UNKNOWN}jump", b"", GRID)


@pytest.mark.parametrize("at", range(0, 200, 7))
def test_a_damaged_image_is_refused(at: int) -> None:
    text, image = packed(occupancy(60), 0.0)
    spoilt = bytearray(image)
    spoilt[at % len(image)] ^= 0x10
    for wrong in (bytes(spoilt), image[: at % len(image)], image + bytes(at + 1)):
        with pytest.raises(ArrayError, match="compact occupancy"):
            unpacked(text, wrong, GRID)


@pytest.mark.parametrize(
    ("pattern", "text", "message"),
    [
        (r"box \d+", "box 6", "box"),
        (r"box \d+", "box -1", "compact occupancy"),
        (r"box .*", "box 0 0 0 0 0 0", "empty box"),
        (r"box .*", "box 0 0 0 0 9 5", "within"),
        (r"; box .*", "", "compact occupancy"),
        (r"lattice \S+", "lattice 1.0", "other lattice"),
        (r"lattice \S+", "lattice nan", "compact occupancy"),
        (r" 0.05 ", " 0.06 ", "other lattice"),
        (r" 0.05 ", " 0.0 ", "grid"),
        (r"7 9 5;", "70000 90000 50000;", "grid"),
        (r"7 9 5;", "7 9 6;", "other lattice"),
        (r"mono8", "rgb8", "compact occupancy"),
        (r".*", "", "compact occupancy"),
    ],
)
def test_a_text_that_says_something_else_is_refused(pattern: str, text: str, message: str) -> None:
    told, image = packed(occupancy(40), 0.0)
    with pytest.raises(ArrayError, match=message):
        unpacked(re.sub(pattern, text, told, count=1), image, GRID)


def test_an_image_that_unpacks_to_gigabytes_costs_nothing() -> None:
    text, image = packed(occupancy(40), 0.0)
    huge = zlib.compress(bytes(50_000_000))
    at = image.index(b"IDAT")
    n = int.from_bytes(image[at - 4 : at], "big")
    chunk = b"IDAT" + huge
    wrong = image[: at - 4] + len(huge).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    with pytest.raises(ArrayError, match=r"compact occupancy: wanted .* unfiltered bytes"):
        unpacked(text, wrong + image[at + 8 + n :], GRID)
