"""Doors for other packages: what is installed is found by name, and what cannot be used is refused by name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import Any

import pytest

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.recognition.classifier import Classifier

pytestmark = pytest.mark.core

GROUP = plugins.CLASSIFIERS


@dataclass(frozen=True)
class _Package:
    name: str


@dataclass(frozen=True)
class _Point:
    """An entry point of a package that is not installed."""

    name: str
    value: str
    package: str

    @property
    def dist(self) -> _Package:
        return _Package(self.package)

    def load(self) -> Any:
        return EntryPoint(self.name, self.value, GROUP).load()


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[_Point]]:
    points: list[_Point] = [
        _Point("zebra", "humanpred_ros.recognition.forest_classifier:ForestClassifier", "humanpred-ros"),
        _Point("forest", "humanpred_ros.recognition.forest_classifier:ForestClassifier", "humanpred-ros"),
    ]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points)
    plugins._found.cache_clear()
    yield points
    plugins._found.cache_clear()


def test_built_in_ones_are_found_and_described() -> None:
    assert plugins.names(plugins.CLASSIFIERS)[:2] == ("forest", "gmm")
    assert {"forecast", "swept_volume", "reaching", "current"} <= set(plugins.names(plugins.PREDICTORS))
    assert issubclass(plugins.load(GROUP, "gmm", Classifier), Classifier)  # type: ignore[type-abstract]
    for group in (plugins.CLASSIFIERS, plugins.PREDICTORS):
        for name in plugins.names(group):
            assert 10 < len(plugins.describe(group, name)) < 110


def test_built_in_names_come_first(installed: list[_Point]) -> None:
    installed.append(_Point("ant", "ants:Ant", "ants"))
    assert plugins.names(GROUP) == ("forest", "zebra", "ant")


def test_an_unknown_name_is_refused_with_those_there_are() -> None:
    with pytest.raises(UsageError, match=r"classifier: wanted one of forest, gmm.*, got 'svm'"):
        plugins.load(GROUP, "svm", Classifier)  # type: ignore[type-abstract]


def test_what_cannot_be_used_is_refused_with_its_package(installed: list[_Point]) -> None:
    installed += [_Point("lost", "no_such_module:Lost", "lost_pkg"), _Point("text", "humanpred_ros:__version__", "odd")]
    with pytest.raises(UsageError, match=r"classifier lost: no_such_module:Lost of package lost_pkg .*ModuleNotFound"):
        plugins.load(GROUP, "lost", Classifier)  # type: ignore[type-abstract]
    with pytest.raises(UsageError, match=r"text: wanted a class derived from .*Classifier, .*package odd"):
        plugins.load(GROUP, "text", Classifier)  # type: ignore[type-abstract]


def test_one_name_of_two_packages_is_refused(installed: list[_Point]) -> None:
    installed.append(_Point("forest", "woods:Forest", "woods"))
    with pytest.raises(UsageError, match="forest: wanted one package to give it, got humanpred_ros and woods"):
        plugins.names(GROUP)


def test_a_package_without_its_own_entry_points_was_not_installed(installed: list[_Point]) -> None:
    installed.clear()
    with pytest.raises(UsageError, match=r"humanpred_ros\.classifiers.* install the package again"):
        plugins.names(GROUP)
