"""Evidence of the focal length by the motion of the static scene in turns of the camera."""

import math
from collections.abc import Sequence
from concurrent.futures import Future

from track_range.foundation.background import Background, InThreads
from track_range.ranging.cameras.evidence import Evidence, SeenFrame
from track_range.ranging.cameras.unknowns import Unknown
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.self_calibration.corner_tracks import CornerTracks, KeyPoints
from track_range.stereo.self_calibration.scene_motion import MotionEstimate, SceneMotion

_MIN_YAW_RAD_S = 0.05  # yaw rate of a turn
_MIN_TURN_RAD = math.radians(12.0)  # smallest turn that is measured
_MAX_TURN_S = 6.0  # longest part of a turn that is measured at once
_PAUSE_S = 0.5  # longest time without yaw rate inside a turn
_DELAY_S = 3.0  # until the result of a turn is used
_N_TURNS = 2  # measured in a drive: further ones do not change the estimate
_KEPT = 2  # one of so many points is used: the time grows with their number
# largest error that is evidence, and an error that the turns of a drive have in common
_MAX_SIGMA, _SHARED_SIGMA = 0.1, 0.015


class MotionEvidence:
    """Focal length by corners of the static scene, measured in the first turns of a drive.

    Corners are tracked during turns only. Their bundle adjustment runs in the background; its
    result is used at a fixed time, so that runs are reproducible, or later.
    """

    def __init__(self, camera: PinholeCamera, background: Background | None = None) -> None:
        self._background = background or InThreads()
        self._camera, self._n_left = camera, _N_TURNS
        self._corners, self._points = CornerTracks(camera.size_px), list[KeyPoints]()
        self._turn_rad = 0.0
        self._first_s = self._last_s = -math.inf
        self._future: Future[MotionEstimate | None] | None = None
        # log of the focal length over that by the turns
        self.evidence: tuple[Evidence, ...] = ()

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        if self._future is not None:
            is_due = seen.time_s >= self._last_s + _DELAY_S
            if is_due and self._background.is_ready(self._future):
                self._use(self._future.result())
                self._future = None
            return
        yaw_rad_s = seen.ego.motion.yaw_rad_s
        if self._n_left == 0:
            return
        if abs(yaw_rad_s) >= _MIN_YAW_RAD_S:  # False for NaN
            self._track(seen, yaw_rad_s)
        is_over = seen.time_s > self._last_s + _PAUSE_S or seen.time_s > self._first_s + _MAX_TURN_S
        if self._points and is_over:
            self._end()

    def _track(self, seen: SeenFrame, yaw_rad_s: float) -> None:
        step_s = seen.time_s - self._last_s
        if step_s > _PAUSE_S:
            self._first_s, step_s = seen.time_s, 0.0
        self._turn_rad += yaw_rad_s * step_s
        self._last_s = seen.time_s
        if seen.image is None:
            return
        points = self._corners.add(seen.image, seen.time_s, seen.tracks.xyxy_px)
        if points is not None:
            kept = points.number % _KEPT == 0
            self._points.append(
                points._replace(number=points.number[kept], xy_px=points.xy_px[kept])
            )

    def _end(self) -> None:
        """Measure the turn, if it is large enough, and wait for the next one."""
        if abs(self._turn_rad) >= _MIN_TURN_RAD:
            self._n_left -= 1
            self._future = self._background.submit(_estimate, self._camera, tuple(self._points))
        self._corners, self._points = CornerTracks(self._camera.size_px), []
        self._turn_rad = 0.0

    def _use(self, shown: MotionEstimate | None) -> None:
        if shown is None or shown.sigma > _MAX_SIGMA:
            return
        minutes, seconds = divmod(round(shown.span_s[0]), 60)
        self.evidence += (
            Evidence(
                f"the turn at {minutes}:{seconds:02d}",
                {Unknown.FOCAL: 1.0},
                math.log(self._camera.fx_px / shown.focal_px),
                math.hypot(shown.sigma, _SHARED_SIGMA),
            ),
        )


def _estimate(camera: PinholeCamera, points: Sequence[KeyPoints]) -> MotionEstimate | None:
    motion = SceneMotion(camera.size_px, start_px=camera.fx_px)
    for key_points in points:
        motion.add_points(key_points)
    return motion.estimate()
