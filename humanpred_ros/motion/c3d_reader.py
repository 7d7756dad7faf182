"""A program that reads a C3D file and writes its markers as a NumPy archive to its output.

ezc3d believes what a file declares: damaged ones crash it, or keep it busy without end. So it runs in a process of its
own, with bounded memory and time, and whoever started that reads the archive as any file of a stranger.
"""

from __future__ import annotations

import io
import re
import resource
import sys
from typing import Any

import numpy as np

#: Bytes of memory and seconds of processor time that reading may take.
_MOST_BYTES, _MOST_S = 4 << 30, 20


def markers_of(path: str) -> dict[str, Any]:
    """Return labels (M,), points (T, M, 3), lost (T, M), units (0 or 1) and rate (); raises whatever ezc3d does."""
    import ezc3d

    content: Any = ezc3d.c3d(path)
    parameters = content["parameters"]["POINT"]
    points = np.moveaxis(np.asarray(content["data"]["points"], dtype=np.float64)[:3], 0, 2).swapaxes(0, 1)
    lost = np.asarray(content["data"]["meta_points"]["residuals"])[0].T < 0
    lost |= ~np.isfinite(points).all(axis=2)
    labels = [str(label).strip() for key in parameters if re.fullmatch(r"LABELS\d*", key)
              for label in parameters[key]["value"]]  # fmt: skip
    labels += [f"*{k}" for k in range(len(labels), points.shape[1])]
    units = [str(unit) for unit in parameters.get("UNITS", {"value": []})["value"]][:1]
    # What stands for a text is one letter longer than it: arrays of texts drop zeros at the end, and need a length.
    texts = {"labels": [f"|{label}" for label in labels[: points.shape[1]]], "units": [f"|{unit}" for unit in units]}
    return {
        **{name: np.array(text, dtype=np.str_) if text else np.zeros(0) for name, text in texts.items()},
        "points": np.where(lost[..., None], 0.0, points),
        "lost": lost,
        "rate": np.float64(parameters["RATE"]["value"][0]),
    }


def main() -> int:
    """Read the file that is named; return 2 if ezc3d cannot read it."""
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (_MOST_S, _MOST_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        arrays = markers_of(sys.argv[1])
    except Exception as trouble:
        print(f"{type(trouble).__name__}: {trouble}", file=sys.stderr)
        return 2
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    sys.stdout.buffer.write(stream.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main())
