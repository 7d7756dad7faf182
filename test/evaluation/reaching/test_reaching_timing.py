"""Times are told of single plans only, on the reach that the target is about."""

from __future__ import annotations

from reaching_people import MODEL, recording

from humanpred_ros.evaluation.reaching import timing
from humanpred_ros.evaluation.reaching.entry import ReachingMaterial
from humanpred_ros.evaluation.reaching.timing import prediction_times


def test_the_reach_nearest_to_the_target_is_timed(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(timing, "_TIMED", 3)
    recordings = [recording(0, n_frames=40), recording(1, n_frames=120), recording(2, n_frames=300)]
    material = ReachingMaterial(recordings, MODEL)
    (found,) = prediction_times(("line", "baseline_0", "baseline_0_replanned"), recordings, material)
    assert found.predictor == "baseline_0"
    assert (found.recording, round(found.duration_s, 2)) == ("made_up_1", 1.19)
    assert 0.0 < found.median_ms <= found.slowest_ms
    assert found.processor_ms > 0.0
