"""WorldStage: where the tracks and the camera are, and how the tracks move over ground."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.pipeline.filtering import Filtered
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.measurement.focal_scale import EXACT, FocalScale
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.class_sizes import ClassSizes
from track_range.ranging.size_models.size_model import BoxNoise, BoxTraits
from track_range.ranging.world.cuboid_estimator import CuboidEstimator
from track_range.ranging.world.cuboids import Cuboids
from track_range.ranging.world.ego_path import EgoPath, EgoPose
from track_range.ranging.world.object_motion import GroundVelocity, ObjectMotion, ObjectMotions
from track_range.ranging.world.placement import Placement, Placements
from track_range.ranging.world.road_motion import RoadMotions
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting, looks_ahead
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

_BOX_NOISE = BoxNoise()


@dataclass(frozen=True, slots=True)
class World:
    """Positions and motion of the N tracks of a frame and of the camera; NaN = unknown."""

    xyz_m: FloatArray  # (N, 3) ranged point in the left camera's frame, from the fused distance
    xy_sigma_m: FloatArray  # (N, 2) standard deviations of its x and y; that of z is the distance's
    motion: ObjectMotion  # over ground, and positions in the frame `map`
    ego_pose: EgoPose  # of the left camera in the frame `map`
    placement: Placement  # at the filtered distances, relative to the camera and to the vehicle
    cuboids: Cuboids  # sizes, headings and centres

    @classmethod
    def unknown(cls, n: int) -> "World":
        """The world of n tracks whose distances are unknown."""
        nan = np.nan
        return cls(
            np.full((n, 3), nan),
            np.full((n, 2), nan),
            ObjectMotion.unknown(n),
            EgoPose(),
            Placement.unknown(n),
            Cuboids.unknown(n),
        )


class WorldStage:
    """Places the tracks of a drive in the world of its first frame."""

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        centre_sigma_px: float = 0.0,
        mounting: Mounting | None = None,
        sizes: ClassSizes | None = None,
        traits: BoxTraits | None = None,
        road: RoadMotions | None = None,
    ) -> None:
        """`centre_sigma_px` is the standard deviation of the camera's principal point; with a
        `mounting`, states of motion are relative to the drive, and positions in the vehicle are
        known; `sizes` are those of the classes, `traits` of the detector's boxes. `road` has the
        motion on the plane of the road before a camera that stands still, and its frame is `map`.
        """
        self.road = road
        self._camera, self._centre_sigma_px = camera, centre_sigma_px
        self._is_ahead = looks_ahead(mounting)
        axis_deg = 0.0 if mounting is None else mounting.yaw_deg
        self._path, self._motions = EgoPath(), ObjectMotions(math.radians(axis_deg))
        self._placements = Placements(mounting)
        self._cuboids = CuboidEstimator(mounting, sizes, traits)

    def update(
        self,
        tracks: Tracks,
        filtered: Filtered,
        ranges: Mapping[str, Ranges],
        ego: EgoMotion,
        time_s: float,
        focal: FocalScale = EXACT,
    ) -> World:
        """The world at `time_s`, by all distances of the frame and the motion of the camera, which
        `focal` has corrected.
        """
        pose, lateral = self._path.update(time_s, ego), filtered.lateral
        camera = self._camera if focal.factor == 1.0 else focal.camera(self._camera)
        rays = camera.rays((tracks.xyxy_px[:, :2] + tracks.xyxy_px[:, 2:]) / 2)
        if not self._is_ahead:  # the visible side is not at the depth of the centre
            x_m = rays[:, 0] * filtered.fused.state.x
            lateral = replace(lateral, state=replace(lateral.state, x=x_m))
        motion, pose = self._moved(tracks, filtered, ranges, lateral, time_s, ego, pose)
        fused = ranges["fused"]
        distance_m, sigma_m = fused.distance_m[:, None], fused.sigma_m[:, None]
        direction = self._direction_sigma(tracks, camera)
        xy_sigma_m = np.hypot(rays[:, :2] * sigma_m, direction * distance_m)
        placement = self._placements.update(
            tracks.track_id,
            tracks.observed,
            time_s,
            rays=rays,
            direction_sigma=direction,
            filtered=ranges["fused_kf"],
            lateral=lateral,
            ego=ego,
        )
        if self.road is None:
            velocity = GroundVelocity.of(filtered.fused, lateral, ego)
        else:
            velocity = GroundVelocity.of_courses(motion, pose)
        distance = ranges["fused_kf"]
        cuboids = self._cuboids.update(tracks, camera, distance, velocity, pose, time_s)
        return World(rays * distance_m, xy_sigma_m, motion, pose, placement, cuboids)

    def _moved(
        self,
        tracks: Tracks,
        filtered: Filtered,
        ranges: Mapping[str, Ranges],
        lateral: LateralMotion,
        time_s: float,
        ego: EgoMotion,
        pose: EgoPose,
    ) -> tuple[ObjectMotion, EgoPose]:
        """The motion of the tracks and the pose of the camera in `map`."""
        if self.road is not None:
            return self.road.update(tracks, time_s), self.road.plane.pose
        motion = self._motions.update(
            tracks.track_id,
            tracks.class_id,
            replace(filtered.fused, ranges=ranges["fused_kf"]),
            lateral,
            time_s,
            ego=ego,
            pose=pose,
        )
        return motion, pose

    def _direction_sigma(self, tracks: Tracks, camera: PinholeCamera) -> FloatArray:
        """(N, 2) standard deviations of x and y of the rays through the middles of the boxes."""
        size_px = tracks.xyxy_px[:, 2:] - tracks.xyxy_px[:, :2]
        middle_px = _BOX_NOISE.sigma_px(size_px, tracks.class_id) / math.sqrt(2)
        return np.hypot(middle_px, self._centre_sigma_px) / (camera.fx_px, camera.fy_px)
