"""A library too small for one classifier may do for another: each says what it needs to be tested on its own library.

Whoever learns classes must have something left to learn from when a motion is left out. Goal inference learns from no
motion of the tested one's class; it needs another class to learn from, and another motion to be told the place from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.motion.motion import MotionLibrary


@dataclass(frozen=True)
class Needs:
    """What must be in a library for motions to be left out of it; every motion needs a class in any case.

    Attributes:
        n_classes, why_classes: the least number of classes, and what for.
        n_motions, why_motions: the least number of motions in every class, and what for.
    """

    n_classes: int
    why_classes: str
    n_motions: int
    why_motions: str

    def lacking(self, library: MotionLibrary) -> str | None:
        """Return what is missing, as the middle of a sentence; None if nothing is."""
        if len(library.labels) < self.n_classes:
            return f"at least {self.n_classes} classes {self.why_classes}, got {len(library.labels)}"
        counts = ((label, len(library.of_class(label))) for label in library.labels)
        few = next(((label, count) for label, count in counts if count < self.n_motions), None)
        if few is None:
            return None
        return f"at least {self.n_motions} motions in every class {self.why_motions}, class {few[0]} has {few[1]}"


#: Of whoever learns the classes' motions, the tested one's class among them.
LEARNS_CLASSES = Needs(2, "to tell apart", 3, "to have two left to learn from when one is left out")
#: Of whoever learns from the other classes, and is told the place of the tested motion's.
LEARNS_FROM_OTHERS = Needs(
    2,
    "to learn from others than the tested motion's",
    2,
    "to take the class's place from when one is left out",
)


def check_needs(library: MotionLibrary, needs: Mapping[str, Needs | None], option: str) -> None:
    """Check that a library suffices for all entries that were asked for; those that can do without need None.

    Args:
        library: of which motions are left out.
        needs: by name of the entry.
        option: which takes the names, for the advice to leave some out.

    Raises:
        LibraryFormatError: names whoever cannot be evaluated, what is missing, and the option that leaves them out.
    """
    learned = {name: need for name, need in needs.items() if need is not None}
    unlabelled = [motion.name for motion in library if motion.label is None]
    lacking: dict[str, list[str]] = {}
    for name, need in learned.items():
        if unlabelled:
            found: str | None = f"a class for every motion, {unlabelled[0]} and {len(unlabelled) - 1} more have none"
        else:
            found = need.lacking(library)
        if found is not None:
            lacking.setdefault(found, []).append(name)
    if not lacking:
        return
    refused = {name for names in lacking.values() for name in names}
    wanted = "; ".join(f"for {' and '.join(names)} {found}" for found, names in lacking.items())
    if unlabelled:
        remedy = "label them or leave them out"
    elif any(len(library.labels) < learned[name].n_classes for name in refused):
        remedy = "record more"
    else:
        remedy = "record more or leave the class out"
    others = [name for name in needs if name not in refused]
    if others:
        remedy += f", or evaluate only the others: {option} {','.join(others)}"
    raise LibraryFormatError(f"library {library.name}: wanted {wanted}; {remedy}")
