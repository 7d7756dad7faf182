"""Your own classifier: which class ends nearest to where the palm is, made without editing the package.

To choose it by name in nodes, demo and evaluations, offer it as an entry point in your package's pyproject.toml:

    [project.entry-points."humanpred_ros.classifiers"]
    nearest_end = "own_classifier:NearestEnd"
"""

from __future__ import annotations

from typing import Any

import numpy as np

import humanpred_ros as hp


class NearestEndSettings(hp.Settings):
    """Settings of `NearestEnd`."""

    scale_m: float = hp.setting(0.2, "distance at which a class is e times less probable", unit="m", low=0.01)


class NearestEnd(hp.Classifier):
    """The class whose motions end nearest to where the palm is now is the most probable one."""

    settings_type = NearestEndSettings

    def fit(self, library: hp.MotionLibrary) -> NearestEnd:
        self.labels = library.labels
        ends = [np.stack([self._palm(m.q[-1]) for m in library.of_class(label)]) for label in library.labels]
        self.ends_m = np.stack([end.mean(axis=0) for end in ends])
        return self

    def start(self) -> None:
        self.n_frames = 0

    def update(self, q: Any, t_s: float) -> hp.ClassPosterior:
        self.n_frames += 1
        log_p = -np.linalg.norm(self.ends_m - self._palm(q), axis=1) / self.settings.scale_m
        p = np.exp(log_p - log_p.max())
        return hp.ClassPosterior(self.labels, p / p.sum(), log_p, t_s, self.n_frames)

    def state(self) -> dict[str, Any]:
        return {"labels": np.array(self.labels), "ends_m": self.ends_m}

    @classmethod
    def from_state(cls, human: Any, settings: Any, state: Any) -> NearestEnd:
        made = cls(human, settings)
        made.labels, made.ends_m = tuple(state["labels"].tolist()), state["ends_m"]
        return made

    def _palm(self, q: Any) -> Any:
        return self.human.forward(np.atleast_2d(q))["right_palm"][0]


if __name__ == "__main__":
    library = hp.load_library("synthetic_reaches")
    motion = library.find("3/2")
    classifier = NearestEnd(hp.human_of(library)).fit(library.select(lambda other: other.name != motion.name))
    classifier.start()
    for k, (t_s, posture) in enumerate(zip(motion.t_s, motion.q, strict=True)):
        posterior = classifier.update(posture, t_s)
        if k % 20 == 0:
            print(f"{t_s:.2f} s: class {posterior.best}, p = {posterior.probability.max():.2f}")
