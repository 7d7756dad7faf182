"""Early prediction of human reaches and replanning of a robot arm at a shared table."""

__version__ = "0.2.0"
