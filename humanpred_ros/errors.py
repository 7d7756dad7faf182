"""The errors a user can cause or meet; every one says what was wanted, what came, what to do."""

from __future__ import annotations

#: Longer messages hold somebody's data, not an explanation.
_LONGEST = 2000


class HumanPredError(Exception):
    """Base of every error this package raises on purpose; the command line exits with status 2 on it.

    Its text is one line without control characters, whatever came: it may quote a stranger's file to a terminal.
    """

    def __str__(self) -> str:
        return one_line(super().__str__())


def one_line(text: str) -> str:
    """Return a text as one line of at most 2000 characters; what does not print is written as Python's escapes."""
    text = printable(" ".join(text[: 2 * _LONGEST].split()))
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def printable(text: str) -> str:
    """Return a text in which what does not print, such as a terminal's commands, is written as Python's escapes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode("ascii") for c in text)


class UsageError(HumanPredError):
    """A request that cannot be carried out as stated (unknown name, conflicting options)."""


class ArrayError(HumanPredError):
    """An array with the wrong shape, or with values that are not finite."""


class MotionError(HumanPredError):
    """A motion whose stamps or postures cannot be used."""


class LibraryFormatError(HumanPredError):
    """A motion library that cannot be read or does not fit its purpose."""


class BagError(HumanPredError):
    """A bag that is missing, truncated, corrupt, or lacks what is asked of it."""


class HumanModelError(HumanPredError):
    """A human model that cannot be built, or degrees of freedom that do not fit it."""


class ModelFileError(HumanPredError):
    """A trained model file that is unreadable or was made for something else."""


class RobotError(HumanPredError):
    """A robot's file that does not fit its description, or a description that no arm can be made from."""


class SceneError(HumanPredError):
    """A scene description with unknown keys or impossible values."""


class GoalUnreachableError(HumanPredError):
    """A goal outside joint limits or in collision, or a tool pose that no configuration reaches."""


class PlanningError(HumanPredError):
    """A planning request that has no meaning (no goals, wrong shapes, impossible deadline)."""


class SettingsError(HumanPredError):
    """A setting is unknown, of the wrong type, out of its range, or does not go with another."""
