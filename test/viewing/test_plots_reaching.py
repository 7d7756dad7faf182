"""The plot of reaches is drawn for any number of recordings and predictors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.viewing.plots_reaching import DistanceBar, WristPaths, save_reaching_plot


@pytest.mark.parametrize("n_recordings", [1, 5])
def test_a_picture_is_written(tmp_path: Path, n_recordings: int) -> None:
    path = np.cumsum(np.ones((30, 3)), axis=0)
    paths = [
        WristPaths(f"r{k}", path, {f"predictor {j}": path[: 20 + j] for j in range(9)}) for k in range(n_recordings)
    ]
    bars = [
        DistanceBar("published", (3.0, 4.0, float("nan")), True),
        DistanceBar("predictor 1", (1.0, 2.0, 3.0), False),
    ]
    save_reaching_plot(tmp_path / "plot.png", paths, bars)
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
