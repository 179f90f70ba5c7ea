"""A rendered drive on which any number of road users stays in view, for times of stages.

The road users keep pace with the camera, so that the number of boxes does not change. Their columns
in the first image are equally far apart; far ones are in the middle, and near ones at the sides.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.road_shape import yaw_rotation
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, RoadUser, Scene
from track_range.simulation.world.truth import boxes_in_image, corners_m
from track_range.stereo.geometry.frames import Frame

FPS, SPEED_MPS = 10.0, 10.0  # of the images, and of the camera
JITTER_PX = 0.5  # standard deviation of the edges of the boxes
FRACTIONS = {"Car": 0.6, "Pedestrian": 0.2, "Truck": 0.1, "Cyclist": 0.1}  # of the road users
NEAREST_M, FARTHEST_M, FARTHEST_ASIDE_M = 12.0, 65.0, 12.0
TRUCKS_FROM_M = 30.0  # nearer ones would hide most others
DRIFT_MPS = 0.3  # largest speed of a road user relative to the camera


@dataclass(frozen=True, slots=True)
class DenseTraffic:
    """A drive of a pair with KITTI's field of view."""

    renderer: Renderer

    @classmethod
    def of(cls, n_users: int, seed: int = 0) -> "DenseTraffic":
        """A drive with this number of road users in view."""
        rng = np.random.default_rng([seed, 61])
        rig = kitti_like_rig()
        users = []
        columns_px = np.linspace(0.1, 0.9, n_users) * rig.left.width_px
        for track_id, column_px in enumerate(columns_px.tolist()):
            slope = (column_px - rig.left.cx_px) / rig.left.fx_px
            # from which a road user in this column is too far aside
            limit_m = FARTHEST_ASIDE_M / max(abs(slope), 1e-3)
            z_m = float(rng.uniform(NEAREST_M, max(NEAREST_M, min(FARTHEST_M, limit_m))))
            kitti_type = str(rng.choice(list(FRACTIONS), p=list(FRACTIONS.values())))
            if z_m < TRUCKS_FROM_M and kitti_type == "Truck":
                kitti_type = "Car"
            users.append(
                RoadUser(
                    track_id=track_id,
                    kitti_type=kitti_type,
                    size_hwl_m=SIZE_HWL_M[kitti_type],
                    start_xz_m=(slope * z_m, z_m),
                    rotation_y_rad=AWAY_RAD,
                    speed_mps=SPEED_MPS + float(rng.uniform(-DRIFT_MPS, DRIFT_MPS)),
                )
            )
        scene = Scene(seed=seed, road_users=tuple(users), ego_speed_mps=SPEED_MPS)
        return cls(Renderer(scene, rig))

    def frames(self, n_frames: int) -> Iterator[Frame]:
        """The frames of the pair, rendered one after the other."""
        for index in range(n_frames):
            time_s = index / FPS
            left, right = (self.renderer.render(time_s, side=side) for side in ("left", "right"))
            yield Frame(index, time_s, left, right)

    def blank_frames(self, n_frames: int) -> Iterator[Frame]:
        """The frames with black images, on which nothing is measured."""
        camera = self.renderer.rig.left
        black = np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
        for index in range(n_frames):
            yield Frame(index, index / FPS, black, black)

    def detections(self, frame: Frame) -> Detections:
        """The boxes of all road users in the left image, also of those that are hidden."""
        scene = self.renderer.scene
        corners = corners_m(
            scene.location_m(frame.time_s),
            scene.size_hwl_m(),
            yaw_rotation(scene.rotation_y_rad(frame.time_s)),
        )
        xyxy_px, _ = boxes_in_image(corners, self.renderer.rig.left)
        noise_px = np.random.default_rng([frame.index, 61]).normal(0, JITTER_PX, xyxy_px.shape)
        names = [ROAD_CLASS_OF[user.kitti_type.lower()] for user in scene.road_users]
        class_id = np.array([ROAD_CLASSES.index(name) for name in names])
        return Detections.of(xyxy_px + noise_px, np.full(len(names), 0.9), class_id)


def one_camera(frame: Frame) -> Frame:
    """The frame without its right image."""
    return replace(frame, right=None)
