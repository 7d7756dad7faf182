"""The C++ yardstick: what one lookup costs at least on this machine, measured beside our own times."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from humanpred_ros.errors import UsageError
from humanpred_ros.resources import share_directory

_SOURCE = Path("shared", "yardsticks", "cost_floor.cpp")
_FLAGS = ("-O3", "-march=native", "-std=c++17", "-pthread")
#: The variant that computes as ours does: float32, 32 configurations side by side.
_LINE = r"^f32 W32\s+thr={threads}\b.*?\s([\d.]+) ns/lookup.*?([\d.]+) ms \(min ([\d.]+)\)"
#: It handles 64 configurations at a time in the wider of its loops over two threads.
_MULTIPLE = 64
_COMPILER_LIMIT_S, _RUN_LIMIT_S = 120.0, 60.0


def find_yardstick(told: str | None) -> Path | None:
    """Return the yardstick's source: the file told, else the one beside the repository or the current folder.

    Raises:
        UsageError: the file told does not exist.
    """
    if told:
        if not Path(told).is_file():
            raise UsageError(f"--yardstick: wanted the file cost_floor.cpp, there is no {told}")
        return Path(told)
    for base in (share_directory().parent, Path.cwd().parent, Path.cwd()):
        if (base / _SOURCE).is_file():
            return base / _SOURCE
    return None


@dataclass(frozen=True)
class Lookup:
    """Time of one lookup in a run of the yardstick, ns.

    Attributes:
        median_ns, least_ns: of its repetitions on one thread.
        two_threads_ns: median where two threads share the work.
    """

    median_ns: float
    least_ns: float
    two_threads_ns: float


@dataclass(frozen=True)
class Yardstick:
    """The compiled yardstick; `missing` says why there is none.

    Attributes:
        program: the executable, None if there is none.
        missing: why not.
    """

    program: Path | None
    missing: str = ""

    @classmethod
    def compiled(cls, source: Path | None, folder: Path, compiler: str = "g++") -> Yardstick:
        """Compile into `folder`; a machine without source or compiler gets one that says so.

        Raises:
            UsageError: the compiler refuses the source.
        """
        if source is None:
            return cls(None, f"no C++ floor: {_SOURCE} not found; name it with --yardstick FILE")
        found = shutil.which(compiler)
        if found is None:
            return cls(None, f"no C++ floor: no {compiler} on this machine")
        program = folder / "cost_floor"
        command = [found, *_FLAGS, str(source), "-o", str(program)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=_COMPILER_LIMIT_S, check=False)
        if done.returncode:
            raise UsageError(f"{source}: wanted a source that {compiler} compiles, got: {done.stderr.strip():.500}")
        return cls(program)

    def lookup(self, points: int, configurations: int) -> Lookup:
        """Run it once and return the time of a lookup.

        Args:
            points: lookups per configuration.
            configurations: how many, rounded up to what the program can handle.

        Raises:
            UsageError: there is no program, or it prints something else.
        """
        if self.program is None:
            raise UsageError(self.missing)
        n = -(-configurations // _MULTIPLE) * _MULTIPLE
        command = [str(self.program), str(points), str(n)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=_RUN_LIMIT_S, check=False)
        one, two = (re.search(_LINE.format(threads=n), done.stdout, re.MULTILINE) for n in (1, 2))
        if done.returncode or one is None or two is None:
            raise UsageError(f"yardstick: wanted lines 'f32 W32 thr=1 ... ns/lookup', got {done.stdout!r:.300}")
        median_ns, median_ms, least_ms = (float(text) for text in one.groups())
        return Lookup(median_ns, median_ns * least_ms / median_ms, float(two[1]))
