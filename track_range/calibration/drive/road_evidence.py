"""Evidence of a video about its camera: boxes of road users, rows of the horizon, and the motion of
the static scene.

Frames are read at `STEP_S`, as close as tracking needs them. The horizon comes from the lines of
the ego lane, where they meet, and from the direction of travel (epipole), which is parallel to the
road.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from track_range.calibration.drive.drive_video import TIME_EPSILON_S, every_step
from track_range.detection.detections import Detections
from track_range.detection.lanes.edges import EdgeLaneFinder
from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import mad_sigma
from track_range.ranging.cameras.measurements import (
    HorizonRow,
    SceneBoxes,
    unhidden,
)
from track_range.ranging.cameras.unknowns import USUAL_HEIGHT_M
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.self_calibration.scene_motion import MotionEstimate, SceneMotion
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.registry import create_tracker

# time between the frames that are read, and between those in which road users are detected, whose
# boxes hide them in the next frame too
STEP_S, DETECTION_S = 0.1, 0.2
_MIN_ROWS = 5  # smallest number of rows from which the horizon is taken
# Standard deviations of the horizon from lanes and from the direction of travel that do not average
# out: slopes and curves of the road, and the vehicle's attitude.
_LANE_SIGMA_RAD, _TRAVEL_SIGMA_RAD = 0.006, 0.006
# of a focal length from motion above which the motion does not separate it from the distortion
LENS_SIGMA = 0.04
# smallest mean grey level, of every so many pixels, of an image that shows motion: in a darker one,
# the blocks of the compression are followed, and 412 px within 0.6 % came from a lens of 1,160 px
_LEAST_BRIGHTNESS, _STEP_PX = 20.0, 8
_PART_GAP_S = 1e6  # added to the times of each further part, for the motion
_IDS_PER_PART = 1_000_000  # difference between the track ids of two parts of a video


@dataclass(slots=True)
class RoadEvidence:
    """The evidence so far."""

    has_horizon: bool  # whether the row of the horizon is sought
    focal_px: float = math.nan  # of the approximate camera
    n_frames: int = 0
    # of tracks, not hidden by others, by frame
    boxes: list[SceneBoxes] = field(default_factory=list)
    lane_rows: list[float] = field(default_factory=list)  # rows of the horizon from lanes, px
    travel_rows: list[float] = field(default_factory=list)  # rows of the direction of travel, px
    motion: SceneMotion | None = None  # of the static scene in all parts; None = none was added
    # height of the camera by the given speed, at the approximate focal length
    heights: CameraHeight = field(default_factory=lambda: CameraHeight(USUAL_HEIGHT_M))
    # by this motion, with times in its video and the name of this video, "" for the only one
    lens: tuple[MotionEstimate, str] | None = None
    _videos: list[str] = field(default_factory=list)  # names of those of the parts

    def add(
        self,
        video: str,
        camera: PinholeCamera,
        frames: Iterable[Frame],
        detect: Callable[[Frame], Detections],
        advance: Callable[[int, int | None], None],
        speed: EgoSpeed | None = None,
    ) -> None:
        """Add a part of a `video`, a name, of an approximate camera, perhaps with its given speed;
        `advance` is called with the number of frames so far.
        """
        tracker, lanes, travel = (
            create_tracker("deepsort"),
            EdgeLaneFinder(),
            ImageMotionEstimator(camera),
        )
        self.focal_px = camera.fx_px
        if self.motion is None:
            self.motion = SceneMotion(camera.size_px, start_px=camera.fx_px)
        # parts of several videos follow each other with a gap
        base_s = len(self._videos) * _PART_GAP_S
        self._videos.append(video)
        detections, detected_s = Detections.empty(), -np.inf
        road = None if speed is None else GroundOdometry(camera, USUAL_HEIGHT_M)
        for frame in every_step(STEP_S, frames):
            if frame.time_s - detected_s > DETECTION_S - TIME_EPSILON_S:
                detections, detected_s = detect(frame), frame.time_s
                tracks = tracker.update(detections, frame.time_s, frame.left)
                rows = np.flatnonzero(tracks.observed & unhidden(tracks.xyxy_px))
                ids = tracks.track_id[rows] + len(self._videos) * _IDS_PER_PART
                self.boxes.append(SceneBoxes(tracks.xyxy_px[rows], tracks.class_id[rows], ids))
            if frame.left[::_STEP_PX, ::_STEP_PX].mean() >= _LEAST_BRIGHTNESS:
                self.motion.add(frame.left, base_s + frame.time_s, detections.xyxy_px)
            if road is not None and speed is not None:
                known = EgoMotion(speed_mps=speed.at(frame.time_s))
                by_road = road.update(frame, detections.xyxy_px)
                self.heights.update(base_s + frame.time_s, known, by_road)
            if self.has_horizon:
                lines = lanes.find(frame.left, frame.time_s, detections.xyxy_px)
                if (row := lines.horizon_px()) is not None:
                    self.lane_rows.append(row[0])
                motion = travel.update(frame.left, frame.time_s, detections.xyxy_px)
                if np.isfinite(motion.travel[1]):
                    self.travel_rows.append(camera.fy_px * motion.travel[1] + camera.cy_px)
            self.n_frames += 1
            advance(self.n_frames, None)

    @property
    def scene(self) -> SceneBoxes:
        """All boxes."""
        return SceneBoxes.joined(self.boxes)

    def measure_lens(self) -> None:
        """Estimate the lens from the motion of the static scene of all parts."""
        estimate = None if self.motion is None else self.motion.estimate()
        if estimate is None:
            return
        video = self._videos[int(estimate.span_s[0] // _PART_GAP_S)]
        first_s, last_s = (time_s % _PART_GAP_S for time_s in estimate.span_s)
        shown = video if len(set(self._videos)) > 1 else ""
        self.lens = replace(estimate, span_s=(first_s, last_s)), shown

    @property
    def shows_lens(self) -> bool:
        """Whether the motion separates the focal length from the distortion."""
        return self.lens is not None and self.lens[0].sigma <= LENS_SIGMA

    def horizon(self, focal_px: float) -> tuple[HorizonRow, ...]:
        """The row of the horizon from lanes and from the direction of travel, where enough frames
        have a horizon; `focal_px` gives its sigma.
        """
        rows = (
            _row(self.lane_rows, _LANE_SIGMA_RAD * focal_px, "lane lines"),
            _row(self.travel_rows, _TRAVEL_SIGMA_RAD * focal_px, "direction of travel"),
        )
        return tuple(row for row in rows if row is not None)


def _row(rows_px: Sequence[float], common_px: float, source: str) -> HorizonRow | None:
    """Median of the rows; its sigma covers independent rows and a part common to all rows."""
    if len(rows_px) < _MIN_ROWS:
        return None
    values: FloatArray = np.array(rows_px)
    middle = float(np.median(values))
    independent_px = 1.25 * mad_sigma(values) / math.sqrt(len(values))
    return HorizonRow(middle, math.hypot(common_px, independent_px), source)
