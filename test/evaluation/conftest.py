"""What the tests of evaluations share."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from humanpred_ros.evaluation.parallel import map_processes


def _one_after_another(
    function: Callable[[Any], Any], tasks: Sequence[Any], jobs: int | None = None, progress: Any = None, *others: Any
) -> list[Any]:
    results = []
    for task in tasks:
        results.append(function(task))
        if progress is not None:
            progress(len(results))
    return results


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do the work of evaluations without starting processes, which takes seconds."""
    for name, module in list(sys.modules.items()):
        if name.startswith("humanpred_ros.evaluation.") and getattr(module, "map_processes", None) is map_processes:
            monkeypatch.setattr(module, "map_processes", _one_after_another)
