"""An occupancy as a text and a few kilobytes: 8-bit probabilities of the box around its voxels, packed as a PNG image.

The text says which lattice and which box of it, or why there is none; the image has a row for each (x, y) of the box
and a column for each z, so that any viewer of images shows it, and its checksums tell when it was damaged.
"""

from __future__ import annotations

import re
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid, codes_of, probability_of_code

#: Begins the text where nobody knows where people are; the reason follows.
UNKNOWN = "unknown: "
#: Begins the text of an occupancy that says that nobody is there: an empty one alone is not believed.
NOBODY = "nobody; "
_IMAGE = "mono8; png compressed; "
_NUMBER, _COUNT = r"-?\d{1,9}(?:\.\d{1,20})?(?:e-?\d{1,3})?", r"\d{1,8}"
_TEXT = re.compile(
    rf"(?P<kind>{_IMAGE}|{NOBODY})lattice (?P<lattice>{_NUMBER}(?: {_NUMBER}){{3}}(?: {_COUNT}){{3}})"
    rf"(?:; box (?P<box>{_COUNT}(?: {_COUNT}){{5}}))?"
)
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: Of a voxel: as far apart may two lattices be that count as one.
_TOLERANCE = 1e-3


def lattice_text(grid: VoxelGrid) -> str:
    """Return origin (m), resolution (m) and shape of a lattice as they stand in the text."""
    return "lattice " + " ".join(map(repr, (*grid.origin_m, float(grid.resolution_m), *grid.shape)))


def packed(occupancy: Occupancy, threshold: float) -> tuple[str, bytes]:
    """Return text and image of what `Occupancy.sparse(threshold)` keeps; no image where that is nothing."""
    grid = occupancy.grid
    flat = occupancy.voxels_above(threshold)
    head = f"{_IMAGE}{lattice_text(grid)}; box "
    if not len(flat):
        return f"{head}0 0 0 0 0 0", b""
    _, ny, nz = grid.shape
    row, z = np.divmod(flat, nz)
    x, y = np.divmod(row, ny)
    low = np.array([int(x[0]), int(y.min()), int(z.min())])
    n_x, n_y, n_z = (np.array([int(x[-1]), int(y.max()), int(z.max())]) - low + 1).tolist()
    # The first byte of a row names its filter: none.
    rows = np.zeros((n_x * n_y, n_z + 1), dtype=np.uint8)
    rows[(x - low[0]) * n_y + (y - low[1]), z - low[2] + 1] = codes_of(occupancy.probability.ravel()[flat])
    packer = zlib.compressobj(1, zlib.DEFLATED, 15, 8, zlib.Z_RLE)
    shape = struct.pack(">IIBBBBB", n_z, n_x * n_y, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", shape), (b"IDAT", packer.compress(rows.data) + packer.flush()), (b"IEND", b""))
    image = _SIGNATURE + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(name)))
        for name, data in chunks
    )
    return f"{head}{low[0]} {low[1]} {low[2]} {n_x} {n_y} {n_z}", image


def unpacked(text: str, image: bytes, grid: VoxelGrid | None = None, t_s: float = 0.0) -> Occupancy:
    """Return the occupancy that `packed` made, bit for bit `Occupancy.sparse`.

    Args:
        text: what the message says of itself.
        image: its bytes.
        grid: the lattice wanted; None takes the one the text tells of.
        t_s: stamp of the occupancy.

    Raises:
        ArrayError: nobody knows where people are; another lattice; a text or an image that cannot be read.
    """
    if text.startswith(UNKNOWN):
        raise ArrayError(f"where people are is not known: {text.removeprefix(UNKNOWN)}")
    found = _TEXT.fullmatch(text)
    if found is None or (found["box"] is None) != (found["kind"] == NOBODY):
        raise ArrayError(f"compact occupancy: wanted a lattice and a box of it, got {text!r:.120}")
    numbers = found["lattice"].split()
    x, y, z, resolution_m = map(float, numbers[:4])
    told = VoxelGrid((x, y, z), resolution_m, (int(numbers[4]), int(numbers[5]), int(numbers[6])))
    if grid is not None and not _same(told, grid):
        raise ArrayError(
            f"other lattice: wanted the scene's (origin {grid.origin_m}, {grid.resolution_m} m, {grid.shape}), got "
            f"origin {told.origin_m}, {told.resolution_m} m, {told.shape}; use one scene for both nodes"
        )
    grid = grid or told
    probability = np.zeros(grid.shape, dtype=np.float32)
    box = np.array([int(number) for number in (found["box"] or "0 0 0 0 0 0").split()])
    low, n = box[:3], box[3:]
    if not n.any():
        if len(image):
            raise ArrayError(f"compact occupancy: wanted no image for an empty box, got {len(image)} bytes")
    elif n.min() < 1 or (low + n > grid.shape).any():
        raise ArrayError(f"compact occupancy: wanted a box within {grid.shape} voxels, got {n} of them from {low} on")
    else:
        codes = _codes(bytes(image), int(n[0] * n[1]), int(n[2])).reshape(n)
        i, j, k = (slice(int(a), int(a + m)) for a, m in zip(low, n, strict=True))
        probability[i, j, k] = probability_of_code()[codes]
    return Occupancy(grid, probability, t_s)


def voxels(occupancy: Occupancy) -> tuple[FloatArray, NDArray[np.float32]]:
    """Return centres (N, 3), world frame, m, and probabilities (N,) of the voxels that are not empty."""
    flat = occupancy.voxels_above(0.0)
    return occupancy.grid.centres_m(flat), occupancy.probability.ravel()[flat]


def _same(told: VoxelGrid, grid: VoxelGrid) -> bool:
    apart = [abs(a - b) for a, b in zip(told.origin_m, grid.origin_m, strict=True)]
    apart.append(max(grid.shape) * abs(told.resolution_m - grid.resolution_m))
    return told.shape == grid.shape and max(apart) <= _TOLERANCE * grid.resolution_m


def _codes(image: bytes, height: int, width: int) -> NDArray[np.uint8]:
    """Return the (height, width) bytes of a PNG image as `packed` writes them."""
    chunks: list[bytes] = []
    at = len(_SIGNATURE)
    while len(chunks) < 3 and at + 12 <= len(image):
        n = int.from_bytes(image[at : at + 4], "big")
        chunk, crc = image[at + 4 : at + 8 + n], image[at + 8 + n : at + 12 + n]
        if len(crc) < 4 or zlib.crc32(chunk) != int.from_bytes(crc, "big"):
            break
        chunks.append(chunk)
        at += 12 + n
    if not image.startswith(_SIGNATURE) or at != len(image) or [c[:4] for c in chunks] != [b"IHDR", b"IDAT", b"IEND"]:
        raise ArrayError(f"compact occupancy: wanted an undamaged PNG image of one part, got {len(image)} other bytes")
    wanted = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    if chunks[0][4:] != wanted:
        raise ArrayError(f"compact occupancy: wanted {height} rows of {width} bytes, got {chunks[0][4:].hex()}")
    size = height * (width + 1)
    reader = zlib.decompressobj()
    try:
        data = reader.decompress(chunks[1][4:], size + 1)  # no more than that, whatever it unpacks to
    except zlib.error as error:
        raise ArrayError(f"compact occupancy: wanted an image that unpacks, got one that does not ({error})") from error
    rows = np.frombuffer(data, dtype=np.uint8)
    if len(rows) != size or not reader.eof or reader.unused_data or rows[:: width + 1].any():
        raise ArrayError(f"compact occupancy: wanted {size} unfiltered bytes in the image, got {len(rows)} or others")
    return rows.reshape(height, width + 1)[:, 1:]
