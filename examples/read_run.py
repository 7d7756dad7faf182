"""Reading a run: what a recorded run's bag holds, as arrays on one time axis."""

import sys

import humanpred_ros as hp

run = hp.read_run(sys.argv[1])

print(f"{len(run.postures)} postures, {len(run.occupancy)} occupancies, {run.duration_s:.2f} s")
for step in run.steps:
    costs = ", ".join(f"{goal.name} {goal.selection_cost:.4f}" for goal in step.goals)
    print(f"step {step.step} at {step.t_s:.2f} s: {step.action} {step.chosen} ({costs})")
for latency in run.latencies:
    if len(latency):
        print(f"{latency.name}: {1e3 * latency.delay_s.mean():.1f} ms on average")
