"""WorldStage: where the tracks and the camera are, and how the tracks move over ground."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.pipeline.filtering import Filtered
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.world.ego_path import EgoPath, EgoPose
from track_range.ranging.world.object_motion import ObjectMotion, ObjectMotions
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True)
class World:
    """Positions and motion of the N tracks of a frame and of the camera; NaN = unknown."""

    xyz_m: FloatArray  # (N, 3) ranged point in the left camera's frame, from the fused distance
    motion: ObjectMotion  # over ground, and positions in the frame `map`
    ego_pose: EgoPose  # of the left camera in the frame `map`

    @classmethod
    def unknown(cls, n: int) -> "World":
        """The world of n tracks whose distances are unknown."""
        return cls(np.full((n, 3), np.nan), ObjectMotion.unknown(n), EgoPose())


class WorldStage:
    """Places the tracks of a drive in the world of its first frame."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._camera, self._path, self._motions = camera, EgoPath(), ObjectMotions()

    def update(
        self,
        tracks: Tracks,
        filtered: Filtered,
        ranges: Mapping[str, Ranges],
        ego: EgoMotion,
        time_s: float,
    ) -> World:
        """The world at `time_s`, by all distances of the frame and the motion of the camera."""
        pose = self._path.update(time_s, ego)
        motion = self._motions.update(
            tracks.track_id,
            tracks.class_id,
            replace(filtered.fused, ranges=ranges["fused_kf"]),
            filtered.lateral,
            time_s,
            ego=ego,
            pose=pose,
        )
        centre_px = (tracks.xyxy_px[:, :2] + tracks.xyxy_px[:, 2:]) / 2
        xyz_m = self._camera.rays(centre_px) * ranges["fused"].distance_m[:, None]
        return World(xyz_m, motion, pose)
