"""The errors a user can cause or meet; every one says what was wanted, what came, what to do."""

from __future__ import annotations


class HumanPredError(Exception):
    """Base of every error this package raises on purpose; the command line exits with status 2 on it."""


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


class SceneError(HumanPredError):
    """A scene description with unknown keys or impossible values."""


class GoalUnreachableError(HumanPredError):
    """A goal outside joint limits or in collision, or a tool pose that no configuration reaches."""


class PlanningError(HumanPredError):
    """A planning request that has no meaning (no goals, wrong shapes, impossible deadline)."""


class StaleHumanError(HumanPredError):
    """Human data too old, missing or invalid to plan on."""


class SettingsError(HumanPredError):
    """A setting is unknown, of the wrong type, out of its range, or does not go with another."""
