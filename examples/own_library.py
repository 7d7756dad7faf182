"""Your own recordings: postures in arrays become a library, a bag that anything reads, and a trained model."""

import sys
from pathlib import Path

import numpy as np

import humanpred_ros as hp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# Postures of a human model, a row for each: here P1's 12 degrees of freedom, from a library that is shipped.
shipped = hp.load_library("synthetic_reaches")
motions = []
for label in (0, 3):
    for index, recorded in enumerate(shipped.of_class(label)[:6]):
        t_s = np.arange(len(recorded)) / 30.0  # seconds
        motions.append(hp.Motion(t_s, recorded.q, recorded.dof_names, label, index, recorded.frame_id))
library = hp.MotionLibrary("my_reaches", tuple(motions))

bag = hp.write_library(library, folder / "my_reaches")
model = hp.train(hp.load_library(bag), ["forest"])
hp.save_model(model, folder / "my_model.npz")

classifier = hp.load_model(folder / "my_model.npz").classifier("forest")
classifier.start()
for t_s, posture in zip(motions[0].t_s, motions[0].q, strict=True):
    posterior = classifier.update(posture, t_s)
print(f"{bag}: {len(library)} motions; motion {motions[0].name} is taken for class {posterior.best}")
