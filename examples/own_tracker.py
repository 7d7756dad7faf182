"""Your own body tracker: its points to postures, here COCO's 17 points of a camera whose z points forwards."""

from __future__ import annotations

import numpy as np

import humanpred_ros as hp

tracker = hp.SkeletonTracker("coco17")  # a name in config/skeletons, or your own YAML file
names = tracker.skeleton.names

# Somebody who stands 2 m in front of the camera and reaches forwards; metres, x forward, y left, z up. NaN: not seen.
points = np.full((17, 3), np.nan)
for name, place in {
    "left_shoulder": (2.0, -0.2, 0.30), "right_shoulder": (2.0, 0.2, 0.30), "left_hip": (2.0, -0.12, -0.2),
    "right_hip": (2.0, 0.12, -0.2), "right_elbow": (1.9, 0.25, 0.05), "right_wrist": (1.66, 0.22, 0.08),
}.items():  # fmt: skip
    points[names.index(name)] = place

for frame in range(30):
    seen = tracker.update(points + 0.001 * np.sin(frame + np.arange(51)).reshape(17, 3), frame / 30)
assert seen.q is not None
x, y, z = tracker.model.forward(seen.q)["right_palm"]
print(f"the hand is at ({x:.2f}, {y:.2f}, {z:.2f}); bridged: {', '.join(seen.bridged[:2])}")

points[names.index("right_wrist")] = np.nan
for frame in range(30, 45):
    seen = tracker.update(points + 0.001 * np.sin(frame + np.arange(51)).reshape(17, 3), frame / 30)
print(seen.refusal)
