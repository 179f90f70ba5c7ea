"""FrameResult: tracks, distances and times to collision of one frame, as arrays and object by
object.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import FloatArray, FloatArray32, Image
from track_range.pipeline.alarming import Alarms
from track_range.pipeline.filtering import Approach
from track_range.pipeline.world import World
from track_range.ranging.cameras.causes import ScaleDoubt
from track_range.ranging.cameras.doubt import Doubt
from track_range.ranging.cameras.learnt_focal import FocalEstimate
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.warning.warnings import Warnings
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotion
from track_range.stereo.geometry.frames import Frame, ImageView
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True)
class TrackedObject:
    """One road user in one frame.

    Attributes:
        id: identity, the same in all frames.
        class_name: one of `ROAD_CLASSES`.
        xyxy_px: left, top, right, bottom edge of its box.
        distance_m: fused distance, `ranges["fused"]` and `fused_m` in tracks.csv; NaN = not
            measured, for example where the box is predicted, or touches the border of the image.
        sigma_m: its standard deviation.
        closing_mps: closing speed, from the filtered distance, positive = approaching; NaN =
            unknown.
        ttc_s: time to collision, distance / closing speed; NaN = not approaching.
        position_m: ranged point in the left camera's frame (x right, y down, z forward); z is
            `distance_m`.
        is_observed: False where the box is predicted, without a detection in this frame.
        speed_mps: speed over ground; NaN = unknown.
        state: "parked", "moving", "oncoming", "crossing", or "" = unknown.
        state_probability: probability that the state is right; NaN = unknown.
        filtered_m: distance filtered over time, `ranges["fused_kf"]` and `fused_kf_m`, in frames
            without a measurement too; NaN = not measured yet.
        filtered_sigma_m: its standard deviation.
        x_sigma_m: standard deviation of x of `position_m`: by the distance, the box and the
            principal point.
        y_sigma_m: the same of y.
    """

    id: int
    class_name: str
    xyxy_px: tuple[float, float, float, float]
    distance_m: float
    sigma_m: float
    closing_mps: float
    ttc_s: float
    position_m: tuple[float, float, float]
    is_observed: bool
    speed_mps: float = math.nan
    state: str = ""
    filtered_m: float = math.nan
    filtered_sigma_m: float = math.nan
    x_sigma_m: float = math.nan
    y_sigma_m: float = math.nan
    state_probability: float = math.nan


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Tracks of one frame with their distances; every array is in the order of the tracks.

    Example:
        >>> import track_range as tr
        >>> run = tr.Run.stereo("left.mp4", "right.mp4", rig="rig.yaml")
        >>> near = {t.class_name for frame in run for t in frame.objects if t.is_observed and t.distance_m < 40}
        >>> "car" in near
        True

    Attributes:
        frame: the images and their time; with `--anonymize` the anonymized left image only.
        tracks: N boxes with identities.
        ranges: distances by name of the method, including "fused" and the filtered ones (NAME_kf);
            a method that did not run is absent.
        approach: closing speed and time to collision of each track.
        world: ranged point, speed over ground and world position of each track, and the pose of the
            camera.
        alarms: warnings and measures of safety of each track; unknown in a run without warnings.
        ego: speed of the camera along its axis, its standard deviation, and the yaw rate.
        lanes: lines of the ego lane; without lines if no lane detector ran.
        doubt: contradiction between given values and the drive, and the errors that follow.
        disparity: (H, W) disparities in px, NaN = unknown; None if dense stereo did not run.
        candidates: all detections of the frame, including other classes and low scores; None = not
            needed.
    """

    frame: Frame
    tracks: Tracks
    ranges: Mapping[str, Ranges]
    approach: Approach
    world: World
    alarms: Alarms
    ego: EgoMotion = field(default_factory=EgoMotion)
    lanes: LaneLines = field(default_factory=LaneLines)
    doubt: Doubt = field(default_factory=Doubt)
    disparity: FloatArray32 | None = None
    candidates: Detections | None = None

    def __repr__(self) -> str:
        objects = self.objects
        measured = [
            (t.distance_m, f", nearest {t.class_name} {t.id} at {t.distance_m:.1f} m")
            for t in objects
        ]
        nearest = min((pair for pair in measured if math.isfinite(pair[0])), default=(0.0, ""))[1]
        return (
            f"FrameResult(index={self.index}, time_s={self.time_s:.3f}, {len(objects)} "
            f"objects{nearest})"
        )

    @property
    def objects(self) -> tuple[TrackedObject, ...]:
        """The road users one by one, in the order of the tracks; made at each access, from the
        arrays.
        """
        tracks = self.tracks
        unmeasured = Ranges.unmeasured(tracks.track_id)
        fused, filtered = (self.ranges.get(name, unmeasured) for name in ("fused", "fused_kf"))
        motion = self.motion
        names = np.array([*MOTION_STATES, ""])[
            np.nan_to_num(motion.state, nan=-1.0).astype(np.int64)
        ]
        numbers = (fused.distance_m, fused.sigma_m, self.closing_mps, self.ttc_s)
        columns = (
            *(
                tracks.track_id.tolist(),
                map(ROAD_CLASSES.__getitem__, tracks.class_id),
                map(tuple, tracks.xyxy_px.tolist()),
            ),
            *(values.tolist() for values in numbers),
            *(
                map(tuple, self.xyz_m.tolist()),
                tracks.observed.tolist(),
                motion.speed_mps.tolist(),
                names.tolist(),
            ),
            *(filtered.distance_m.tolist(), filtered.sigma_m.tolist()),
            *self.world.xy_sigma_m.T.tolist(),
            motion.state_probability.tolist(),
        )
        return tuple(map(TrackedObject, *columns))

    @property
    def closing_mps(self) -> FloatArray:
        """(N,) closing speed in m/s (positive = approaching), from the filtered fused distance; NaN
        = unknown.
        """
        return self.approach.closing_mps

    @property
    def closing_sigma_mps(self) -> FloatArray:
        """(N,) standard deviation of the closing speed."""
        return self.approach.closing_sigma_mps

    @property
    def ttc_s(self) -> FloatArray:
        """(N,) time to collision in s, distance / closing speed; NaN = not approaching."""
        return self.approach.ttc_s

    @property
    def ttc_sigma_s(self) -> FloatArray:
        """(N,) standard deviation of the time to collision."""
        return self.approach.ttc_sigma_s

    @property
    def xyz_m(self) -> FloatArray:
        """(N, 3) ranged point in the left camera's frame (x right, y down, z forward), from the
        fused distance; NaN = unknown.
        """
        return self.world.xyz_m

    @property
    def motion(self) -> ObjectMotion:
        """Speed over ground, heading, world position and state of each track."""
        return self.world.motion

    @property
    def ego_pose(self) -> EgoPose:
        """Pose of the camera in the frame `map`; NaN = unknown."""
        return self.world.ego_pose

    @property
    def ego_mps(self) -> float:
        """Speed of the camera along its axis in m/s, negative = backwards; NaN = unknown."""
        return self.ego.speed_mps

    @property
    def ego_sigma_mps(self) -> float:
        """Standard deviation of the speed of the camera; NaN = unknown."""
        return self.ego.speed_sigma_mps

    @property
    def warnings(self) -> Warnings:
        """Probability of contact and alarm of each track; unknown in a run without warnings."""
        return self.alarms.warnings

    @property
    def safety(self) -> SafetyMeasures:
        """Gap, headway, required deceleration and further measures of each track."""
        return self.alarms.safety

    @property
    def scale_doubt(self) -> ScaleDoubt | None:
        """Contradiction between a given scale and the drive; None = none was found."""
        return self.doubt.scale

    @property
    def focal(self) -> FocalEstimate | None:
        """The focal length that the distances have, in px of the rectified images, its relative
        sigma, source and time of first use; None = it was given. Its `sentence` says it in words.
        """
        return self.doubt.focal

    @property
    def left(self) -> Image:
        """(H, W, 3) uint8 BGR left image, see `Frame`."""
        return self.frame.left

    @property
    def right(self) -> ImageView | None:
        """Right image, see `Frame`; None for one camera."""
        return self.frame.right

    @property
    def index(self) -> int:
        """Number of the frame in the video, from 0."""
        return self.frame.index

    @property
    def time_s(self) -> float:
        """Seconds from the first frame of the video."""
        return self.frame.time_s

    @property
    def utc_s(self) -> float:
        """Seconds since 1970-01-01 00:00 UTC; NaN = unknown."""
        return self.frame.utc_s
