"""The replay within a page: it shows what was recorded, its parts are linked, and nothing comes from a network."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.viewing.analysis import Analysis
from humanpred_ros.viewing.playback import Recording
from humanpred_ros.viewing.replay import replay_data, replay_page
from humanpred_ros.viewing.report import render_report

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
FLAGS = ("--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader")


@pytest.fixture(scope="module")
def recording(analysis: Analysis) -> Recording:
    return Recording(analysis.run, analysis.workcell)


@pytest.fixture(scope="module")
def page(analysis: Analysis, recording: Recording) -> str:
    return render_report(analysis, replay_data(recording))


def looked_at(page: str, folder: Path, *how: str, at: str = "") -> str:
    """Return the document that a browser makes of a page."""
    if BROWSER is None:
        pytest.skip("needs Chromium")
    file = folder / "page.html"
    file.write_text(page, encoding="utf-8")
    command = [BROWSER, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=2000", *how]
    return subprocess.run([*command, f"{file.as_uri()}{at}"], capture_output=True, text=True, check=True).stdout


def test_it_holds_what_was_recorded_whatever_names_say(recording: Recording) -> None:
    run = recording.run
    strange = tuple(replace(d, reason="</script><b>&") for d in run.decisions)
    text = replay_data(Recording(replace(run, decisions=strange), recording.workcell))
    assert "<" not in text
    data = json.loads(text)
    assert data["t"][0] == 0.0
    assert data["t"][-1] == pytest.approx(run.duration_s, abs=1e-3)
    assert "</script><b>&" in data["said"][-1]
    k = len(data["t"]) // 2
    poses = np.frombuffer(base64.b64decode(data["robot"]["poses"]), dtype="<f4").reshape(len(data["t"]), -1, 3, 4)
    wanted = recording.scene.arm.chain.link_poses(run.robot.at(np.array([data["t"][k]]))[0])
    np.testing.assert_allclose(poses[k], np.asarray(wanted)[:, :3], atol=1e-4)
    cloud = np.frombuffer(base64.b64decode(data["occupancy"][0]["at"]), dtype="<i2").reshape(-1, 3)
    likely = recording.occupancies[0].probability >= 0.05
    np.testing.assert_allclose(1e-3 * cloud, recording.occupancies[0].centres_m[likely], atol=1e-3)


def test_a_page_is_small_and_asks_nobody(page: str, recording: Recording) -> None:
    for text in (page, replay_page(recording)):
        assert len(text) < 8_000_000
        found = set(re.findall(r"""(?:src|href)=["'](?!#|data:)[^"']*|https?://(?!www\.w3\.org/)[^\s"'<]*""", text))
        assert found == set()
        assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|import\(", text)


def test_links_rows_and_plots_lead_to_moments(page: str, recording: Recording, tmp_path: Path) -> None:
    t_s = recording.run.steps[2].t_s
    there = looked_at(page, tmp_path, "--dump-dom", at=f"#t={t_s:.3f}")
    assert f"<output>{t_s:.2f} s</output>" in there
    assert 'class="replay works"' in there
    click = """<script>addEventListener("load", () => {
      document.querySelectorAll("tbody[data-t] > tr:first-child")[4].click();
      document.title = document.querySelector(".replay output").textContent;
      const plot = [...document.querySelectorAll(".plot[data-axes]")].find(p => p.dataset.axes.includes('"time"'));
      const r = plot.getBoundingClientRect(), a = JSON.parse(plot.dataset.axes)[0], [x, y, w, h] = a.box;
      const at = {clientX: r.left + r.width * (x + w / 2), clientY: r.top + r.height * (y + h / 2), bubbles: true};
      plot.dispatchEvent(new PointerEvent("pointermove", at)); plot.dispatchEvent(new MouseEvent("click", at));
    });</script></body>"""
    clicked = looked_at(page.replace("</body>", click), tmp_path, "--dump-dom")
    assert f"<title>{recording.run.steps[4].t_s:.2f} s</title>" in clicked
    half = f"{0.5 * recording.run.duration_s:.2f} s"
    assert f"<output>{half}</output>" in clicked
    assert re.search(rf'<span class="tip"[^>]*>{half}</span>', clicked)
    assert len(re.findall(r'<i class="now"[^>]*left', clicked)) > 3


def test_the_canvas_is_not_blank_and_without_webgl_a_sentence_says_so(recording: Recording, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    shot = tmp_path / "shot.png"
    looked_at(replay_page(recording), tmp_path, f"--screenshot={shot}", "--window-size=700,600")
    pixels = np.asarray(image.open(shot).convert("RGB"))[100:380, 60:640]
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100
    blind = looked_at(replay_page(recording), tmp_path, "--dump-dom", "--disable-3d-apis")
    assert 'class="replay works"' not in blind
    assert "needs JavaScript and WebGL 2" in blind
