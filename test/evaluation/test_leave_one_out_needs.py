"""Who is asked to be evaluated says what it needs; whoever cannot be is named, and how to go on without."""

from __future__ import annotations

from dataclasses import replace

import pytest
from small_library import small_library

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.evaluation.leave_one_out import LEARNS_CLASSES, LEARNS_FROM_OTHERS, Needs, check_needs
from humanpred_ros.evaluation.recognition_runs import REACHING, evaluated_names, needs_of, unknown_left_out
from humanpred_ros.motion.motion import MotionLibrary

ENTRIES: dict[str, Needs | None] = {"trees": LEARNS_CLASSES, "places": LEARNS_FROM_OTHERS, "now": None}


def of(n_classes: int, n_motions: int) -> MotionLibrary:
    return small_library(n_classes=n_classes, n_motions=n_motions, n_frames=10)


def complaint(library: MotionLibrary, *names: str) -> str:
    with pytest.raises(LibraryFormatError) as caught:
        check_needs(library, {name: ENTRIES[name] for name in names}, "--entry")
    return str(caught.value)


@pytest.mark.parametrize(
    ("n_classes", "n_motions", "able"),
    [
        (1, 1, {"now"}),
        (1, 5, {"now"}),
        (3, 1, {"now"}),
        (2, 2, {"places", "now"}),
        (2, 3, {"trees", "places", "now"}),
    ],
)
def test_who_can_be_evaluated_is_and_who_cannot_is_named(n_classes: int, n_motions: int, able: set[str]) -> None:
    library = of(n_classes, n_motions)
    check_needs(library, {name: ENTRIES[name] for name in able}, "--entry")
    for name in ENTRIES.keys() - able:
        assert f"wanted for {name} at least" in complaint(library, name)


def test_the_others_are_said_as_they_are_typed_and_only_if_there_are_any() -> None:
    assert complaint(of(2, 2), *ENTRIES).endswith("or evaluate only the others: --entry places,now")
    assert complaint(of(2, 2), "trees").endswith("class 0 has 2; record more or leave the class out")
    assert complaint(of(1, 9), "trees", "places").endswith("got 1; record more")


def test_unlabelled_motions_are_only_for_who_learns_nothing() -> None:
    library = of(2, 3)
    mixed = MotionLibrary("mixed", (*library.motions, replace(library.motions[0], label=None)))
    check_needs(mixed, {"now": None}, "--entry")
    text = complaint(mixed, *ENTRIES)
    assert "for trees and places a class for every motion, -/0 and 0 more have none; label them" in text
    assert text.endswith("--entry now")


def test_only_goal_inference_needs_no_more_than_a_place_of_the_tested_class() -> None:
    assert {name for name in evaluated_names() if needs_of(name).n_motions < 3} == {REACHING}


def test_why_no_class_is_left_out_whole_is_said_of_two_and_not_of_three() -> None:
    assert unknown_left_out(of(3, 1)) is None
    assert "small has 2" in str(unknown_left_out(replace(of(2, 3), name="small")))
