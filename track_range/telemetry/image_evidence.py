"""Motion in the first seconds of a video, and whether telemetry contradicts it."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from track_range.foundation.errors import UserError
from track_range.ranging.ego_speed import EgoSpeed
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.telemetry.time_offset import MAX_OFFSET_S, MotionSeries
from track_range.video.names import RecordedName
from track_range.video.reader import VideoReader

SPAN_S = 30.0
"""Length of the video, s, from which motion is measured before a run: three times the largest offset on both sides."""

_STEP_S = 0.095
"""Shortest time between two images that are compared, s: 10 Hz."""

_CLAIMED_MPS = 3.0
"""Speed in m/s that a camera at rest cannot have; below it, receivers state noise of cars that stand."""

_MIN_STILL = 10
"""Number of images at rest, 1 s, from which telemetry can contradict them."""

_MAX_CONTRADICTED = 0.5
"""Largest share of images at rest at which telemetry may state a motion: most errors of the measurement are single."""

_MOVING_HZ = 0.2
"""Expansion of images that only a moving camera has, 1/s: 2 m/s at a typical depth of 10 m."""

_STANDING_MPS = 0.3
"""Largest speed in m/s that telemetry states for a car at rest."""


def motion_of(
    video: RecordedName, camera: PinholeCamera, *, start_s: float, folder_fps: float, span_s: float = SPAN_S
) -> MotionSeries:
    """Motion of the images of a video from `start_s` on; empty if they cannot be read.

    Args:
        video: the left video.
        camera: its approximate camera.
        start_s: start in seconds from the first frame.
        folder_fps: frame rate of folders without timestamps.
        span_s: length of the part to read.
    """
    rows: list[tuple[float, float, float, float]] = []
    try:
        reader = VideoReader(video, folder_fps=folder_fps, start_s=start_s, duration_s=span_s)
        if (reader.width_px, reader.height_px) != (camera.width_px, camera.height_px):
            camera = _resized(camera, reader.width_px, reader.height_px)
        estimator, due_s = ImageMotionEstimator(camera), -np.inf
        with closing(reader), closing(iter(reader)) as frames:
            for frame in frames:
                time_s = frame.time_s - reader.first_time_s
                if time_s < due_s:
                    continue
                due_s = time_s + _STEP_S
                motion = estimator.update(frame.image, time_s)
                if motion.is_known:
                    middle_s = time_s - motion.dt_s / 2
                    rows.append((middle_s, motion.yaw_rad_s, motion.expansion_hz, float(motion.is_still)))
    except UserError:
        pass  # the run reports what it cannot read
    values = np.array(rows).reshape(-1, 4)
    return MotionSeries(
        time_s=values[:, 0], yaw_rad_s=values[:, 1], expansion_hz=values[:, 2], is_still=values[:, 3] > 0
    )


def contradiction(motion: MotionSeries, ego: EgoSpeed) -> str | None:
    """Contradiction between the images and the speed, as the end of a sentence; None = none is visible.

    A time offset of up to `MAX_OFFSET_S` is allowed.
    """
    claims = np.array([_extremes_mps(ego, time_s) for time_s in motion.time_s.tolist()]).reshape(-1, 2)
    known = np.isfinite(claims[:, 0])
    still = motion.is_still & known
    if still.sum() >= _MIN_STILL:
        is_false = claims[still, 0] > _CLAIMED_MPS
        if is_false.mean() > _MAX_CONTRADICTED:
            claimed_kmh = 3.6 * float(np.median(claims[still, 0][is_false]))
            return f"it states {claimed_kmh:.0f} km/h while the camera is at rest"
    moving = (motion.expansion_hz > _MOVING_HZ) & ~motion.is_still & known
    if moving.sum() >= _MIN_STILL and (claims[moving, 1] < _STANDING_MPS).mean() > _MAX_CONTRADICTED:
        return "it states that the car is at rest while the camera moves"
    return None


def _extremes_mps(ego: EgoSpeed, time_s: float) -> tuple[float, float]:
    """Smallest and largest speed within the largest offset of a time; NaN = unknown."""
    speeds = [abs(ego.at(time_s + offset_s)) for offset_s in np.linspace(-MAX_OFFSET_S, MAX_OFFSET_S, 13).tolist()]
    known = [speed for speed in speeds if np.isfinite(speed)]
    return (min(known), max(known)) if known else (np.nan, np.nan)


def _resized(camera: PinholeCamera, width_px: int, height_px: int) -> PinholeCamera:
    """The camera for images of another size, which the rectification or a crop of the pair changes."""
    return PinholeCamera(camera.fx_px, camera.fy_px, (width_px - 1) / 2, (height_px - 1) / 2, width_px, height_px)
