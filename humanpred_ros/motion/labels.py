"""Labels of classes and places: short texts, such as `screws`; the papers' numbers are texts, too."""

from __future__ import annotations

import hashlib
import re

import numpy as np

from humanpred_ros.errors import HumanPredError, MotionError

_WHOLE = re.compile(r"-?[0-9]{1,18}")
#: No label is longer in UTF-8; the posterior's topic gives each so many bytes.
LONGEST_BYTES = 64


def checked_label(label: object, error: type[HumanPredError] = MotionError) -> str:
    """Return a class's label as text; whole numbers, as the papers' libraries have, become theirs.

    Raises:
        error: not a text, or one that files, messages and the command line cannot carry.
    """
    text = str(label) if isinstance(label, (int, np.integer)) and not isinstance(label, bool) else label
    if (
        not isinstance(text, str)
        or not text.isprintable()
        or text != text.strip()
        or "/" in text
        or not 0 < len(text.encode()) <= LONGEST_BYTES
    ):
        raise error(
            f"label: wanted a text such as screws or 3, of up to {LONGEST_BYTES} printable letters without /, got "
            f"{label!r:.80}; name the class so"
        )
    return text


def label_order(label: str | None) -> tuple[int, int, str]:
    """Return what sorts labels: none, then whole numbers by value, then texts."""
    if label is None:
        return -1, 0, ""
    return (0, int(label), label) if _WHOLE.fullmatch(label) else (1, 0, label)


def number_of(label: str) -> int:
    """Return a number >= 0 for a label, to seed generators with: a whole number's own, modulo 2**64."""
    if _WHOLE.fullmatch(label):
        return int(label) % 2**64
    return int.from_bytes(hashlib.sha256(label.encode()).digest()[:8], "little")
