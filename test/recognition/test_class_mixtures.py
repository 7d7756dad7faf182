"""Learning the classes: each from its own motions only, and nothing from a library that does not suffice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.errors import ArrayError, LibraryFormatError
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.class_mixtures import ClassMixtures, check_trainable, fit_class_mixtures
from humanpred_ros.recognition.gmm_config import GmmSettings

CONFIG = GmmSettings(n_components=4, max_iterations=20)


def same(a: ClassMixtures, b: ClassMixtures, label: int) -> bool:
    one, other = (x.mixtures[x.labels.index(label)] for x in (a, b))
    return np.array_equal(one.means, other.means) and np.array_equal(one.covariances, other.covariances)


def test_neither_order_nor_other_classes_change_a_class() -> None:
    library = small_library()
    whole = fit_class_mixtures(library, CONFIG)
    order = np.random.default_rng(1).permutation(len(library))
    shuffled = fit_class_mixtures(replace(library, motions=tuple(library.motions[i] for i in order)), CONFIG)
    part = fit_class_mixtures(library.select(lambda m: m.label != 10), CONFIG)
    assert whole.labels == shuffled.labels == (0, 10, 20)
    assert all(same(whole, shuffled, label) for label in whole.labels)
    assert part.labels == (0, 20)
    assert all(same(whole, part, label) for label in part.labels)


def test_seed_decides_and_only_the_seed() -> None:
    library = small_library()
    first, again = (fit_class_mixtures(library, CONFIG) for _ in range(2))
    other = fit_class_mixtures(library, CONFIG.replaced(seed=1))
    assert all(same(first, again, label) for label in first.labels)
    assert not all(same(first, other, label) for label in first.labels)


def test_features_counts_and_duration() -> None:
    slow, fast = small_library(2, 4, duration_s=2.0), small_library(2, 7, duration_s=1.2, seed=1)
    renumbered = tuple(replace(m, index=m.index + 100) for m in fast)
    library = MotionLibrary("both", slow.motions + renumbered)
    classes = fit_class_mixtures(library, CONFIG)
    assert classes.nominal_duration_s == pytest.approx(1.2)
    assert classes.motions_per_class == (11, 11)
    assert (classes.n_features, classes.has_phase) == (13, True)
    without = fit_class_mixtures(library, CONFIG.replaced(phase_feature=False))
    assert (without.n_features, without.has_phase) == (12, False)


def test_negative_labels_are_labels() -> None:
    library = small_library(2)
    renamed = replace(library, motions=tuple(replace(m, label=(m.label or 0) - 10) for m in library))
    assert fit_class_mixtures(renamed, CONFIG).labels == (-10, 0)


def test_libraries_that_do_not_suffice_are_refused() -> None:
    library = small_library()
    with pytest.raises(LibraryFormatError, match="at least two classes"):
        fit_class_mixtures(library.select(lambda m: m.label == 0), CONFIG)
    with pytest.raises(LibraryFormatError, match="class 10 has only 10/3"):
        fit_class_mixtures(library.select(lambda m: m.label != 10 or m.index == 3), CONFIG)
    unlabelled = replace(library.motions[0], label=None)
    with pytest.raises(LibraryFormatError, match="label them"):
        fit_class_mixtures(replace(library, motions=(unlabelled, *library.motions[1:])), CONFIG)
    still = tuple(m.with_postures(m.q * 0 + 0.1) if m.label == 20 else m for m in library)
    with pytest.raises(LibraryFormatError, match="class 20 no degree of freedom ever changes"):
        fit_class_mixtures(replace(library, motions=still), CONFIG)
    with pytest.raises(LibraryFormatError, match="class 0: mixture: wanted at least as many distinct samples"):
        fit_class_mixtures(small_library(n_motions=2), GmmSettings(n_components=201))


def test_a_motion_that_is_there_twice_is_named() -> None:
    library = small_library(2, 3)
    twice = replace(library, motions=(*library.motions, replace(library.motions[1], index=9)))
    with pytest.raises(LibraryFormatError, match="0/1 and 0/9 have the same postures"):
        check_trainable(twice)


def test_a_degree_of_freedom_that_never_moves_is_no_obstacle() -> None:
    library = small_library()
    fixed = tuple(m.with_postures(np.where(np.arange(12) == 6, 0.0, m.q)) for m in library)
    classes = fit_class_mixtures(replace(library, motions=fixed), CONFIG)
    np.testing.assert_allclose(classes.mixtures[0].covariances[:, 7, 7], CONFIG.covariance_floor, rtol=1e-6)


def test_parts_that_do_not_fit_are_refused() -> None:
    good = fit_class_mixtures(small_library(2), CONFIG)
    for change in (
        {"labels": (0,)},
        {"labels": (0, 0)},
        {"motions_per_class": (6,)},
        {"motions_per_class": (6, 0)},
        {"dof_names": good.dof_names[:5]},
        {"nominal_duration_s": 0.0},
    ):
        with pytest.raises(ArrayError):
            replace(good, **change)
