"""The statistics say what is so: checked on motions whose numbers are known, and on the papers' recordings."""

from __future__ import annotations

import numpy as np
import pytest
from library_statistics import LibraryStatistics, comparison_markdown
from paths import REPOSITORY, shared_data

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.cleaning import clean_library
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary, resample_phase

REST = np.array([1.0, 2.0, 0.9, 0.7, 0.0, 0.0, 0.0, 1.4, 0.1, 0.0, 0.1, 0.4])


def sliding(label: int, index: int, metres: float, *, yaw: float = 0.7, offset: float = 0.0) -> Motion:
    """Return somebody who glides forwards by `metres` and back within 2 s, stiff as a board."""
    t = np.linspace(0.0, 2.0, 81)
    q = np.tile(REST, (len(t), 1))
    q[:, 3] = yaw
    q[:, :2] += metres * np.sin(np.pi * t / 2)[:, None] ** 2 * [np.cos(yaw), np.sin(yaw)]
    q[:, 2] += offset
    return Motion(t, q, KINECT12_DOFS, label, index)


def gliders(**kinds: float) -> MotionLibrary:
    motions = [sliding(0, j, 0.5, offset=0.01 * j, **kinds) for j in range(4)]
    motions += [sliding(1, j, 1.0, offset=0.01 * j, **kinds) for j in range(4)]
    return MotionLibrary("gliders", tuple(motions), {"stamps": "made up"})


def test_known_motions_have_the_known_numbers() -> None:
    found = LibraryStatistics(gliders())
    assert (found.n_motions, found.n_frames, found.labels, found.motions_per_class) == (8, 648, ("0", "1"), (4, 4))
    assert found.stamps == "made up"
    assert found.duration_s.p50 == pytest.approx(2.0)
    assert found.frame_period_s.p5 == pytest.approx(0.025)
    assert found.reach_m.p50 == pytest.approx(0.75, abs=0.26)
    assert (found.reach_m.p5, found.reach_m.p95) == (pytest.approx(0.5, abs=1e-3), pytest.approx(1.0, abs=1e-3))
    assert (found.path_m.p5, found.path_m.p95) == (pytest.approx(1.0, abs=1e-3), pytest.approx(2.0, abs=1e-3))
    # Mean speed is path over time; a sine square's peak is pi / 2 of its mean.
    assert found.mean_speed_m_s.p95 == pytest.approx(1.0, rel=0.03)
    assert found.peak_speed_m_s.p95 == pytest.approx(np.pi / 2, rel=0.03)
    assert found.apex_phase.p50 == pytest.approx(0.5)
    assert found.end_m.p95 == pytest.approx(0.0, abs=1e-9)
    assert found.goal_spacing_m == pytest.approx([0.5, 0.5], abs=1e-3)
    np.testing.assert_allclose(found.goal_sd_m[:, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.goal_sd_m[:, 2], np.std([0.0, 0.01, 0.02, 0.03]), atol=1e-9)
    assert dict(zip(found.dof_names, found.dof_start_sd, strict=True))["PelvisTransZ"] == pytest.approx(
        np.std([0.0, 0.01, 0.02, 0.03])
    )
    assert found.goal_m[1] - found.goal_m[0] == pytest.approx([0.5, 0.0, 0.0], abs=1e-3)


def test_where_the_person_faces_does_not_matter() -> None:
    one, other = LibraryStatistics(gliders(yaw=0.7)), LibraryStatistics(gliders(yaw=-2.0))
    np.testing.assert_allclose(one.goal_m, other.goal_m, atol=1e-9)
    np.testing.assert_allclose(one.extent_m, other.extent_m, atol=1e-9)


def test_a_start_that_gives_the_class_away_is_found() -> None:
    honest = gliders()
    leaky = MotionLibrary(
        "leaky", tuple(sliding(m.label, m.index, 0.5, offset=0.01 * m.index + 0.2 * int(m.label or 0)) for m in honest)
    )
    assert LibraryStatistics(leaky).class_found[0] == 1.0
    # Same starts in both classes: nothing to go by but chance, and at the turning point everything.
    assert LibraryStatistics(honest).class_found[0] == pytest.approx(0.5, abs=0.01)
    assert LibraryStatistics(honest).class_found[5] == 1.0
    assert LibraryStatistics(honest).chance == 0.5


def test_leaving_out_rounds_keeps_chance_at_chance() -> None:
    rng = np.random.default_rng(0)
    told = []
    for _ in range(5):
        t = np.linspace(0.0, 1.0, 12)
        motions = [
            Motion(t, np.tile(REST + rng.normal(0.0, 0.01, 12), (12, 1)), KINECT12_DOFS, label, j)
            for j in range(10)
            for label in range(8)
        ]
        told.append(LibraryStatistics(MotionLibrary("noise", tuple(motions))).class_found[0])
    assert np.mean(told) == pytest.approx(1 / 8, abs=0.05)


def test_unlabelled_or_single_class_libraries_are_refused() -> None:
    with pytest.raises(LibraryFormatError, match="2 classes"):
        LibraryStatistics(MotionLibrary("one", (sliding(0, 0, 0.5), sliding(0, 1, 0.5))))
    unlabelled = Motion(np.arange(3.0), np.tile(REST, (3, 1)), KINECT12_DOFS)
    with pytest.raises(LibraryFormatError, match="label"):
        LibraryStatistics(MotionLibrary("none", (*gliders(), unlabelled)))


def test_the_comparison_is_markdown_with_aggregates_only() -> None:
    text = comparison_markdown(gliders(), gliders(yaw=1.0))
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(tables) == 5
    for table in tables:
        assert len({line.count("|") for line in table}) == 1
    assert "| duration, s | 2.00 (2.00 to 2.00) | 2.00 (2.00 to 2.00) |" in text
    assert "rShoulderX" in text


def test_libraries_with_other_classes_compare() -> None:
    three = MotionLibrary("three", (*gliders(), *(sliding(2, j, 0.2, offset=0.01 * j) for j in range(4))))
    assert "| 2 | none |" in comparison_markdown(gliders(), three)


def test_library_a_leaks_and_library_b_does_not() -> None:
    """Recorded class by class, library_a's start gives the class away; library_b was interleaved."""
    a = load_library(shared_data("iros2013/library_a"))
    b = clean_library(load_library(shared_data("iros2013/library_b")), drop=True)
    assert LibraryStatistics(a).class_found[0] > 0.4
    found = LibraryStatistics(b)
    assert found.class_found[0] < 0.2
    assert 0.5 < found.apex_phase.p50 < 0.6
    assert 0.2 < found.goal_spacing_m.min() < found.goal_spacing_m.max() < 0.29


def test_the_shipped_library_is_labelled_synthetic_and_small() -> None:
    bag = REPOSITORY / "bags" / "synthetic_reaches"
    library = load_library(bag)
    assert (library.labels, len(library)) == (tuple("01234567"), 200)
    assert library.provenance["source"].startswith("synthetic")
    assert LibraryStatistics(library).class_found[0] < 0.22
    assert sum(file.stat().st_size for file in (REPOSITORY / "bags").rglob("*") if file.is_file()) < 5 * 2**20
    document = (REPOSITORY / "bags" / "STATISTICS.md").read_text(encoding="utf-8")
    assert "humanpred generate" in document
    assert f"seed {library.provenance['seed'].split()[0]}" in document


def test_the_document_states_the_shipped_library_s_numbers() -> None:
    library = load_library(REPOSITORY / "bags" / "synthetic_reaches")
    document = (REPOSITORY / "bags" / "STATISTICS.md").read_text(encoding="utf-8")
    found = LibraryStatistics(clean_library(library, drop=True))
    assert f"| duration, s | {found.duration_s.text()} |" in document
    assert f"| greatest distance of the palm from rest, m | {found.reach_m.text()} |" in document


def test_resampling_to_phases_is_what_the_statistics_use() -> None:
    motion = sliding(0, 0, 0.5)
    palm = HumanModel.kinect12().forward(resample_phase(motion, 101).q)["right_palm"]
    away = np.linalg.norm(palm - palm[0], axis=1)
    np.testing.assert_allclose(
        LibraryStatistics(MotionLibrary("two", (motion, sliding(1, 0, 0.5)))).distance_m, away[::10], atol=1e-9
    )
