"""The whole chain without ROS: a recorded reach is recognised, its space is predicted, and the arm plans around it."""

import humanpred_ros as hp

library = hp.load_library("synthetic_reaches")
motion = library.find("3/2")
model = hp.train(library.select(lambda other: other.name != motion.name), ["forest"])

scene = hp.load_scene("four_places")
predictor = hp.make_predictor("forecast", scene, model)
replanner = hp.Replanner.for_scene(scene, hp.ReplannerConfig(period_s=motion.duration_s / 20))

predictor.start()
replanner.start(scene.start, 0.0)
for t_s, posture in zip(motion.t_s - motion.t_s[0], motion.q, strict=True):
    prediction = predictor.update(posture, t_s)
    decision = replanner.respond(prediction.occupancy)
    if decision.action == "replan":
        print(f"{t_s:.2f} s  class {prediction.posterior.best}  goal {decision.chosen}: {decision.reason}")
        path = decision.trajectory  # positions, velocities and accelerations at its times
        print(f"        {len(path.t_s)} knots until {path.end_s:.2f} s")
replanner.close()
