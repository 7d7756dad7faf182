"""Your own predictor: a ball around the palm, made without editing the package.

To choose it by name in nodes, demo and evaluations, offer it as an entry point in your package's pyproject.toml:

    [project.entry-points."humanpred_ros.predictors"]
    palm_ball = "own_predictor:PalmBall"
"""

from __future__ import annotations

from typing import Any

import numpy as np

import humanpred_ros as hp


class PalmBallSettings(hp.Settings):
    """Settings of `PalmBall`: `--set palm_ball.radius_m=0.2`."""

    radius_m: float = hp.setting(0.15, "radius of the ball", unit="m", low=0.01)


class PalmBall(hp.Predictor):
    """Everything near the palm is going to be occupied; nothing else is."""

    settings_type = PalmBallSettings
    classifiers = None  # any classifier may recognise the class beside it
    needs_model = True

    def __init__(self, request: Any) -> None:
        self.settings = request.settings or PalmBallSettings()
        self.grid, self.human = request.grid, request.human
        self.T_world_human = np.asarray(request.T_world_human)
        self.classifier = request.on_stream(request.make_classifier())
        self.centres_m = self.grid.centres_m(np.arange(self.grid.size))

    @classmethod
    def from_request(cls, request: Any) -> PalmBall:
        return cls(request)

    def start(self) -> None:
        self.classifier.start()

    def update(self, q: Any, t_s: float) -> hp.Prediction:
        palm = self.T_world_human[:3, :3] @ self.human.forward(q[None])["right_palm"][0] + self.T_world_human[:3, 3]
        inside = np.linalg.norm(self.centres_m - palm, axis=1) <= self.settings.radius_m
        p = inside.astype(np.float32).reshape(self.grid.shape)
        return hp.Prediction(hp.Occupancy(self.grid, p, t_s), self.classifier.update(q, t_s))


if __name__ == "__main__":
    from humanpred_ros.occupancy.predictor import PredictorRequest

    library = hp.load_library("synthetic_reaches")
    motion = library.find("3/2")
    model = hp.train(library.select(lambda other: other.name != motion.name), ["forest"])
    scene = hp.load_scene("four_places")
    predictor = PalmBall(PredictorRequest(model.human, scene.grid, scene.T_world_human, model))
    predictor.start()
    for k, (t_s, posture) in enumerate(zip(motion.t_s, motion.q, strict=True)):
        prediction = predictor.update(posture, t_s)
        if k % 20 == 0:
            occupied = int((prediction.occupancy.probability > 0).sum())
            print(f"{t_s:.2f} s: {occupied} voxels, class {prediction.posterior.best}")
