"""What the demo trains on is told apart from what it replays."""

from __future__ import annotations

import pytest
from paths import REPOSITORY

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.evaluation.demo import training_part
from humanpred_ros.motion.library_io import load_library

LIBRARY = load_library(REPOSITORY / "bags" / "synthetic_reaches")


def test_the_replayed_motion_and_those_held_out_are_not_trained_on() -> None:
    replayed = LIBRARY.motions[-1]
    names = {motion.name for motion in training_part(LIBRARY, replayed, 2)}
    assert replayed.name not in names
    assert not names & {motion.name for label in LIBRARY.labels for motion in LIBRARY.of_class(label)[:2]}
    assert len(names) == len(LIBRARY) - 2 * len(LIBRARY.labels) - 1


def test_holding_everything_out_is_refused_with_the_option_that_does_it() -> None:
    with pytest.raises(LibraryFormatError, match="--hold-out"):
        training_part(LIBRARY, LIBRARY.motions[0], len(LIBRARY))
