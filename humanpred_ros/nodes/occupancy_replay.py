"""Feeds a recorded run's occupancy to a fresh planner, to see whether it decides the same."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from humanpred_ros import topics
from humanpred_ros.bags.messages import JOINT_STATE
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import BagError
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import entry_point
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.occupancy_topics import FORMS
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.nodes.stepping import SteppedSource
from humanpred_ros.settings import setting


class OccupancyReplaySettings(NodeSettings):
    """Parameters of `occupancy_replay`."""

    bag: str = setting("", "bag of a recorded run")
    bag_namespace: str = setting("", "of the robot, as /robot1; only needed where the bag holds several")
    wait_for: str = setting("", "comma-separated nodes whose /diagnostics must say ready before the replay starts")


class OccupancyReplay(SteppedSource):
    """Publishes the occupancies that were decided on, one decision at a time, and the arm's first state.

    Time is the recording's: /clock follows the stamps.
    """

    def __init__(self) -> None:
        super().__init__("occupancy_replay")

    def configure(self) -> None:
        self.settings = settings = declare(self, OccupancyReplaySettings)
        bag = BagReader(settings.bag, settings.bag_namespace or None)
        self.form = topics.recorded_occupancy({name: bag.topics[full].count for name, full in bag.names.items()})
        kind = FORMS[self.form]
        for topic, msgtype in ((self.form, f"sensor_msgs/msg/{kind.__name__}"), (topics.JOINT_STATES, JOINT_STATE)):
            bag.require_topic(topic, msgtype)
        decided = {conversions.stamp_ns(decision.header.stamp) for _, decision in bag.decoded(topics.DECISION)}
        # Decoded twice: what does not decode is refused before ROS, which believes the lengths it finds, sees it.
        clouds_in_order = (record for record in bag.messages([self.form]) if bag.decode(record))
        recorded = (deserialize_message(record.data, kind) for record in clouds_in_order)
        clouds = {conversions.stamp_ns(cloud.header.stamp): cloud for cloud in recorded}
        states = bag.messages([topics.JOINT_STATES])
        arm = next((deserialize_message(record.data, JointState) for record in states if bag.decode(record)), None)
        self.clouds = [clouds[stamp] for stamp in sorted(decided & clouds.keys())]
        if not self.clouds or arm is None:
            raise BagError(f"{settings.bag}: wanted decisions, occupancies and joint states, got no complete set")
        self.arm = arm

    def activate(self) -> None:
        self.next = 0
        self.publisher = self.create_publisher(FORMS[self.form], self.form, qos.SENSOR_PUBLISHER)
        self.arm_publisher = self.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
        self.arm_timer = self.create_timer(
            0.1, lambda: self.arm_publisher.publish(self.arm), clock=self._status_timer.clock
        )
        self.wait_for_graph(stepped=True, clock=True, peers=self.settings.wait_for, patience_s=(180.0, 30.0))

    def waiting_for(self) -> str:
        return super().waiting_for() or self.unmatched("stomp_planner", self.publisher)

    def publish_next(self) -> None:
        """Publish the next occupancy, or finish after the last."""
        if self.next == len(self.clouds):
            self.finish("the recording has ended")
            return
        cloud = self.clouds[self.next]
        self.next += 1
        t_ns = conversions.stamp_ns(cloud.header.stamp)
        self.sent(t_ns)
        self.publish_clock(t_ns)
        self.publisher.publish(cloud)

    def finish(self, reason: str) -> None:
        """End the work once everything sent has arrived."""
        self.publisher.wait_for_all_acked(Duration(seconds=1))
        super().finish(reason)


main = entry_point(OccupancyReplay)

if __name__ == "__main__":
    main()
