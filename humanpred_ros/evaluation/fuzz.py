"""`humanpred bench fuzz`: damaged files of every kind, and messages to every node, as a stranger's may be.

What is damaged, and how, is part of the repository's tests (`test/fuzz`), so the command runs from a checkout only.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from rich.console import Console

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import OutputSettings, chosen_names
from humanpred_ros.resources import share_directory
from humanpred_ros.settings import setting

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


def run(settings: FuzzSettings, console: Console) -> int:
    """Read damaged files and show damaged messages to the nodes; the exit status is 1 if anything failed.

    Raises:
        UsageError: no checkout of the repository.
    """
    folder = share_directory() / "test"
    if not (folder / "fuzz").is_dir():
        raise UsageError(f"bench fuzz: wanted a checkout of the repository, there is no {folder / 'fuzz'}; clone it")
    sys.path.insert(0, str(folder))
    status: int = importlib.import_module("fuzz.files").run(settings, console)
    return status
