"""`humanpred bench fuzz`, `bench faults` and `bench soak`: what this package is put through, from a checkout only.

Faults, damage and what must follow are part of the repository's tests (`test/fuzz`, `test/faults`).
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from rich.console import Console

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import OutputSettings, chosen_names
from humanpred_ros.resources import share_directory
from humanpred_ros.settings import LARGEST_SEED, setting

KINDS = ("scene", "library", "bag", "table", "people", "markers", "model", "weights", "urdf", "run", "setting")


class FuzzSettings(OutputSettings):
    """Settings of `humanpred bench fuzz`."""

    files: int = setting(1000, "damaged files", low=0)
    messages: int = setting(0, "mutated messages, spread over the nodes; 0 leaves them out", low=0)
    seed: int = setting(0, "of all damage", low=0)
    first: int = setting(0, "number of the first file", low=0)
    kinds: tuple[str, ...] = setting(tuple(KINDS), "kinds of files")
    jobs: int | None = setting(None, "processes to work with; one for each core by default", low=1)
    keep: Path = setting(Path("fuzz_failures"), "folder that files which failed are kept in; made if there are any")

    def check(self) -> None:
        """Refuse unknown kinds."""
        chosen_names(self.kinds, KINDS, "kinds")


class FaultBenchSettings(OutputSettings):
    """Settings of `humanpred bench faults`."""

    page: Path = setting(Path("docs/faults.md"), "page to write when every fault is tried")
    only: tuple[str, ...] = setting(("all",), "names of faults")
    short: bool = setting(False, "only a handful of faults, in less than a minute")
    keep: Path | None = setting(None, "new folder to keep logs and bags in")


class SoakSettings(OutputSettings):
    """Settings of `humanpred bench soak`."""

    minutes: float = setting(10.0, "length of the run", unit="min", low=0.5, high=1440.0)
    calm: float = setting(10.0, "mean time between one fault and the next", unit="s", low=1.0, high=3600.0)
    seed: int = setting(0, "of the faults' order and times", low=0, high=LARGEST_SEED)
    keep: Path | None = setting(None, "new folder to keep logs and bag in")


def fuzz(settings: FuzzSettings, console: Console) -> int:
    """Read damaged files and show damaged messages to the nodes; the exit status is 1 if anything failed."""
    return _run("fuzz.files", settings, console)


def faults(settings: FaultBenchSettings, console: Console) -> int:
    """Put every fault into the running graph; the exit status is 1 if it did not fail closed."""
    return _run("faults.bench", settings, console)


def soak(settings: SoakSettings, console: Console) -> int:
    """Let the graph run with a fault now and then; the exit status is 1 if something is not as asked."""
    return _run("faults.soak", settings, console)


def _run(module: str, settings: OutputSettings, console: Console) -> int:
    """Carry out `run` of one of the tests' modules.

    Raises:
        UsageError: no checkout of the repository.
    """
    folder = share_directory() / "test"
    if not folder.joinpath(*module.split(".")).with_suffix(".py").is_file():
        raise UsageError(f"wanted a checkout of the repository, whose tests hold this bench; there is no {folder}")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    status: int = importlib.import_module(module).run(settings, console)
    return status
