"""Drives with images, identities and occlusions: a simulated street with a shaking camera.

The simulated camera does not rotate. A rotation R about its centre moves its image by a homography,

    pixel' = K R K^-1 pixel        R: pitch after yaw

so the street is rendered with a wider field of view, and each frame is warped from this image;
boxes are those of the rotated 3-D boxes. Objects that are occluded on purpose are not detected; the
image does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.simulation.camera.playback import HIDDEN, play_back
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.world.road_shape import yaw_rotation
from track_range.simulation.world.scene import (
    AWAY_RAD,
    SIZE_HWL_M,
    SIZE_SPREAD,
    TOWARDS_RAD,
    RoadUser,
    Scene,
    make_scene,
)
from track_range.simulation.world.truth import boxes_in_image, corners_m, label_scene
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

FPS = 10.0
# camera with KITTI's focal length, and most of its image
CAMERA = PinholeCamera(721.5, 721.5, 500.0, 160.0, 1000, 320)

PITCH_RMS_RAD, PITCH_HZ = np.radians(0.45), (0.8, 3.5)
"""Pitch from bumps: root mean square in rad, and range of the frequencies of six sines."""

YAW_RATE_RAD, YAW_PERIOD_S = np.radians((9.0, 15.0)), (4.0, 5.0)
"""Ranges of the largest yaw rate in rad/s and of the period in s of the yaw, a sine."""

# smallest fraction of a box inside the image for objects that are scored
MIN_FRACTION_INSIDE = 0.25
STROLL_MPS = 3.0  # speed of the camera in drives with walkers

VISIBLE_S, OCCLUDED_S, VISIBLE_AFTER_S = (0.8, 2.5), (0.5, 2.0), 0.5
"""Ranges, in s, for which a road user is alternately visible and occluded, and the time after the
last occlusion."""

PAVEMENT_M, LANE_M, N_LANES = 7.9, 0.55, 5
"""Lateral position of the first walker lane, width of the lanes, and number of lanes per
pavement."""


@dataclass(frozen=True, slots=True)
class AppearanceDrive:
    """Images, detections and ground truth of one drive at `FPS`."""

    name: str  # name of the drive
    images: Sequence[Image]  # (H, W, 3) BGR images
    detected: Sequence[Detections]  # detections of the playback detector in each image
    truth: KittiLabels  # true boxes and identities; `occluded` >= HIDDEN is not scored
    occlusions: IntArray  # (N, 3) track id, first and last frame of the occlusions on purpose


def simulated(seed: int, *, seconds: float, is_shaken: bool = True) -> AppearanceDrive:
    """Simulated drive: at 10 m/s in traffic for even seeds, at 3 m/s past people who cross each
    other for odd ones.
    """
    rng = np.random.default_rng([seed, 11])
    scene = make_scene(seed, seconds=seconds)
    if seed % 2:
        scene = _with_walkers(scene, rng)
    time_s = np.arange(round(seconds * FPS)) / FPS
    rotations = (
        _rotations(time_s, rng) if is_shaken else np.tile(np.identity(3), (len(time_s), 1, 1))
    )
    wide = _wide_camera(rotations)
    renderer = Renderer(scene, StereoRig.rectified(wide, 0.54))
    images = [
        _warped(renderer.render(t), wide, R)
        for t, R in zip(time_s.tolist(), rotations, strict=True)
    ]
    truth = _rotated(label_scene(scene, time_s.tolist(), camera=wide), rotations)
    name = f"{'stroll' if seed % 2 else 'traffic'} {seed}"
    return _played_back(name, images, truth, seed=seed)


def class_ids(labels: KittiLabels) -> IntArray:
    """(N,) road classes of KITTI's types."""
    names = [ROAD_CLASS_OF[str(kitti_type).lower()] for kitti_type in labels.kitti_type]
    return np.array([ROAD_CLASSES.index(name) for name in names], np.int64)


def _played_back(
    name: str, images: Sequence[Image], truth: KittiLabels, *, seed: int
) -> AppearanceDrive:
    occlusions = _occlusions(truth, np.random.default_rng([seed, 12]))
    hidden = np.zeros(len(truth), np.bool_)
    for track_id, first, last in occlusions:
        hidden |= (truth.track_id == track_id) & (truth.frame >= first) & (truth.frame <= last)
    truth = replace(truth, occluded=np.where(hidden, HIDDEN, truth.occluded))
    height, width = images[0].shape[:2]
    boxes = play_back(truth, seed=seed, image_size_px=(width, height))
    class_id = class_ids(boxes)
    frames = (np.flatnonzero(boxes.frame == frame) for frame in range(len(images)))
    detected = [
        Detections.of(boxes.xyxy_px[rows], boxes.score[rows], class_id[rows]) for rows in frames
    ]
    return AppearanceDrive(name, images, detected, truth, occlusions)


def _occlusions(truth: KittiLabels, rng: np.random.Generator) -> IntArray:
    """(N, 3) track id, first and last frame of random occlusions, of objects visible before, during
    and after.
    """
    occlusions: list[tuple[int, int, int]] = []
    after = round(VISIBLE_AFTER_S * FPS)
    for track_id in np.unique(truth.track_id):
        frames = np.sort(truth.frame[(truth.track_id == track_id) & (truth.occluded < HIDDEN)])
        ends = [0, *(np.flatnonzero(np.diff(frames) > 1) + 1), len(frames)]
        for begin, end in pairwise(ends):
            first = begin + round(rng.uniform(*VISIBLE_S) * FPS)
            last = first + round(rng.uniform(*OCCLUDED_S) * FPS) - 1
            while last + after < end:
                occlusions.append((int(track_id), int(frames[first]), int(frames[last])))
                first = last + 1 + round(rng.uniform(*VISIBLE_S) * FPS)
                last = first + round(rng.uniform(*OCCLUDED_S) * FPS) - 1
    return np.array(occlusions, np.int64).reshape(-1, 3)


def _with_walkers(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene at a lower camera speed, with people who walk in lanes of opposite directions on
    both pavements.
    """
    users = [user for user in scene.road_users if not _walks_on_pavement(user)]
    for lane in range(2 * N_LANES):
        side, heading_rad = (-1 if lane % 2 else 1), (AWAY_RAD if (lane // 2) % 2 else TOWARDS_RAD)
        speed_mps = float(rng.uniform(0.9, 1.6))
        for z_m in (10.0, 28.0, 46.0):
            height, width, length = np.array(SIZE_HWL_M["Pedestrian"]) * (
                1 + SIZE_SPREAD * rng.uniform(-1, 1, 3)
            )
            walker = RoadUser(
                track_id=1 + max(user.track_id for user in users),
                kitti_type="Pedestrian",
                size_hwl_m=(float(height), float(width), float(length)),
                start_xz_m=(
                    side * (PAVEMENT_M + LANE_M * (lane // 2)),
                    z_m + float(rng.uniform(-4, 4)),
                ),
                rotation_y_rad=heading_rad,
                speed_mps=speed_mps,
            )
            users.append(walker)
    return replace(scene, road_users=tuple(users), ego_speed_mps=STROLL_MPS)


def _walks_on_pavement(user: RoadUser) -> bool:
    return user.kitti_type == "Pedestrian" and abs(user.start_xz_m[0]) > PAVEMENT_M - 1


def _rotations(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(F, 3, 3) rotations R from the axes of the straight camera to those of the shaking one."""
    hz, phase = rng.uniform(*PITCH_HZ, (6, 1)), rng.uniform(0, 2 * np.pi, (6, 1))
    pitch = np.sin(2 * np.pi * hz * time_s + phase).sum(axis=0) * PITCH_RMS_RAD / np.sqrt(3)
    yaw_rad_per_s = 2 * np.pi / rng.uniform(*YAW_PERIOD_S)
    yaw = rng.uniform(*YAW_RATE_RAD) / yaw_rad_per_s * np.sin(yaw_rad_per_s * time_s)
    return np.stack(
        [_about("x", a) @ _about("y", b) for a, b in zip(pitch.tolist(), yaw.tolist(), strict=True)]
    )


def _about(axis: str, angle_rad: float) -> FloatArray:
    vector = np.array(
        [[angle_rad if axis == "x" else 0.0], [angle_rad if axis == "y" else 0.0], [0.0]]
    )
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)


def _wide_camera(rotations: FloatArray) -> PinholeCamera:
    """A straight camera with a field of view that contains those of all rotated cameras."""
    right, bottom = CAMERA.width_px, CAMERA.height_px
    corners = CAMERA.rays(
        np.array([[-1, -1], [right, -1], [-1, bottom], [right, bottom]], np.float64)
    )
    rays = (corners @ rotations).reshape(-1, 3)  # row vectors: ray R is R^T ray
    xy_px = np.array([CAMERA.fx_px, CAMERA.fy_px]) * rays[:, :2] / rays[:, 2:]
    low, high = np.floor(xy_px.min(axis=0)) - 1, np.ceil(xy_px.max(axis=0)) + 1
    width, height = (int(side) for side in high - low + 1)
    return PinholeCamera(CAMERA.fx_px, CAMERA.fy_px, float(-low[0]), float(-low[1]), width, height)


def _warped(image: Image, wide: PinholeCamera, R: FloatArray) -> Image:
    homography = CAMERA.matrix @ R @ np.linalg.inv(wide.matrix)
    return np.asarray(
        cv2.warpPerspective(image, homography, (CAMERA.width_px, CAMERA.height_px)), np.uint8
    )


def _rotated(labels: KittiLabels, rotations: FloatArray) -> KittiLabels:
    """The labels in the images of the rotated cameras; objects outside are removed, those largely
    outside occluded.
    """
    labels = labels.select(labels.has_3d_box)
    corners = corners_m(labels.location_m, labels.size_hwl_m, yaw_rotation(labels.rotation_y_rad))
    inside, outside = boxes_in_image(corners @ rotations[labels.frame].swapaxes(1, 2), CAMERA)
    occluded = np.where(1 - outside < MIN_FRACTION_INSIDE, HIDDEN, labels.occluded)
    return replace(labels, xyxy_px=inside, occluded=occluded).select(
        np.isfinite(inside).all(axis=1) & (outside < 1)
    )
