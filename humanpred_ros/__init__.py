"""Early human-motion prediction and PR2 replanning at a shared table."""

__version__ = "0.1.0"
