"""Quality of service by purpose: every publisher and subscription takes its profile from here."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

#: Sensor data and predictions are offered reliably, so that a recorder or a stepped run loses none.
SENSOR_PUBLISHER = QoSProfile(depth=64, reliability=ReliabilityPolicy.RELIABLE)

#: Nodes that act on sensor data want the newest, not all: late data are worse than lost data.
SENSOR_SUBSCRIBER = QoSProfile(depth=16, reliability=ReliabilityPolicy.BEST_EFFORT)
NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

#: The arm's joint states wait while a step is planned; a gripper's, on the same topic, must not push them out.
ARM = QoSProfile(depth=8, reliability=ReliabilityPolicy.BEST_EFFORT)

#: Recorders and stepped runs: everything, in order.
LOSSLESS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)

#: Trajectories and decisions: few, and each one matters.
COMMAND = QoSProfile(depth=16, reliability=ReliabilityPolicy.RELIABLE)

#: Descriptions (URDF, voxel lattice) that a late subscriber still gets.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

#: Everything that publishers keep for late subscribers.
LATCHED_HISTORY = QoSProfile(
    history=HistoryPolicy.KEEP_ALL,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

#: Pictures for people.
MARKERS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


def sensor_subscription(lossless: bool, newest_only: bool = False) -> QoSProfile:
    """Return the profile with which a node listens to sensor data."""
    if lossless:
        return LOSSLESS
    return NEWEST_ONLY if newest_only else SENSOR_SUBSCRIBER
