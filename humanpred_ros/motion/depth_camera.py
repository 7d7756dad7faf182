"""What a depth camera's skeleton tracker makes of a moving person: noise, lag, lost points and lost frames.

Synthetic motions pass through here, so that programs that work on them have met what real streams contain.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.motion.motion import SKELETON_POINTS
from humanpred_ros.motion.reaching_body import slow_noise

_LIMBS = np.array([name.endswith(("elbow", "hand", "knee", "foot")) for name in SKELETON_POINTS])
_TORSO = SKELETON_POINTS.index("torso")
#: Lever that turns an error of the trunk's place into one of its direction, metres; half a trunk's size.
_LEVER_M = 0.25
#: Behind the table, most of the time.
_LEGS = np.array([name.endswith(("knee", "foot")) for name in SKELETON_POINTS])
#: Frames after which smoothing has forgotten how it began.
_SETTLING = 15
#: Independent errors of a frame: three of each point, and shift and turn of the trunk.
_ERRORS = 3 * len(SKELETON_POINTS) + 6


@dataclass(frozen=True)
class DepthCameraConfig:
    """A camera like the first Kinect with OpenNI's tracker.

    Sizes are chosen so that the resulting postures tremble as much as library_b's at rest (palm 3 mm within 0.3 s,
    1 mm from frame to frame).

    Attributes:
        position_m: the lens, in the tracker's frame; depth is the distance from it.
        rate_hz: frames per second.
        stamp_jitter_s: standard deviation of the stamps' delay.
        noise_m: standard deviation of the trunk's place across the line of sight, before smoothing; it turns by as
            much on a lever of 0.25 m.
        depth_factor: how much larger errors are along the line of sight.
        limb_factor: how much larger for elbows, hands, knees and feet, which are thin and move; theirs are
            independent of each other.
        trunk_play: how much smaller each trunk point's own error is. Trackers fit the trunk as one piece: in
            library_b its twist TorsoZ stays within 0.004 rad at rest, while its yaw varies by 0.08.
        smoothing: share of the previous output in each output, 0 to below 1 (OpenNI's smoothing factor).
        wander_m: standard deviation of the slow error, likewise (the tracker's model of the body slips).
        wander_s: its time constant.
        frame_loss: share of frames that never arrive.
        losses_per_s: how often a point gets lost.
        leg_losses_per_s: the same for knees and feet, which the table hides.
        loss_s: mean duration of a loss.
        step_m: points are delivered in whole steps of this size.
    """

    position_m: tuple[float, float, float] = (0.25, 0.75, 1.10)
    rate_hz: float = 30.0
    stamp_jitter_s: float = 0.0015
    noise_m: float = 0.0025
    depth_factor: float = 2.0
    limb_factor: float = 1.6
    trunk_play: float = 0.05
    smoothing: float = 0.6
    wander_m: float = 0.004
    wander_s: float = 0.8
    frame_loss: float = 0.01
    losses_per_s: float = 0.015
    leg_losses_per_s: float = 0.25
    loss_s: float = 0.10
    step_m: float = 2.0**-13

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not np.isfinite(value).all() or (field.name != "position_m" and value < 0):
                raise UsageError(f"depth camera: wanted {field.name} finite and not negative, got {value}")
        for name in ("rate_hz", "wander_s", "loss_s", "step_m"):
            if getattr(self, name) == 0:
                raise UsageError(f"depth camera: wanted {name} above 0, got 0")
        for name in ("smoothing", "frame_loss"):
            if getattr(self, name) >= 1:
                raise UsageError(f"depth camera: wanted {name} to be a share below 1, got {getattr(self, name)}")


@dataclass(frozen=True)
class Recording:
    """What arrived.

    Attributes:
        t_s: (T,) stamps, strictly increasing.
        points_m: (T, 15, 3) in the order of SKELETON_POINTS, NaN where a point was lost.
    """

    t_s: FloatArray
    points_m: FloatArray


class DepthCamera:
    """Observes skeletons; has no state between recordings."""

    def __init__(self, config: DepthCameraConfig = DepthCameraConfig()) -> None:
        self.config = config

    def exposures_s(self, duration_s: float) -> FloatArray:
        """Return the times (T,) at which the camera looks during a recording of that length, the first at 0."""
        return np.arange(int(duration_s * self.config.rate_hz) + 1) / self.config.rate_hz

    def observe(self, exposures_s: FloatArray, points_m: FloatArray, rng: np.random.Generator) -> Recording:
        """Return what arrives of a person whose points at the exposures (T,) are `points_m` (T, 15, 3).

        Raises:
            ArrayError: wrong shapes, or points that are not finite.
        """
        config = self.config
        t = checked("exposures_s", exposures_s, ("T",))
        true = checked("points_m", points_m, (len(t), len(SKELETON_POINTS), 3))
        # The tracker has watched the person before the recording starts: its smoothing has settled by then.
        t = np.concatenate([t[0] - np.arange(_SETTLING, 0, -1) / config.rate_hz, t])
        true = np.concatenate([np.repeat(true[:1], _SETTLING, axis=0), true])
        noise = config.wander_m * self._errors(true, slow_noise(t, config.wander_s, _ERRORS, rng))
        noise += config.noise_m * self._errors(true, rng.normal(size=(len(t), _ERRORS)))
        sight = true - np.asarray(config.position_m)
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        noise += (config.depth_factor - 1.0) * (noise * sight).sum(axis=-1, keepdims=True) * sight
        seen = self._smoothed(true + noise, self._losses(len(t), rng))[_SETTLING:]
        seen = np.round(seen / config.step_m) * config.step_m
        # At most a third of a period either way: stamps keep their order whatever the jitter.
        jitter = np.clip(config.stamp_jitter_s * rng.normal(size=len(t)), -0.3 / config.rate_hz, 0.3 / config.rate_hz)
        arrived = rng.random(len(seen)) >= config.frame_loss
        return Recording((t + jitter)[_SETTLING:][arrived], seen[arrived])

    def _errors(self, true: FloatArray, noise: FloatArray) -> FloatArray:
        """Return errors (T, 15, 3) in units of the trunk's, from unit noise (T, 51): points, trunk's shift and turn."""
        own = noise[:, :-6].reshape(true.shape)
        shift, turn = noise[:, None, -6:-3], noise[:, None, -3:] / _LEVER_M
        trunk = shift + np.cross(turn, true - true[:, _TORSO : _TORSO + 1]) + self.config.trunk_play * own
        errors: FloatArray = np.where(_LIMBS[:, None], self.config.limb_factor * own, trunk)
        return errors

    def _losses(self, n: int, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Draw which points are lost when (T, 15): each comes and goes as a two-state Markov chain."""
        per_s = np.where(_LEGS, self.config.leg_losses_per_s, self.config.losses_per_s)
        begin = 1.0 - np.exp(-per_s / self.config.rate_hz)
        end = 1.0 - np.exp(-1.0 / (self.config.loss_s * self.config.rate_hz))
        chance = rng.random((n, len(SKELETON_POINTS)))
        lost = np.zeros(chance.shape, dtype=bool)
        for k in range(n):
            before = lost[k - 1] if k else np.zeros(len(SKELETON_POINTS), dtype=bool)
            lost[k] = np.where(before, chance[k] >= end, chance[k] < begin)
        return lost

    def _smoothed(self, raw: FloatArray, lost: NDArray[np.bool_]) -> FloatArray:
        """Smooth points (T, 15, 3) as the tracker does, which starts anew with a point it had lost."""
        s = self.config.smoothing
        raw = np.where(lost[..., None], np.nan, raw)
        seen = raw.copy()
        for k in range(1, len(raw)):
            seen[k] = np.where(np.isnan(seen[k - 1]), raw[k], s * seen[k - 1] + (1.0 - s) * raw[k])
        return seen
