"""Your own classifier: which class reaches nearest to where the palm is, made without editing the package.

To choose it by name in nodes, demo and evaluations, offer it as an entry point in your package's pyproject.toml:

    [project.entry-points."humanpred_ros.classifiers"]
    nearest_reach = "own_classifier:NearestReach"
"""

from __future__ import annotations

from typing import Any

import numpy as np

import humanpred_ros as hp


class NearestReachSettings(hp.Settings):
    """Settings of `NearestReach`."""

    scale_m: float = hp.setting(0.2, "distance at which a class is e times less probable", unit="m", low=0.01)


class NearestReach(hp.Classifier):
    """The class whose motions reach nearest to where the palm is now is the most probable one."""

    settings_type = NearestReachSettings

    def fit(self, library: hp.MotionLibrary) -> NearestReach:
        self.labels = library.labels
        reaches = [[self._farthest(motion) for motion in library.of_class(label)] for label in library.labels]
        self.reaches_m = np.array([np.mean(places, axis=0) for places in reaches])
        return self

    def start(self) -> None:
        self.n_frames = 0

    def update(self, q: Any, t_s: float) -> hp.ClassPosterior:
        self.n_frames += 1
        log_p = -np.linalg.norm(self.reaches_m - self._palms(q)[0], axis=1) / self.settings.scale_m
        p = np.exp(log_p - log_p.max())
        return hp.ClassPosterior(self.labels, p / p.sum(), log_p, t_s, self.n_frames)

    def state(self) -> dict[str, Any]:
        return {"labels": np.array(self.labels), "reaches_m": self.reaches_m}

    @classmethod
    def from_state(cls, human: Any, settings: Any, state: Any) -> NearestReach:
        made = cls(human, settings)
        made.labels, made.reaches_m = tuple(state["labels"].tolist()), state["reaches_m"]
        return made

    def _palms(self, q: Any) -> Any:
        return self.human.forward(np.atleast_2d(q))["right_palm"]

    def _farthest(self, motion: hp.Motion) -> Any:
        palms = self._palms(motion.q)
        return palms[np.argmax(np.linalg.norm(palms - palms[0], axis=1))]


if __name__ == "__main__":
    library = hp.load_library("synthetic_reaches")
    motion = library.find("3/2")
    classifier = NearestReach(hp.human_of(library)).fit(library.select(lambda other: other.name != motion.name))
    classifier.start()
    for k, (t_s, posture) in enumerate(zip(motion.t_s, motion.q, strict=True)):
        posterior = classifier.update(posture, t_s)
        if k % 20 == 0:
            print(f"{t_s:.2f} s: class {posterior.best}, p = {posterior.probability.max():.2f}")
