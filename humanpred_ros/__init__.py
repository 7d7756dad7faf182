"""Early prediction of human reaches and replanning of a robot arm at a shared table.

`import humanpred_ros as hp` gives what a program needs, without ROS:

| name | what it is |
|---|---|
| `load_library`, `write_library` | labelled recordings of people: bags, CSV folders, or shipped ones |
| `Motion`, `MotionLibrary` | one timed motion, and a library of them |
| `train`, `save_model`, `load_model` | what classifiers learn from a library, and its file |
| `load_scene` | arm, table, tasks, lattice and tracker of a scene |
| `SkeletonTracker` | points of any body tracker, frame after frame, to postures |
| `make_predictor` | posture after posture to predicted human occupancy |
| `Occupancy` | a probability for each voxel |
| `Replanner`, `ReplannerConfig` | P1's Algorithm 1: occupancy after occupancy to decisions and trajectories |
| `read_run` | a recorded run as arrays |
| `human_of` | the human model of a library |
| `Classifier`, `ClassPosterior`, `Predictor`, `Prediction`, `CostTerm`, `Settings`, `setting` | to build your own on |
| `HumanPredError` | base of every error raised on purpose |

The modules behind these names are loaded when a name is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from humanpred_ros.api import human_of as human_of
    from humanpred_ros.api import load_library as load_library
    from humanpred_ros.api import load_model as load_model
    from humanpred_ros.api import make_predictor as make_predictor
    from humanpred_ros.api import save_model as save_model
    from humanpred_ros.api import train as train
    from humanpred_ros.api import write_library as write_library
    from humanpred_ros.errors import HumanPredError as HumanPredError
    from humanpred_ros.geometry.lattice import Occupancy as Occupancy
    from humanpred_ros.human.skeleton_tracker import SkeletonTracker as SkeletonTracker
    from humanpred_ros.motion.motion import Motion as Motion
    from humanpred_ros.motion.motion import MotionLibrary as MotionLibrary
    from humanpred_ros.occupancy.predictor import Prediction as Prediction
    from humanpred_ros.occupancy.predictor import Predictor as Predictor
    from humanpred_ros.planning.replanner import Replanner as Replanner
    from humanpred_ros.planning.replanner_config import ReplannerConfig as ReplannerConfig
    from humanpred_ros.recognition.classifier import Classifier as Classifier
    from humanpred_ros.recognition.classifier import ClassPosterior as ClassPosterior
    from humanpred_ros.robot.scene import load_scene as load_scene
    from humanpred_ros.settings import Settings as Settings
    from humanpred_ros.settings import setting as setting
    from humanpred_ros.stomp.costs import CostTerm as CostTerm
    from humanpred_ros.viewing.run import read_run as read_run

#: Where each public name is defined. Loading everything at once would cost a node that passes messages on 200 MB.
_MODULES = {
    "api": "human_of load_library load_model make_predictor save_model train write_library",
    "errors": "HumanPredError",
    "geometry.lattice": "Occupancy",
    "human.skeleton_tracker": "SkeletonTracker",
    "motion.motion": "Motion MotionLibrary",
    "occupancy.predictor": "Prediction Predictor",
    "planning.replanner": "Replanner",
    "planning.replanner_config": "ReplannerConfig",
    "recognition.classifier": "Classifier ClassPosterior",
    "robot.scene": "load_scene",
    "settings": "Settings setting",
    "stomp.costs": "CostTerm",
    "viewing.run": "read_run",
}
_HOME = {name: module for module, names in _MODULES.items() for name in names.split()}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}; it has {', '.join(_HOME)}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
