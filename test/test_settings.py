"""Settings refuse what cannot be used, and name the field; a field declared once is offered elsewhere."""

from __future__ import annotations

import pytest

from humanpred_ros.errors import SettingsError
from humanpred_ros.settings import Settings, facts_of, setting, setting_of

pytestmark = pytest.mark.core


class Part(Settings):
    """Settings of a part."""

    period_s: float = setting(0.1, "length of a step", unit="s", low=0.01, high=10.0)
    weights: tuple[float, ...] = setting((1.0,), "one for each term", low=0.0)
    name: str = setting("arm", "what it is called", changeable=True)


class Whole(Settings):
    """Settings of a command that offers some of a part's."""

    period_s: float = setting_of(Part, "period_s", default=0.5)
    name: str = setting_of(Part, "name")


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"period_s": 0.0}, ["period_s", "0.01", "0.0"]),
        ({"period_s": float("nan")}, ["period_s", "nan"]),
        ({"period_s": "soon"}, ["period_s", "soon"]),
        ({"weights": (1.0, -1.0)}, ["weights", "-1.0"]),
        ({"colour": "red"}, ["colour"]),
    ],
)
def test_values_that_cannot_be_used_are_refused(values: dict[str, object], named: list[str]) -> None:
    with pytest.raises(SettingsError) as error:
        Part(**values)
    assert all(word in str(error.value) for word in named)


def test_a_field_of_another_class_keeps_its_description_and_range() -> None:
    assert Whole() == Whole(period_s=0.5, name="arm")
    assert facts_of(Whole.model_fields["period_s"]) == facts_of(Part.model_fields["period_s"])
    with pytest.raises(SettingsError, match="period_s"):
        Whole(period_s=11.0)


def test_changed_settings_are_checked_again() -> None:
    assert Part().replaced(name="leg").name == "leg"
    with pytest.raises(SettingsError, match="period_s"):
        Part().replaced(period_s=-1.0)
