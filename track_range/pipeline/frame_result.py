"""FrameResult: tracks, distances and times to collision of one frame, as arrays and object by
object.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

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
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.warning.warnings import Warnings
from track_range.ranging.world.cuboids import CuboidPlaces, Cuboids
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotion
from track_range.ranging.world.placement import PointStates, point_covariance
from track_range.stereo.geometry.frames import Frame, ImageView
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

_NAN3 = (math.nan, math.nan, math.nan)
Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
"""Vectors and matrices of `TrackedObject`, in the order of the axes."""


@dataclass(frozen=True, slots=True)
class PointState:
    """Position of a road user and its velocity relative to the camera, in one set of axes; NaN =
    unknown.

    Attributes:
        position_m: the point on the ray through the middle of the box, at the filtered distance.
        covariance_m2: (3, 3) of the position, row by row.
        velocity_mps: change of the position per second. The speed along the camera's y axis, which
            no filter has, is taken to be 0.
        velocity_covariance_m2ps2: (3, 3) of the velocity.
    """

    position_m: Vector3 = _NAN3
    covariance_m2: Matrix3 = (_NAN3, _NAN3, _NAN3)
    velocity_mps: Vector3 = _NAN3
    velocity_covariance_m2ps2: Matrix3 = (_NAN3, _NAN3, _NAN3)


@dataclass(frozen=True, slots=True)
class CuboidPlace:
    """Centre and direction of a cuboid in one set of axes; NaN = unknown.

    Attributes:
        centre_m: its centre.
        covariance_m2: (3, 3) of the centre, row by row.
        yaw_deg: direction of its front from the axis that points forward, counterclockwise seen
            from above.
    """

    centre_m: Vector3 = _NAN3
    covariance_m2: Matrix3 = (_NAN3, _NAN3, _NAN3)
    yaw_deg: float = math.nan


def _rows(matrix: Any) -> Matrix3:
    """A list of lists as a matrix."""
    first, second, third = map(tuple, matrix)
    return first, second, third


def _point_states(states: PointStates) -> Iterable[PointState]:
    """The states one by one."""
    return (
        PointState(tuple(p), _rows(P), tuple(v), _rows(V))
        for p, P, v, V in zip(
            states.position_m.tolist(),
            states.covariance_m2.tolist(),
            states.velocity_mps.tolist(),
            states.velocity_covariance_m2ps2.tolist(),
            strict=True,
        )
    )


def _cuboid_places(places: CuboidPlaces) -> Iterable[CuboidPlace]:
    """The centres and directions one by one."""
    centres, matrices = places.centre_m.tolist(), places.covariance_m2.tolist()
    return (
        CuboidPlace(tuple(centre), _rows(matrix), yaw_deg)
        for centre, matrix, yaw_deg in zip(centres, matrices, places.yaw_deg.tolist(), strict=True)
    )


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
        in_camera: position at the filtered distance, in frames without a measurement too, and
            relative velocity, with covariances, in the axes of the left camera.
        in_vehicle: the same in the axes of the vehicle (x forward, y left, z up, as ROS's REP 103),
            from its reference point; NaN without a `mount`, z also without its height.
        covariance_m2: (3, 3) covariance of `position_m`, row by row.
        closing_sigma_mps: standard deviation of `closing_mps`.
        ttc_sigma_s: standard deviation of `ttc_s`.
        speed_sigma_mps: standard deviation of `speed_mps`.
        gap_m: distance from the front of the ego vehicle; NaN without warnings.
        size_m: length, width and height of its cuboid, by its class and its views.
        size_sigma_m: their standard deviations.
        score: confidence of the detection, 0 to 1; it decays while the box is predicted.
        age_s: time since the first frame of the track.
        unobserved_s: time since its last detection; 0 = in this frame.
        yaw_sigma_deg: standard deviation of the yaw of its cuboid, modulo 180 where the front is not
            known.
        front_known: whether front and back of the cuboid are told apart; else its yaw may be turned
            by 180 degrees.
        cuboid_in_camera: centre and yaw of the cuboid in the axes of the left camera.
        cuboid_in_vehicle: the same in the axes of the vehicle; NaN without a `mount`.
        cuboid_in_world: the same in the frame `map`; NaN without an ego speed, z also without the
            height of the camera.
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
    in_camera: PointState = field(default_factory=PointState, repr=False)
    in_vehicle: PointState = field(default_factory=PointState, repr=False)
    covariance_m2: Matrix3 = field(default=(_NAN3, _NAN3, _NAN3), repr=False)
    closing_sigma_mps: float = math.nan
    ttc_sigma_s: float = math.nan
    speed_sigma_mps: float = math.nan
    gap_m: float = math.nan
    size_m: Vector3 = _NAN3
    size_sigma_m: Vector3 = _NAN3
    score: float = math.nan
    age_s: float = math.nan
    unobserved_s: float = math.nan
    yaw_sigma_deg: float = math.nan
    front_known: bool = False
    cuboid_in_camera: CuboidPlace = field(default_factory=CuboidPlace, repr=False)
    cuboid_in_vehicle: CuboidPlace = field(default_factory=CuboidPlace, repr=False)
    cuboid_in_world: CuboidPlace = field(default_factory=CuboidPlace, repr=False)


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
        dense: depths or disparities of all pixels by name of the method, of those that measure them
            (`sgbm`, networks, recorded depth); `DenseMap.depth_m()` is in metres.
        candidates: all detections of the frame, including other classes and low scores; None = not
            needed.
        shown_only: names of the methods that are not part of the fused distance.
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
    dense: Mapping[str, DenseMap] = field(default_factory=dict)
    candidates: Detections | None = None
    shown_only: frozenset[str] = frozenset()

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
            *self._robot_columns(fused),
        )
        return tuple(map(TrackedObject, *columns))

    def _robot_columns(self, fused: Ranges) -> Iterator[Iterable[object]]:
        """Values of `TrackedObject` from `in_camera` on, each for all tracks."""
        placement = self.world.placement
        in_camera = self.in_camera
        yield _point_states(in_camera)
        yield _point_states(in_camera.turned(placement.mounting))
        covariance_m2 = point_covariance(self.xyz_m, self.world.xy_sigma_m, fused.sigma_m)
        yield map(_rows, covariance_m2.tolist())
        yield self.closing_sigma_mps.tolist()
        yield self.ttc_sigma_s.tolist()
        yield self.motion.speed_sigma_mps.tolist()
        yield self.safety.gap_m.tolist()
        cuboids = self.cuboids
        yield map(tuple, cuboids.lwh_m.tolist())
        yield map(tuple, cuboids.lwh_sigma_m.tolist())
        yield self.tracks.score.tolist()
        yield placement.age_s.tolist()
        yield placement.unobserved_s.tolist()
        yield cuboids.yaw_sigma_deg.tolist()
        yield cuboids.front_known.tolist()
        yield _cuboid_places(cuboids.in_camera)
        yield _cuboid_places(cuboids.in_vehicle(placement.mounting))
        yield _cuboid_places(cuboids.in_world(self.ego_pose, placement.mounting))

    @property
    def in_camera(self) -> PointStates:
        """Positions at the filtered distances and relative velocities with covariances, in the axes
        of the left camera (right, down, forward).
        """
        filtered = self.ranges.get("fused_kf") or Ranges.unmeasured(self.tracks.track_id)
        rate = -self.closing_mps, self.closing_sigma_mps
        return self.world.placement.in_camera(filtered.sigma_m, rate)

    @property
    def in_vehicle(self) -> PointStates:
        """The same in the axes of the vehicle (forward, left, up); NaN if the mounting of the camera
        is unknown.
        """
        return self.in_camera.turned(self.world.placement.mounting)

    @property
    def disparity(self) -> FloatArray32 | None:
        """(H, W) disparities in px as measured, NaN = unknown, of the first method that measures
        them for all pixels; None = no such method ran.
        """
        maps = (dense for dense in self.dense.values() if dense.quantity == "disparity")
        return next((dense.in_image(dense.values) for dense in maps), None)

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
    def cuboids(self) -> Cuboids:
        """Sizes, headings and centres of the cuboids of the tracks."""
        return self.world.cuboids

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
