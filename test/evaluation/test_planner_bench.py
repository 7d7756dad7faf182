"""The planner's bench counts what it says it counts, and asks the yardstick for the floor."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lookup_share import lookup_share
from rich.console import Console

from humanpred_ros.cli import parse
from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.evaluation import planner_bench
from humanpred_ros.evaluation.planner_bench import Lookup, PlannerBenchSettings, Yardstick, find_yardstick, measure
from humanpred_ros.evaluation.planner_bench_world import (
    Workload,
    ball,
    bench_world,
    body_points,
    body_spheres,
    spread_goals,
)
from humanpred_ros.robot.scene import Scene, load_scene

SIZES: dict[str, Any] = {"goals": 2, "waypoints": 12, "rollouts": 3, "points": 20, "spheres": 10, "iterations": 2}
SMALL = Workload(**SIZES)
PROGRAM = """
#include <cstdio>
static const char* LINE = "%-16s thr=%d  N=%s pts=%s  1.0 Mcfg/s  %.3f ns/lookup  30k cfgs: 1.00 ms (min 0.80)\\n";
int main(int c, char** v) {
  printf(LINE, "f32 grid f32", 1, v[2], v[1], 9.0);
  printf(LINE, "f32 W32", 1, v[2], v[1], 2.5);
  printf(LINE, "f32 W32", 2, v[2], v[1], 1.25);
}
"""
COMPILER = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("four_places")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner_bench, "GROWTH", {"goals": (1, 2), "points": (10, 20)})
    monkeypatch.setattr(planner_bench, "scenes_of_arms", lambda: ("panda_side_by_side",))


def run(*words: str) -> str:
    printed = io.StringIO()
    command, settings = parse(["bench", "planner", *words])
    assert command(settings, Console(file=printed, width=120)) == 0
    return printed.getvalue()


def test_the_issues_case_has_the_lookups_it_says() -> None:
    assert Workload().lookups == 50 * (10 + 1) * 60 * (150 + 50)
    # Of ten rollouts, five are kept in all updates but the first.
    assert Workload(reused=5).lookups == 60 * (11 + 49 * 6) * (150 + 50)


@pytest.mark.parametrize("count", [5, 26, 50, 130])
def test_the_arm_gets_as_many_spheres_as_asked_on_the_same_links(scene: Scene, count: int) -> None:
    shipped, spheres = scene.arm.spheres(), body_spheres(scene.arm, count)
    assert len(spheres) == count
    assert set(spheres.link) <= set(shipped.link)
    if count >= len(shipped):
        assert set(spheres.link) == set(shipped.link)
        # What a shipped sphere covers is covered still, to within a quarter of its radius and what halving adds.
        for link, centre, radius in zip(shipped.link, shipped.local_m, shipped.radius_m, strict=True):
            near = np.linalg.norm(spheres.local_m[spheres.link == link] - centre, axis=1)
            assert near.min() <= 0.5 * radius


@pytest.mark.parametrize("count", [20, 150, 400])
def test_the_arm_gets_as_many_points_as_asked_on_all_links(scene: Scene, count: int) -> None:
    points = body_points(scene.arm, count)
    assert len(points) == count
    assert set(points.link) == set(scene.arm.body_points().link)
    assert len(np.unique(np.column_stack([points.link, points.local_m]), axis=0)) == count


def test_goals_lie_on_the_way_round_the_scenes_goals(scene: Scene) -> None:
    corners = [goal.configuration for goal in scene.goals]
    for found, corner in zip(spread_goals(scene, 4), corners, strict=True):
        assert np.array_equal(found, corner)
    np.testing.assert_allclose(spread_goals(scene, 8)[1], (corners[0] + corners[1]) / 2.0)


def test_the_ball_is_the_yardsticks() -> None:
    centre = np.array([0.6, -0.4, 1.1])
    occupancy = ball(centre)
    assert occupancy.grid.origin_m == pytest.approx((-0.6, -1.6, 0.0))
    voxel = occupancy.grid.flat_index(np.array([[0.6, -0.4, 1.1], [0.6, -0.4, 1.7], [0.6, 0.0, 1.1]]))
    p = occupancy.probability.ravel()[voxel]
    assert p[0] > 0.9
    assert p[1] == pytest.approx(1.0 - 0.3 / 0.35, abs=0.06)  # twice as high as wide
    assert p[2] == 0.0


def test_hardly_a_lookup_is_skipped_in_the_shelf() -> None:
    world = bench_world(Workload(goals=1, points=60, spheres=30))
    assert min(lookup_share(world, world.paths[0])) > 0.8


def test_nothing_is_looked_up_far_from_everything() -> None:
    away = np.tile([-2.1, -0.5, 0.0, -0.2, 0.0, -0.1, 0.0], (12, 1))  # stretched out to the side
    points, spheres = lookup_share(bench_world(SMALL), away)
    assert points == 0.0
    assert spheres < 0.5


@COMPILER
def test_the_floor_is_the_line_for_float32_on_one_thread(tmp_path: Path) -> None:
    source = tmp_path / "cost_floor.cpp"
    source.write_text(PROGRAM)
    yardstick = Yardstick.compiled(find_yardstick(source), tmp_path)
    assert yardstick.lookup(SMALL) == Lookup(2.5, 1.25)
    source.write_text('#include <cstdio>\nint main() { printf("something else\\n"); }')
    with pytest.raises(UsageError, match="f32 W32 thr=1"):
        Yardstick.compiled(source, tmp_path).lookup(SMALL)
    source.write_text("this is not C++")
    with pytest.raises(UsageError, match="wanted a source that g"):
        Yardstick.compiled(source, tmp_path)


def test_without_source_or_compiler_there_is_no_floor_and_a_reason(
    tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "--yardstick" in Yardstick.compiled(None, tmp_path).missing
    source = tmp_path / "cost_floor.cpp"
    source.write_text(PROGRAM)
    yardstick = Yardstick.compiled(source, tmp_path, compiler="no-such-compiler")
    assert "no-such-compiler" in yardstick.missing
    assert yardstick.lookup(SMALL) is None
    monkeypatch.setattr(planner_bench, "find_yardstick", lambda told: None)
    report = measure(PlannerBenchSettings(**SIZES, rounds=1), lambda what, total: lambda done: None)
    assert [report.figures[key].n for key in ("ours_ms", "floor_ms", "to_floor")] == [1, 0, 0]
    assert report.figures["no_floor"] in report.notes
    with pytest.raises(UsageError, match="there is no"):
        find_yardstick(tmp_path / "absent.cpp")


@COMPILER
def test_everything_is_measured_printed_and_written(tmp_path: Path, quick: None) -> None:
    source, out, plot = tmp_path / "cost_floor.cpp", tmp_path / "bench.json", tmp_path / "bench.png"
    source.write_text(PROGRAM)
    sizes = [word for name, value in SIZES.items() for word in (f"--{name}", str(value))]
    printed = run(*sizes, "--rounds", "1", "--yardstick", str(source), "--json", str(out), "--plot", str(plot))
    bench: dict[str, Any] = json.loads(out.read_text())
    assert bench["lookups"] == SMALL.lookups
    assert bench["floor_ms"]["median"] == pytest.approx(2.5e-6 * SMALL.lookups)
    assert bench["to_floor"]["median"] == pytest.approx(bench["ours_ms"]["median"] / bench["floor_ms"]["median"])
    assert bench["floor_two_threads_ms"]["median"] == pytest.approx(1.25e-6 * SMALL.lookups * SMALL.goals)
    assert bench["floor_speed_up"]["median"] == 2.0
    assert [(row["what"], row["size"]) for row in bench["growth"]] == [
        ("goals", 1), ("goals", 2), ("points", 10), ("points", 20),
    ]  # fmt: skip
    assert bench["growth"][1]["lookups"] == 2 * bench["growth"][0]["lookups"]
    assert bench["growth"][0]["two_threads_ms"]["n"] == bench["growth"][3]["ours_ms"]["n"]
    assert bench["machine"]["usable_cores"] >= 1
    [arm] = bench["arms"]
    assert (arm["arm"], arm["to_first"]) == ("Panda", 1.0)
    assert arm["ours_ms"]["n"] == 3
    assert arm["solids_ms"]["n"] == arm["cloud_ms"]["n"] == 1
    assert "one goal / floor" in printed
    assert plot.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--goals", "0"], "--goals"),
        (["--waypoints", "4"], "--waypoints"),
        (["--reused", "10"], "--reused"),
        (["--rounds", "0"], "--rounds"),
        (["--plot", "x.png", "--no-growth"], "--plot"),
        (["--json", "no/such/folder.json"], "folder that exists"),
        (["--yardstick", "no/such.cpp"], "--yardstick"),
    ],
)
def test_impossible_options_are_refused_before_anything_is_measured(words: list[str], message: str) -> None:
    with pytest.raises(HumanPredError, match=message):
        run(*words)
