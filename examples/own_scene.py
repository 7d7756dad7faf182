"""Your own scene: a YAML file says where arm, table and tasks are. With nobody there the arm takes the nearest task."""

import sys
from pathlib import Path

import numpy as np

import humanpred_ros as hp

SCENE = Path(__file__).with_name("own_scene.yaml")
scene = hp.load_scene(sys.argv[1] if len(sys.argv) > 1 else SCENE)

replanner = hp.Replanner.for_scene(scene)
replanner.start(scene.start, 0.0)
nobody = hp.Occupancy(scene.grid, np.zeros(scene.grid.shape, dtype=np.float32), 0.1)
decision = replanner.plan(nobody)
for goal in decision.goals:
    print(f"{goal.name}: selection cost {goal.selection_cost:.4f}, {'valid' if goal.valid else goal.reason}")
print(f"chosen: {decision.chosen}, {decision.trajectory.end_s - decision.t_switch_s:.2f} s of motion")
replanner.close()
