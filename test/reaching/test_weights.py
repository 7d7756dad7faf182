"""A file of weights reads back as it was, says what it is of, and is refused where it is of something else."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from humanpred_ros.errors import ModelFileError
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, SCALES
from humanpred_ros.reaching.weights import ReachWeights, load_weights, save_weights

SOME = ReachWeights(
    np.linspace(0.0, 300.0, N_FEATURES),
    np.random.default_rng(0).uniform(0.0, 300.0, (4, N_FEATURES)),
    ("wrist to wrist",),
    {"package_version": "1", "recordings": ["a", "b"], "config": {"seed": 3, "cut": None}},
)
finite = st.floats(0.0, allow_nan=False, allow_infinity=False)


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    hnp.arrays(np.float64, N_FEATURES, elements=finite),
    st.integers(0, 5).flatmap(lambda n: hnp.arrays(np.float64, (n, N_FEATURES), elements=st.floats(0.0, 1e6))),
    st.sets(st.sampled_from(FEATURE_NAMES)),
    st.dictionaries(st.text(), st.none() | st.integers(-(2**63), 2**63) | st.text() | st.lists(finite)),
)
def test_files_read_back_as_the_same_weights(
    tmp_path: Path, weights: np.ndarray, bootstrap: np.ndarray, at_upper: set[str], provenance: dict[str, object]
) -> None:
    saved = ReachWeights(weights, bootstrap, tuple(at_upper), provenance)
    save_weights(saved, tmp_path / "weights.json")
    found = load_weights(tmp_path / "weights.json")
    np.testing.assert_array_equal(found.weights, weights)
    np.testing.assert_array_equal(found.bootstrap, bootstrap)
    assert found.bootstrap.shape == bootstrap.shape
    assert found.at_upper == saved.at_upper
    assert dict(found.provenance) == provenance


def test_people_can_read_weights_spread_and_scales(tmp_path: Path) -> None:
    save_weights(SOME, tmp_path / "weights.json")
    value = json.loads((tmp_path / "weights.json").read_text())
    assert value["weights"]["posture velocity"] == SOME.weights[1]
    assert value["spread"]["wrist jerk"] == pytest.approx(SOME.bootstrap[:, 7].std(ddof=1))
    assert list(value["scales"].values()) == SCALES.tolist()
    assert value["provenance"]["recordings"] == ["a", "b"]
    save_weights(ReachWeights(SOME.weights, np.zeros((1, N_FEATURES)), (), {}), tmp_path / "one.json")
    assert json.loads((tmp_path / "one.json").read_text())["spread"] is None


def test_the_order_of_features_in_a_file_does_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "weights.json"
    save_weights(SOME, path)
    path.write_text(json.dumps(json.loads(path.read_text()), sort_keys=True))
    np.testing.assert_array_equal(load_weights(path).weights, SOME.weights)


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "weights.json"
    save_weights(SOME, path)
    before = path.read_text()
    for odd in ({"loss": float("nan")}, {"model": object()}):
        with pytest.raises(ModelFileError, match="wanted a provenance"):
            save_weights(ReachWeights(SOME.weights, SOME.bootstrap, (), odd), path)
    (tmp_path / "folder").mkdir()
    for place in (tmp_path / "folder", tmp_path / "nowhere" / "weights.json", Path("/"), path / "below_a_file"):
        with pytest.raises(ModelFileError, match="cannot be written"):
            save_weights(SOME, place)
    assert path.read_text() == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["folder", "weights.json"]


def other_names(value: dict[str, dict[str, float]]) -> None:
    value["weights"]["wrist snap"] = value["weights"].pop("wrist jerk")


def other_scale(value: dict[str, dict[str, float]]) -> None:
    value["scales"]["wrist jerk"] *= 10.0


def of(key: str, change: object) -> object:
    return lambda value: value.update({key: change})


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("wanted a file of.*something else", of("format", "something else")),
        ("wanted a file of.*99", of("format_version", 99)),
        ("lacking: wrist jerk; unknown: wrist snap", other_names),
        ("wrist jerk has 1e-12 there and 1e-13 here", other_scale),
        ("scales.*required", lambda value: value.pop("scales")),
        ("weights.*dictionary", of("weights", [1.0] * N_FEATURES)),
        ("weights posture length.*got None", of("weights", dict.fromkeys(FEATURE_NAMES))),
        ("weights.*got True", of("weights", dict.fromkeys(FEATURE_NAMES, True))),
        ("weights.*got '1.0'", of("weights", dict.fromkeys(FEATURE_NAMES, "1.0"))),
        ("weights.*finite.*got NaN", of("weights", dict.fromkeys(FEATURE_NAMES, float("nan")))),
        ("0 or more, got -1", of("weights", dict.fromkeys(FEATURE_NAMES, -1.0))),
        ("bootstrap", of("bootstrap", np.zeros((N_FEATURES, 2)).tolist())),
        ("bootstrap.*got 'many'", of("bootstrap", "many")),
        ("bootstrap.*required", lambda value: value.pop("bootstrap")),
        ("names of features, got speed", of("at_upper", ["speed"])),
        ("provenance.*got 3", of("provenance", 3)),
    ],
)  # fmt: skip
def test_files_of_other_content_are_refused_by_name(tmp_path: Path, text: str, change) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "weights.json"
    save_weights(SOME, path)
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))
    with pytest.raises(ModelFileError, match=text) as found:
        load_weights(path)
    assert "weights.json" in str(found.value)
    assert "learn them again" in str(found.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"3", b"\xff\xfe", b"[" * 200000, None])
def test_what_is_no_such_file_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "weights.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ModelFileError, match=r"could not be read|wanted a file of"):
        load_weights(path)
    with pytest.raises(ModelFileError, match="could not be read"):
        load_weights(tmp_path)
