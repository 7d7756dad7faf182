"""Where the frame of a posture is: as TF says where there is TF, else as the scene says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import turn_and_shift

WORLD = "world"
#: A tracker that TF places farther from where the scene does is told of, m and rad.
_MOVED_M, _TURNED_RAD = 0.01, 0.01
#: People stand upright: smaller tilts of a frame are errors of calibration, larger ones are another kind of frame.
_MOST_TILT_RAD = 0.05

#: Returns the pose (4, 4) of a frame in the world; LookupError with the reason if TF knows none.
Lookup = Callable[[str], FloatArray]


def tf_lookup(node: Node) -> Lookup | None:
    """Return how to ask TF, None where tf2_ros is not installed (it has no wheel; every ROS installation has it)."""
    try:
        import tf2_ros  # type: ignore[import-not-found]
    except ImportError:
        return None
    buffer = tf2_ros.Buffer()
    # Lives as long as the function that asks.
    listener = tf2_ros.TransformListener(buffer, node)

    def lookup(frame: str, _listener: object = listener) -> FloatArray:
        try:
            found = buffer.lookup_transform(WORLD, frame, Time()).transform
        except tf2_ros.TransformException as trouble:
            raise LookupError(str(trouble)) from trouble
        p, r = found.translation, found.rotation
        return pose_matrix((p.x, p.y, p.z), (r.x, r.y, r.z, r.w))

    return lookup


def pose_matrix(p: tuple[float, float, float], quaternion: tuple[float, float, float, float]) -> FloatArray:
    """Return the (4, 4) pose at `p` turned by a quaternion x, y, z, w. Raises LookupError if it is no rotation."""
    q = np.array(quaternion)
    length = float(np.linalg.norm(q))
    if not (np.isfinite(p).all() and abs(length - 1.0) < 1e-3):
        raise LookupError(f"got a pose that is none: {p}, {quaternion}")
    x, y, z, w = q / length
    T = np.eye(4)
    T[:3, :3] = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    T[:3, 3] = p
    return T


class TrackerFrames:
    """Brings postures of any frame that TF knows into the tracker's frame of the scene.

    Attributes:
        expected: the frame in which postures are wanted.
        T_world_expected: (4, 4) its pose, as the scene says.
        lookup: asks TF; None where there is none.
        warning: that TF and the scene do not agree; empty if they do.
    """

    def __init__(self, expected: str, T_world_expected: FloatArray, lookup: Lookup | None) -> None:
        self.expected, self.T_world_expected, self.lookup = expected, T_world_expected, lookup
        self.warning = ""

    def placement(self, frame_id: str) -> FloatArray | None:
        """Return the (4, 4) transform from a frame to the expected one; None where nothing has to be moved.

        Raises:
            ArrayError: a frame of which nobody says where it is.
        """
        frame = frame_id.lstrip("/")
        if self.lookup is None and frame == self.expected:
            return None
        T_world_frame = self._pose(frame)
        if T_world_frame is None:
            return None
        T = np.linalg.inv(self.T_world_expected) @ T_world_frame
        tilt_rad = float(np.arccos(np.clip(T[2, 2], -1.0, 1.0)))
        if tilt_rad > _MOST_TILT_RAD:
            raise ArrayError(
                f"wrong frame: wanted one with z up as {self.expected!r}, got {frame!r:.80}, {tilt_rad:.3g} rad off"
            )
        moved_m = float(np.linalg.norm(T[:3, 3]))
        turned_rad = float(np.arccos(np.clip((np.trace(T[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))
        if frame == self.expected and (moved_m > _MOVED_M or turned_rad > _TURNED_RAD):
            apart = f"{moved_m:.3g} m and {turned_rad:.3g} rad"
            self.warning = f"TF places {frame!r} {apart} from where the scene does; TF is believed"
        return turn_and_shift(float(np.arctan2(T[1, 0], T[0, 0])), T[:3, 3])

    def pose(self, frame_id: str) -> FloatArray | None:
        """Return the (4, 4) pose of a frame, however tilted, in the scene's tracker frame; None where TF does not say.

        Raises:
            ArrayError: a frame other than the expected one, of which nobody says where it is.
        """
        T_world_frame = self._pose(frame_id.lstrip("/"))
        return None if T_world_frame is None else np.linalg.inv(self.T_world_expected) @ T_world_frame

    def _pose(self, frame: str) -> FloatArray | None:
        """Return the pose of a frame in the world, None for the expected one where the scene has to do."""
        if frame == WORLD:
            return np.eye(4)
        trouble = "tf2_ros, which could say where that is, is not installed"
        if self.lookup is not None and frame:
            try:
                return self.lookup(frame)
            except LookupError as error:
                trouble = f"TF has no way from there to {WORLD!r}: {error}"
        if frame == self.expected:
            return None
        if not frame:
            trouble = "the tracker has to say in which frame its data are"
        raise ArrayError(f"wrong frame: wanted {self.expected!r}, got {frame!r:.80}; {trouble}")
